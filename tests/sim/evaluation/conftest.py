"""The two phantoms, on a mesh that is coarse enough for many tests."""

import pytest
from tests.sim.evaluation.two_phantoms import FILE

from eitskin_sim.evaluation import harness
from eitskin_sim.scene.scene import parse_phantoms


@pytest.fixture(scope="module")
def phantoms():
    return parse_phantoms(FILE)


@pytest.fixture(autouse=True)
def coarse(monkeypatch):
    # The harness's logic does not depend on the mesh; its accuracy is the business of the forward model's tests.
    monkeypatch.setattr(harness, "DATA_MM", 3.0)
