"""A touch that lies across is one touch, turned, and not two upright ones; a larger gentle one is drawn as large."""

import numpy as np
import numpy.typing as npt
import pytest

from eitskin_proto.skin.cloud import flat_cloud
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.verification.free.found import FreeVerdict, map_of
from eitskin_sim.verification.free.search import FreeVerifier
from eitskin_sim.verification.free.starts import starts_of, turned_rectangle
from eitskin_sim.verification.residual import Noise
from eitskin_sim.verification.sheet.deformation import ANEW
from eitskin_sim.verification.sheet.model import Model, flat_model_V, model_of_cloud

Array = npt.NDArray[np.float64]


@pytest.fixture(scope="module")
def model() -> Model:
    return model_of_cloud(flat_cloud())


def across(angle_deg: float, kind: int = 0) -> Array:
    return np.array([[kind, 70.0, 48.0, 36.0, 12.0, angle_deg, 50.0, 0.0]])


def verified(model: Model, pieces: Array, shown: Array) -> FreeVerdict:
    flat_V = flat_model_V(PAPER)
    volts = flat_V * (1.0 + model.solve(pieces)[1]) * (1.0 + 3e-3 * np.random.default_rng(3).standard_normal(104))
    own = FreeVerifier(flat_V, Noise("N2", 50.0))
    own.deformation.scan(lambda: model)
    own.deformation._anew = ANEW
    return own.verify(volts, map_of(shown)[None], budget_s=100.0)


@pytest.mark.parametrize("angle_deg", [25.0, 60.0, 140.0])
def test_a_share_along_a_touch_has_its_middle_sides_and_angle(angle_deg):
    found = turned_rectangle(map_of(across(angle_deg)), PAPER.grid)
    np.testing.assert_allclose(found[1:6], across(angle_deg)[0, 1:6], atol=1.5)


def test_a_start_is_turned_where_that_draws_a_touch_better_alone():
    for angle_deg in (25.0, 60.0, 140.0):
        (found,) = starts_of(map_of(across(angle_deg))[None])
        assert found[5] == pytest.approx(angle_deg, abs=2.0)
    upright = np.vstack([across(0.0), across(90.0)])
    assert not starts_of(np.array([map_of(one[None]) for one in upright]))[:, 5].any()
    ell = map_of(np.array([[0, 60.0, 60.0, 30.0, 10.0, 0.0, 50.0, 0.0], [0, 50.0, 45.0, 10.0, 30.0, 0.0, 50.0, 0.0]]))
    assert not starts_of(ell[None])[:, 5].any()


def test_a_touch_that_lies_across_is_found_as_one(model: Model) -> None:
    truth = across(30.0)
    shorter = truth.copy()
    shorter[0, 3:5] = 28.0, 11.0
    found = verified(model, truth, shorter)
    (touch,) = found.touches
    assert touch.angle_deg == pytest.approx(30.0, abs=3.0)
    assert np.corrcoef(found.map().ravel(), map_of(truth).ravel())[0, 1] > 0.97
    assert not found.flagged


def test_a_larger_gentle_touch_is_drawn_as_large_as_the_data_allow(model: Model) -> None:
    """Where a network of hard touches shows a smaller one."""
    truth = np.array([[0, 60.0, 45.0, 20.0, 20.0, 0.0, 2.0, 0.0]])
    shown = np.array([[0, 60.0, 45.0, 10.0, 10.0, 0.0, 50.0, 0.0]])
    found = verified(model, truth, shown)
    map_mm2 = float(found.map().sum() * PAPER.grid.pixel_mm2)
    assert map_mm2 > 150.0
    hard = np.array([[0, 60.0, 45.0, 11.0, 11.0, 0.0, 50.0, 0.0]])
    drawn = verified(model, hard, hard).map()
    assert np.corrcoef(drawn.ravel(), map_of(hard).ravel())[0, 1] > 0.98
