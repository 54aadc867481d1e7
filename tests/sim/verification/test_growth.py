"""Sets that physics alone leads to: contrasts of either sign that no start shows, and fits that never get worse."""

import numpy as np
import pytest

from eitskin_proto.sensor.normalise import relative_change
from eitskin_proto.skin.parts import Map
from eitskin_proto.skin.skin import Skin
from eitskin_sim.measurement.noise import add_noise
from eitskin_sim.reduced.exact import ExactSheet, exact_sheet
from eitskin_sim.reduced.model import ReducedModel, reduced, rows_of
from eitskin_sim.reduced.state import state_of
from eitskin_sim.scene.bend import bend_metric
from eitskin_sim.scene.nominal import flat_metric_of
from eitskin_sim.scene.parts import Bend, Sheet
from eitskin_sim.verification.frame import Frame
from eitskin_sim.verification.prior import Prior
from eitskin_sim.verification.residual import Noise
from eitskin_sim.verification.sets.contrasts import RANGE, fitted, within
from eitskin_sim.verification.sets.growth import Growth
from eitskin_sim.verification.sets.price import UnitPrice

SMALL = Skin(name="small", map=Map((12, 18), (4, 6)))
"""Few, large units."""

NONE = np.zeros(0, dtype=np.intp)
CONTENT = 130.0


@pytest.fixture(scope="module")
def sheet() -> ExactSheet:
    return exact_sheet(bend_metric(Bend(angle_deg=80.0, stretch_along=1.1), Sheet()), SMALL)


@pytest.fixture(scope="module")
def model(sheet: ExactSheet) -> ReducedModel:
    return reduced(sheet, SMALL)


@pytest.fixture(scope="module")
def flat() -> np.ndarray:
    return rows_of(exact_sheet(flat_metric_of(SMALL), SMALL).untouched)


def frame_of(sheet: ExactSheet, flat: np.ndarray, contrasts: dict[int, float], seed: int = 0) -> Frame:
    """Return a frame of the exact sheet, with noise of 50 dB."""
    volts = rows_of(sheet.currents(np.array(list(contrasts)), np.array(list(contrasts.values())))[1])
    noisy = add_noise(volts, flat, "N2", 50.0, np.random.default_rng(seed))
    return Frame(relative_change(noisy, flat), flat, Noise())


def growth(model: ReducedModel, flat: np.ndarray, frame: Frame, late: bool = False) -> Growth:
    price = UnitPrice(model.shape, Prior(places=24), 50.0)
    price.begin([NONE])
    return Growth(model, flat, frame, price, CONTENT, lambda: late)


@pytest.mark.parametrize(
    "contrasts",
    [
        {9: 0.5},
        {8: 0.5, 16: 0.5, 19: 0.5},
        {2: 2.0, 13: 2.0, 21: 2.0},
        {1: 0.1, 10: 0.1, 22: 0.1},
        {3: 0.3, 14: 5.0, 20: 30.0},
    ],
)
def test_from_nothing_units_of_any_contrast_are_found(
    sheet: ExactSheet, model: ReducedModel, flat: np.ndarray, contrasts: dict[int, float]
) -> None:
    own = growth(model, flat, frame_of(sheet, flat, contrasts))
    found = own.grown(NONE, np.zeros(0))
    assert dict(zip(found.units.tolist(), np.log(found.contrasts), strict=True)) == pytest.approx(
        {unit: np.log(contrast) for unit, contrast in contrasts.items()}, abs=0.5
    )
    assert own.evaluations < 250


def test_units_that_are_none_are_taken_out_again(sheet: ExactSheet, model: ReducedModel, flat: np.ndarray) -> None:
    own = growth(model, flat, frame_of(sheet, flat, {8: 0.4, 19: 0.4}))
    assert set(own.grown(np.array([2, 8, 11]), np.full(3, 0.5)).units.tolist()) == {8, 19}


def test_a_sheet_that_nothing_touches_grows_nothing(sheet: ExactSheet, model: ReducedModel, flat: np.ndarray) -> None:
    noisy = add_noise(rows_of(sheet.untouched), flat, "N2", 50.0, np.random.default_rng(4))
    own = growth(model, flat, Frame(relative_change(noisy, flat), flat, Noise()))
    assert len(own.grown(NONE, np.zeros(0)).units) == 0


def test_without_time_nothing_grows(sheet: ExactSheet, model: ReducedModel, flat: np.ndarray) -> None:
    own = growth(model, flat, frame_of(sheet, flat, {9: 0.5}), late=True)
    assert len(own.grown(NONE, np.zeros(0)).units) == 0


def test_a_fit_of_contrasts_is_never_worse_and_keeps_its_side_of_1(
    sheet: ExactSheet, model: ReducedModel, flat: np.ndarray
) -> None:
    frame = frame_of(sheet, flat, {8: 0.3, 19: 8.0})
    for begin in ([0.5, 3.0], [2.0, 3.0], [0.9, 180.0]):
        state = state_of(model, np.array([8, 19]), np.array(begin))
        found = fitted(frame, flat, state, common=False)
        assert frame.chi_squared(found.volts / flat) <= frame.chi_squared(state.volts / flat)
        assert np.array_equal(np.sign(np.log(found.contrasts)), np.sign(np.log(begin)))
    logs = within(np.array([9.0, -9.0, 0.0]), np.array([1.0, -1.0, -1.0]))
    assert np.exp(logs[:2]) == pytest.approx([RANGE[1], RANGE[0]])
    assert -0.1 < logs[2] < 0.0
