"""Units moved to a place beside and merged, and what is done where rows are missing."""

import numpy as np
import pytest

from eitskin_proto.sensor.normalise import relative_change
from eitskin_proto.sensor.row_gaussian import rows_of as rows_of_electrodes
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
from eitskin_sim.verification.sets.candidates import Candidates
from eitskin_sim.verification.sets.judge import Judge
from eitskin_sim.verification.sets.neighbours import moves_of
from eitskin_sim.verification.sets.polish import Polish
from eitskin_sim.verification.sets.price import UnitPrice
from eitskin_sim.verification.sets.search import Search

SMALL = Skin(name="small", map=Map((12, 18), (4, 6)))
"""Few, large units: 4 rows of 6."""

GONE = 3
"""The electrode whose rows are missing."""


@pytest.fixture(scope="module")
def sheet() -> ExactSheet:
    return exact_sheet(bend_metric(Bend(angle_deg=80.0, stretch_along=1.1), Sheet()), SMALL)


@pytest.fixture(scope="module")
def model(sheet: ExactSheet) -> ReducedModel:
    return reduced(sheet, SMALL)


def judge_of(sheet: ExactSheet, model: ReducedModel, true: dict[int, float], missing: tuple[int, ...] = ()) -> Judge:
    """Return the judge of a frame of the exact sheet with some units touched, and noise of 50 dB."""
    flat = rows_of(exact_sheet(flat_metric_of(SMALL), SMALL).untouched)
    volts = rows_of(sheet.currents(np.array(list(true)), np.array(list(true.values())))[1])
    noisy = add_noise(volts, flat, "N2", 50.0, np.random.default_rng(3))
    frame = Frame(relative_change(noisy, flat), flat, Noise(), rows=~rows_of_electrodes(missing))
    price = UnitPrice(model.shape, Prior(places=24), 50.0)
    return Judge(model, model.of_rank(8), model.of_rank(4), flat, frame, price, 50.0, 1.0, lambda: 0.0)


def best_move(judge: Judge, units: list[int], contrasts: tuple[float, ...] = (50.0,)) -> list[tuple[int, float]]:
    """Return units and contrasts after the best move from a set, each at its first contrast."""
    candidates = Candidates.of(*(np.full(24, one) for one in contrasts))
    bits = candidates.bits(np.array(units))
    chi, own, flipped = moves_of(judge, candidates, bits, np.zeros(24), 1.0, 1)[0]
    bits[flipped] ^= True
    state = judge.state(candidates.units[bits], candidates.contrasts[bits], coarse=True)
    assert chi == pytest.approx(judge.chi(state), rel=1e-6)
    assert own == 0.0
    return sorted(zip(candidates.units[bits].tolist(), candidates.contrasts[bits].tolist(), strict=True))


def test_one_instead_of_others_is_the_set_with_it(model: ReducedModel) -> None:
    units, contrasts = np.array([2, 8, 19, 21]), np.array([50.0, 0.4, 5.0, 50.0])
    beside = state_of(model, units, contrasts).beside(np.array([0, 9, 22]), 20.0)
    for taken in ([1], [0], [0, 3], [1, 2, 3]):
        found = beside.instead(np.array([taken, taken]), np.array([2, 0]))
        left = np.delete(np.arange(4), taken)
        for row, unit in zip(found, (22, 0), strict=True):
            whole = state_of(model, np.append(units[left], unit), np.append(contrasts[left], 20.0))
            assert row == pytest.approx(whole.volts, rel=1e-9)


@pytest.mark.parametrize("start", [[2, 10, 19], [8, 10, 20], [15, 10, 19]])
def test_a_unit_one_place_off_is_moved(sheet: ExactSheet, model: ReducedModel, start: list[int]) -> None:
    found = best_move(judge_of(sheet, model, {8: 50.0, 10: 50.0, 19: 50.0}), start)
    assert found == [(8, 50.0), (10, 50.0), (19, 50.0)]


def test_two_units_with_one_between_become_the_one(sheet: ExactSheet, model: ReducedModel) -> None:
    assert best_move(judge_of(sheet, model, {9: 50.0, 19: 50.0}), [8, 10, 19]) == [(9, 50.0), (19, 50.0)]


def test_a_unit_is_moved_at_any_of_its_contrasts(sheet: ExactSheet, model: ReducedModel) -> None:
    judge = judge_of(sheet, model, {8: 50.0, 19: 0.4})
    assert best_move(judge, [8, 20], (50.0, 0.4)) == [(8, 50.0), (19, 0.4)]


def test_of_nothing_there_is_no_move(sheet: ExactSheet, model: ReducedModel) -> None:
    candidates = Candidates.of(np.full(24, 50.0))
    nothing = np.zeros(24, dtype=np.bool_)
    assert moves_of(judge_of(sheet, model, {8: 50.0}), candidates, nothing, np.zeros(24), 1.0, 8) == []


@pytest.mark.parametrize("start", [[7, 13], [7], [14], [7, 15]])
def test_where_rows_are_missing_the_cheapest_set_is_taken_and_not_the_first(
    sheet: ExactSheet, model: ReducedModel, start: list[int]
) -> None:
    first = state_of(model, np.array(start), np.full(len(start), 50.0))
    found = {}
    for missing in ((GONE,), ()):
        judge = judge_of(sheet, model, {7: 50.0, 14: 50.0}, missing)
        judge.price.begin([first.units])
        judge.content = 1.01 * judge.chi(first)
        found[missing] = sorted(Search(judge).run(first).units.tolist())
    assert found == {(GONE,): [7, 14], (): start}


def test_what_does_not_explain_the_frame_is_not_polished(sheet: ExactSheet, model: ReducedModel) -> None:
    judge = judge_of(sheet, model, {7: 50.0, 14: 50.0}, (GONE,))
    wrong = state_of(model, np.array([7, 13]), np.full(2, 50.0))
    assert not judge.explained(wrong)
    assert Polish(judge).polished(wrong) is wrong


def test_a_touch_that_a_network_shows_as_many_is_built_from_nothing(sheet: ExactSheet, model: ReducedModel) -> None:
    judge = judge_of(sheet, model, {13: 50.0}, (GONE,))
    shown = np.array([6, 7, 12, 18, 19, 20])
    heights = np.where(np.isin(np.arange(24), shown), 0.8, 0.01)
    search = Search(judge)
    first = search.best_of(state_of(model, shown, np.full(6, 50.0)), [], heights)
    before = judge.evaluations
    assert search.run(first).units.tolist() == [13]
    assert judge.evaluations - before < 400
