"""A small sheet, bent, exact and reduced: its models take a second."""

import pytest
from tests.sim.verification.small_frames import SMALL

from eitskin_sim.reduced.exact import ExactSheet, exact_sheet
from eitskin_sim.reduced.making import reduced
from eitskin_sim.reduced.model import ReducedModel
from eitskin_sim.scene.bend import bend_metric
from eitskin_sim.scene.parts import Bend, Sheet


@pytest.fixture(scope="session")
def sheet() -> ExactSheet:
    return exact_sheet(bend_metric(Bend(angle_deg=80.0, stretch_along=1.1), Sheet()), SMALL)


@pytest.fixture(scope="session")
def model(sheet: ExactSheet) -> ReducedModel:
    return reduced(sheet, SMALL)
