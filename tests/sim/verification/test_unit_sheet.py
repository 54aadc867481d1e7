"""Touched units on sheets that are not as their scans say: frames ask for other models, which are kept if better."""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from itertools import count

import numpy as np
import numpy.typing as npt
import pytest

from eitskin_proto.sensor.normalise import relative_change
from eitskin_proto.sensor.row_gaussian import rows_of as rows_of_electrodes
from eitskin_sim.measurement.noise import add_noise
from eitskin_sim.reduced.exact import ExactSheet, exact_sheet
from eitskin_sim.reduced.model import rows_of
from eitskin_sim.scene.bend import bend_metric
from eitskin_sim.scene.parts import Bend, Sheet
from eitskin_sim.surface.measured_cloud import measured_cloud
from eitskin_sim.verification import unit_sheet
from eitskin_sim.verification.asked import Asked, UnitVerdict, better
from eitskin_sim.verification.residual import Noise
from eitskin_sim.verification.sheet.deformation import ANEW, Deformation
from eitskin_sim.verification.unit_sheet import UnitSheet, flat_of
from eitskin_sim.verification.units import UnitTouch
from eitskin_sim.verification.verdict import Verdict

from .small_frames import SMALL

Array = npt.NDArray[np.float64]

UNEVEN = Bend(angle_deg=100.0, axis_deg=20.0, skew=0.3, stretch_along=1.1, stretch_across=1.03, nonuniformity=0.13)
"""Its stretch is not as even as its scan seems to show."""

GAUGE = 1.2
"""More than a sheet is likely to have."""

NOISE = Noise("N2", 50.0)
UNITS = {3: 50.0, 16: 50.0}


@lru_cache(maxsize=2)
def true_sheet(gauge: float) -> ExactSheet:
    return exact_sheet(bend_metric(UNEVEN, Sheet()), SMALL, gauge=gauge)


def read(touched: dict[int, float], seed: int, gauge: float = GAUGE) -> Array:
    """Return (104,) dV of the true sheet with noise."""
    sheet = true_sheet(gauge)
    volts = rows_of(sheet.untouched)
    if touched:
        volts = rows_of(sheet.currents(np.array(list(touched)), np.array(list(touched.values())))[1])
    return relative_change(add_noise(volts, flat_of(SMALL), "N2", 50.0, np.random.default_rng(seed)), flat_of(SMALL))


def verified(
    sheet: UnitSheet,
    change: Array,
    shown: dict[int, float],
    rows: npt.NDArray[np.bool_] | None = None,
    budget_s: float = 1e4,
) -> UnitVerdict:
    """Return the verdict on a frame whose network shows some units."""
    start = np.zeros(SMALL.grid.n_units, dtype=np.bool_)
    start[list(shown)] = True
    return sheet.verify(change, flat_of(SMALL), (start,), NOISE, rows=rows, budget_s=budget_s)


def scanned() -> UnitSheet:
    """Return the scanned sheet, whose time is counted in looks at the clock."""
    looks = count()
    return UnitSheet(measured_cloud(UNEVEN, np.random.default_rng(4), skin=SMALL), SMALL, clock=lambda: next(looks))


def improved(sheet: UnitSheet) -> list[UnitVerdict]:
    """Make models as long as the last frame asks for any, and return the verdicts of those that were kept."""
    found = []
    while sheet.improves:
        if (verdict := sheet.improve()) is not None:
            found.append(verdict)
    return found


@pytest.fixture(scope="module", autouse=True)
def _kept() -> None:
    """Make once what all sheets of a skin share."""
    scanned()


def units_of(verdict: UnitVerdict) -> set[int]:
    return {one.unit for one in verdict.touches}


def test_a_frame_shows_how_the_sheet_is_stretched_and_conducts_and_those_after_it_are_explained() -> None:
    sheet = scanned()
    first = verified(sheet, read(UNITS, 1), UNITS)
    assert first.flagged
    kept = improved(sheet)
    assert not kept[-1].flagged
    assert units_of(kept[-1]) == set(UNITS)
    assert kept[-1].chi_squared < 0.5 * first.chi_squared
    others = {7: 50.0, 10: 0.4}
    second = verified(sheet, read(others, 2), {7: 50.0})
    assert units_of(second) == set(others)
    assert not second.flagged


def test_a_sheet_that_was_seen_at_rest_needs_no_other_model() -> None:
    sheet = scanned()
    mean = np.mean([read({}, seed) for seed in range(100, 150)], axis=0)
    assert sheet.rest(mean, flat_of(SMALL), NOISE, 50)
    verdict = verified(sheet, read(UNITS, 1), {})
    assert units_of(verdict) == set(UNITS)
    assert not verdict.flagged
    assert not sheet.improves
    assert sheet.improve() is None


def test_another_sheet_at_rest_changes_nothing() -> None:
    sheet, usual = scanned(), read(UNITS, 1, 0.0)
    before = verified(sheet, usual, UNITS)
    strange = 0.3 * np.sign(np.random.default_rng(2).standard_normal(104))
    assert not sheet.rest(strange, flat_of(SMALL), NOISE, 50)
    assert verified(sheet, usual, UNITS).chi_squared == pytest.approx(before.chi_squared, rel=1e-9)


def test_missing_rows_do_not_count_in_what_a_frame_shows_of_the_sheet() -> None:
    rows = ~rows_of_electrodes((5,))
    found = []
    for filled in (0.0, np.nan):
        sheet = scanned()
        verified(sheet, np.where(rows, read(UNITS, 1), filled), UNITS, rows)
        found.append([one.chi_squared for one in improved(sheet)])
    assert len(found[0]) > 0
    assert found[0] == found[1]


def test_frames_that_nothing_explains_ask_for_few_models_and_spoil_none(monkeypatch: pytest.MonkeyPatch) -> None:
    made = []
    reduced: Callable[..., object] = unit_sheet._reduced
    monkeypatch.setattr(unit_sheet, "_reduced", lambda *words: made.append(words) or reduced(*words))
    sheet, usual = scanned(), read(UNITS, 1, 0.0)
    before = verified(sheet, usual, UNITS)
    strange = read(UNITS, 1) + 0.2 * np.random.default_rng(2).standard_normal(104)
    for _ in range(4):
        verified(sheet, strange, UNITS, budget_s=0.0)
        assert improved(sheet) == []
    assert len(made) <= 1 + ANEW + (2 + len(unit_sheet.SHARES)) * (1 + unit_sheet.ROUNDS)
    assert verified(sheet, usual, UNITS).chi_squared == pytest.approx(before.chi_squared, rel=1e-9)


def test_a_model_that_has_explained_no_frame_is_left_where_the_one_before_explains_a_later_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    sheet, usual = scanned(), read(UNITS, 1, 0.0)
    begun, strange = sheet._verifier, usual + 0.2 * np.random.default_rng(2).standard_normal(104)

    def said(verifier: object, asked: object) -> UnitVerdict:
        known = np.array_equal(asked.change, usual)  # type: ignore[attr-defined]
        chi = {True: {True: 90.0, False: 400.0}, False: {True: 1000.0, False: 500.0}}[known][verifier is begun]
        return Verdict((), chi, 104, 0.8 if chi < 100.0 else 0.0, 0.01, 1, 0.0)

    monkeypatch.setattr(sheet, "_verified", said)
    verified(sheet, strange, {})
    assert [one.chi_squared for one in improved(sheet)] == [500.0]
    assert verified(sheet, usual, UNITS).flagged
    assert sheet.improves
    back = sheet.improve()
    assert back is not None
    assert back.chi_squared == 90.0
    assert verified(sheet, usual, UNITS).chi_squared == 90.0


@pytest.mark.parametrize(
    ("again", "shown", "kept"),
    [
        ((900.0, 0.0), True, False),
        ((500.0, 0.0), True, True),
        ((1200.0, 0.2), True, True),
        ((5000.0, 0.0), True, False),
        ((500.0, 0.0), False, False),
        ((120.0, 0.2), False, False),
        ((80.0, 0.9), False, True),
    ],
)
def test_another_model_is_kept_where_it_explains_the_frame_better(
    again: tuple[float, float], shown: bool, kept: bool
) -> None:
    found, before = (Verdict((), chi, 104, p, 0.01, 1, 0.0) for chi, p in (again, (1000.0, 0.0)))
    assert better(found, before, shown=shown) is kept


def test_touches_are_shown_where_they_are_those_of_one_threshold() -> None:
    starts = [np.isin(np.arange(6), units) for units in ([1, 4], [1])]
    asked = Asked(np.zeros(104), np.ones(104), starts, NOISE, None, None, (), None)
    for units, expected in (((1, 4), True), ((1,), True), ((4,), False), ((1, 2, 4), False)):
        verdict = Verdict(tuple(UnitTouch(unit, 50.0) for unit in units), 80.0, 104, 0.9, 0.01, 1, 0.0)
        assert asked.shown(verdict) is expected
        assert replace(asked, starts=[]).shown(verdict)


def test_just_what_the_network_shows_is_tried_on_other_sheets_before_any_frame_was_explained() -> None:
    sheet = scanned()
    judged = verified(sheet, read(UNITS, 1), UNITS, budget_s=0.0)
    assert judged.flagged
    found = sheet.improve()
    assert found is not None
    assert not found.flagged
    assert {one.unit for one in found.touches} == set(UNITS)


@pytest.mark.parametrize(("shares", "explained"), [((1.0,), False), ((1.0, 0.5), True)])
def test_where_the_whole_way_leads_too_far_a_part_of_it_is_gone(
    shares: tuple[float, ...], explained: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As derivatives say too much far from the truth, here all of them do: twice as much."""
    make = Deformation.make_anew

    def too_far(self: Deformation, amplitudes: Array, share: float = 1.0) -> Callable[[], None]:
        return make(self, amplitudes, 2.0 * share)

    monkeypatch.setattr(Deformation, "make_anew", too_far)
    monkeypatch.setattr(unit_sheet, "SHARES", shares)
    sheet = scanned()
    verified(sheet, read(UNITS, 1), UNITS, budget_s=0.0)
    model = sheet._verifier
    found = sheet._by_the_network()
    assert (found is not None) is explained
    assert (sheet._verifier is model) is not explained


def test_nothing_is_made_before_there_is_a_frame() -> None:
    sheet = scanned()
    assert not sheet.improves
    assert sheet.improve() is None


def test_one_step_behind_each_frame_gets_there_too() -> None:
    sheet, flagged = scanned(), []
    for seed in range(8):
        flagged.append(verified(sheet, read(UNITS, seed), UNITS).flagged)
        sheet.improve()
    assert flagged[0]
    assert not flagged[-1]


def test_starts_may_be_one_array() -> None:
    sheet, starts = scanned(), np.zeros((2, SMALL.grid.n_units), dtype=np.bool_)
    starts[:, list(UNITS)] = True
    first = sheet.verify(read(UNITS, 1), flat_of(SMALL), starts, NOISE, budget_s=1e4)
    assert first.flagged
    assert not improved(sheet)[-1].flagged
