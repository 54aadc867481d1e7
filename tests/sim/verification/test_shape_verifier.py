"""The verifier of shapes: it finds what was drawn, keeps its budget, and knows when it explains nothing."""

from itertools import count
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from tests.sim.verification.frames import (
    NOTHING,
    SQUARE,
    Array,
    changed,
    correlation,
    flat_model,
    flat_verifier,
    frame_of,
    noisy,
    read,
    shares_of,
)

from eitskin_proto.skin.cloud import flat_cloud
from eitskin_proto.skin.skin import PAPER
from eitskin_proto.skin.touch_kind import TouchKind
from eitskin_sim.scene.bend import bend_metric
from eitskin_sim.scene.nominal import nominal_sheet
from eitskin_sim.scene.parts import Bend
from eitskin_sim.shapes.sheet import TouchedSheet
from eitskin_sim.surface.measured_cloud import measured_cloud
from eitskin_sim.verification.both_signs import signed
from eitskin_sim.verification.network_map import map_of, starts_of
from eitskin_sim.verification.residual import Noise
from eitskin_sim.verification.shape_verifier import ShapeVerifier
from eitskin_sim.verification.sheet_model import SheetModel, flat_model_V, touched_sheet

LONG = 1000.0

STEP = 4
"""The derivative and the solution underway, the last derivative for errors and degrees of freedom, and one to spare."""


def test_a_touch_is_found_within_its_errors_from_a_wrong_start() -> None:
    verdict = flat_verifier().verify(read(SQUARE), shares_of(changed(SQUARE, x=4.0, y=-3.0, length=2.0)), LONG)
    (touch,) = verdict.touches
    assert not verdict.flagged
    assert np.hypot(touch.centre_mm[0] - 60.0, touch.centre_mm[1] - 45.0) < 4.0 * np.hypot(*touch.centre_error_mm)
    assert max(touch.centre_error_mm) < 1.0
    assert abs(touch.strength_mm2 - 120.0 * np.log(50.0)) < 4.0 * touch.strength_error_mm2
    assert touch.area_range_mm2[0] < touch.area_mm2 < touch.area_range_mm2[1]


def test_a_touch_that_lies_across_is_found_as_one() -> None:
    truth = np.array([[0, 70.0, 48.0, 36.0, 12.0, 30.0, 50.0, 0.0]])
    found = flat_verifier().verify(read(truth), shares_of(changed(truth, length=-8.0, width=-1.0)), LONG)
    (touch,) = found.touches
    assert touch.angle_deg == pytest.approx(30.0, abs=3.0)
    assert correlation(found.map(), map_of(truth)) > 0.97
    assert not found.flagged


def test_a_press_is_found_and_has_a_negative_strength() -> None:
    press = np.array([[2, 60.0, 45.0, 16.0, 16.0, 0.0, 0.4, 3.0]])
    found = flat_verifier("lower").verify(read(press), shares_of(press), LONG)
    assert found.touches
    assert all(touch.strength_mm2 < 0.0 for touch in found.touches)
    assert not found.flagged


@pytest.mark.parametrize("touches", ["raise", "lower", "both"])
def test_touches_of_opposite_signs_are_found_where_the_network_shows_one(touches: TouchKind) -> None:
    truth = np.array([[0, 50.0, 45.0, 12.0, 12.0, 0.0, 20.0, 0.0], [0, 82.0, 45.0, 12.0, 12.0, 0.0, 0.2, 0.0]])
    found = flat_verifier(touches).verify(read(truth), shares_of(truth[:1]), LONG)
    assert not found.flagged
    order = np.argsort(found.pieces[:, 1])
    assert found.pieces[order, 1:3] == pytest.approx(truth[:, 1:3], abs=1.5)
    assert [found.touches[at].strength_mm2 > 0.0 for at in order] == [True, False]


def test_where_touches_go_both_ways_a_start_has_the_sign_of_the_voltages() -> None:
    truth = np.array([[0, 50.0, 45.0, 14.0, 14.0, 0.0, 0.3, 0.0], [0, 95.0, 60.0, 10.0, 10.0, 0.0, 40.0, 0.0]])
    frame = frame_of(truth, "both")
    found = signed(frame, starts_of(shares_of(*truth), frame.prior)[0])
    assert np.sign(np.log(found[:, 6])).tolist() == [-1.0, 1.0]


def test_touches_beside_a_dent_are_flagged_until_the_sheet_was_seen_untouched() -> None:
    bend = Bend(bumps_mm=((100.0, 40.0, -10.0, 12.0),))
    verifier = ShapeVerifier(flat_model_V(PAPER), Noise("N2", 50.0))
    verifier.deform(measured_cloud(bend, np.random.default_rng(2)))
    sheet = touched_sheet(bend_metric(bend, nominal_sheet(PAPER)), PAPER)
    volts = noisy(sheet.solve(SQUARE).voltages_V)
    assert verifier.verify(volts, shares_of(SQUARE), LONG).on_dented_sheet
    assert verifier.use_untouched(noisy(sheet.untouched_V), 1)
    seen = verifier.verify(volts, shares_of(SQUARE), LONG)
    assert not seen.flagged
    assert seen.pieces[0, 1:3] == pytest.approx(SQUARE[0, 1:3], abs=2.0)


def test_what_no_touch_explains_is_flagged_and_nothing_is_found_of_nothing() -> None:
    odd = read(SQUARE) * (1.0 + 0.03 * (-1.0) ** np.arange(104))
    assert flat_verifier().verify(odd, shares_of(SQUARE), LONG).flagged
    nothing = flat_verifier().verify(read(NOTHING), shares_of(), LONG)
    assert not nothing.touches
    assert not nothing.flagged


def test_rows_that_are_missing_are_left_out_whatever_they_read() -> None:
    rows = np.arange(104) % 13 != 4
    volts = np.where(rows, read(SQUARE), np.nan)
    found = flat_verifier().verify(volts, shares_of(SQUARE), LONG, rows)
    assert not found.flagged
    assert found.pieces[0, 1:5] == pytest.approx(SQUARE[0, 1:5], abs=1.0)
    assert found.degrees_of_freedom < rows.sum()


class Work:
    """Counts solutions and derivatives, and is the clock."""

    def __init__(self) -> None:
        self.done = 0

    def __call__(self) -> float:
        return float(self.done)


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> tuple[ShapeVerifier, Work]:
    """Return a verifier whose clock is its own work; that for models of the sheet is none."""
    work = Work()
    for name in ("solve", "jacobian"):
        whole = getattr(SheetModel, name)

        def counting(*arguments: Any, whole: Any = whole) -> Any:
            work.done += 1
            return whole(*arguments)

        monkeypatch.setattr(SheetModel, name, counting)
    own = ShapeVerifier(flat_model_V(PAPER), Noise("N2", 50.0), clock=work)
    own.deformation.scan(flat_model)
    return own, work


def pieces_of(number: int) -> Array:
    rng = np.random.default_rng(1)
    sides = rng.uniform(5.0, 12.0, (number, 2))
    at = np.column_stack([rng.uniform(8.0, 142.0, number), rng.uniform(8.0, 92.0, number)])
    return np.column_stack([np.zeros(number), at, sides, np.tile([0.0, 50.0, 0.0], (number, 1))])


@pytest.mark.parametrize(
    ("shown", "kind"), [(0, "random"), (3, "signs"), (3, "saturated"), (40, "random"), (-1, "random")]
)
def test_nonsense_keeps_its_budget_and_is_flagged(shown: int, kind: str, counted: tuple[ShapeVerifier, Work]) -> None:
    own, work = counted
    flat_V, rng, before = flat_model_V(PAPER), np.random.default_rng(5), own.deformation.model
    volts = {
        "random": flat_V * rng.uniform(0.2, 3.0, 104),
        "signs": flat_V * 3.0 * rng.standard_normal(104),
        "saturated": np.full(104, 5.0) * np.sign(flat_V),
    }[kind]
    shares = np.ones((1, *PAPER.grid.shape)) if shown < 0 else shares_of(*pieces_of(shown))
    budget = 3 if shown == 40 else 12
    verdict = own.verify(volts, shares, budget)
    assert work.done <= budget + STEP
    assert verdict.flagged
    assert np.isfinite(verdict.pieces).all()
    assert own.deformation.model is before, "nonsense does not spoil the model of the next frame"


def test_more_time_gives_no_worse_answer(counted: tuple[ShapeVerifier, Work]) -> None:
    own, _ = counted
    two = pieces_of(2)
    volts = read(two)
    frame = own.frame(volts / flat_model_V(PAPER) - 1.0)
    shown = shares_of(*changed(two, x=3.0, y=-2.0, length=2.0, width=1.0))
    costs = [frame.at(own.verify(volts, shown, budget).pieces).cost for budget in (1, 2, 4, 8, 16, 32)]
    assert costs == sorted(costs, reverse=True)
    assert costs[-1] < costs[0]


def test_what_is_no_frame_is_said_in_a_line() -> None:
    own, flat_V, none = flat_verifier(), flat_model_V(PAPER), shares_of()
    odd = flat_V.copy()
    odd[[3, 7]] = np.nan, np.inf
    for volts, shares, text in (
        (odd, none, "voltages: 2 of 104 are not finite"),
        (flat_V, np.full((1, *PAPER.grid.shape), np.nan), "shares of the map: 1350 of 1350 are not finite"),
        (flat_V[:8], none, r"voltages \(8,\): expected \(104,\)"),
    ):
        with pytest.raises(ValueError, match=text) as error:
            own.verify(volts, shares, 1.0)
        assert "\n" not in str(error.value)
    with pytest.raises(ValueError, match="give its cloud first"):
        ShapeVerifier(flat_V, Noise()).verify(flat_V, none)


UNEVEN = Bend(angle_deg=100.0, axis_deg=20.0, skew=0.3, stretch_along=1.1, stretch_across=1.03, nonuniformity=0.13)
"""Its stretch is not as even as its scan seems to show."""

PIECES = np.array([[0, 40.0, 35.0, 10.0, 10.0, 0.0, 50.0, 0.0], [0, 100.0, 60.0, 10.0, 10.0, 0.0, 50.0, 0.0]])

NEAR_MM = 1.0
"""A tenth of a touch: three times what noise of 50 dB moves one by."""


def sheet_of(gauge: float) -> TouchedSheet:
    return touched_sheet(bend_metric(UNEVEN, nominal_sheet(PAPER)), PAPER, gauge=gauge)


@pytest.fixture(scope="module")
def sheet() -> TouchedSheet:
    """Return one of a larger gauge factor than a sheet is likely to have."""
    return sheet_of(1.2)


@pytest.fixture(scope="module")
def scanned() -> SheetModel:
    own = ShapeVerifier(flat_model_V(PAPER), Noise("N2", 50.0))
    own.deform(measured_cloud(UNEVEN, None, skin=PAPER))
    return own.deformation.model


@pytest.fixture
def own(scanned: SheetModel) -> ShapeVerifier:
    """Return a verifier of the scanned sheet, whose time is counted in looks at the clock."""
    looks = count()
    found = ShapeVerifier(flat_model_V(PAPER), Noise("N2", 50.0), clock=lambda: float(next(looks)))
    found.deformation.scan(lambda: scanned)
    return found


def of_sheet(sheet: TouchedSheet, pieces: Array, seed: int) -> Array:
    return noisy(sheet.solve(pieces).voltages_V, seed)


def at_rest(sheet: TouchedSheet) -> Array:
    return np.mean([of_sheet(sheet, NOTHING, seed) for seed in range(50)], axis=0)


def test_a_frame_that_nothing_explains_shows_another_sheet_which_serves_the_frames_after_it(
    own: ShapeVerifier, scanned: SheetModel
) -> None:
    odd = sheet_of(2.0)
    verdicts, models = [], []
    for seed in (1, 2):
        verdicts.append(own.verify(of_sheet(odd, PIECES, seed), shares_of(*PIECES), 4 * LONG))
        models.append(own.deformation.model)
    assert models[0] is not scanned
    assert models[0].gauge > 0.8
    for found in verdicts:
        assert not found.flagged
        assert found.pieces[:, 1:3] == pytest.approx(PIECES[:, 1:3], abs=NEAR_MM)


def test_what_was_seen_at_rest_explains_what_is_touched_there(own: ShapeVerifier, sheet: TouchedSheet) -> None:
    assert own.use_untouched(at_rest(sheet), 50)
    rested = own.deformation.model
    for seed in (1, 2):
        found = own.verify(of_sheet(sheet, PIECES, seed), shares_of(*PIECES), LONG)
        assert not found.flagged
        assert found.pieces[:, 1:3] == pytest.approx(PIECES[:, 1:3], abs=NEAR_MM)
    assert own.deformation.model is rested, "frames are explained by what is known: no model is made for them"
    own.deform(flat_cloud())
    assert own.deformation.model.rest is None, "another deformation is known by its scan alone"


@pytest.mark.slow
def test_a_sheet_that_has_changed_since_is_verified_by_its_scan(own: ShapeVerifier, sheet: TouchedSheet) -> None:
    assert own.use_untouched(at_rest(sheet), 50)
    rested = own.deformation.model
    flat = np.random.default_rng(7).standard_normal(4) @ np.array([np.sin(k * np.arange(104.0)) for k in range(1, 5)])
    slipped = of_sheet(sheet, PIECES, 1) * (1.0 + 0.03 * flat)
    assert own.verify(slipped, shares_of(*PIECES), LONG).flagged
    assert not own.deformation.has_others, "the scan's own model was tried"
    assert own.deformation.model is rested, "nonsense spoils nothing"


def test_what_is_not_the_scanned_sheet_changes_nothing(own: ShapeVerifier, sheet: TouchedSheet) -> None:
    before = own.deformation.model
    assert not own.use_untouched(at_rest(sheet) * np.random.default_rng(1).uniform(0.3, 2.0, 104), 50)
    assert own.deformation.model is before
    odd: npt.NDArray[np.float64] = at_rest(sheet)
    odd[3] = np.nan
    with pytest.raises(ValueError, match="voltages: 1 of 104 are not finite"):
        own.use_untouched(odd)
    with pytest.raises(ValueError, match="0 frames"):
        own.use_untouched(at_rest(sheet), 0)
    with pytest.raises(ValueError, match="no deformation"):
        ShapeVerifier(flat_model_V(PAPER), Noise()).use_untouched(at_rest(sheet))
