"""Units moved to a place beside and merged, and what is done where rows are missing."""

from typing import Any

import numpy as np
import pytest
from tests.sim.verification.small_frames import judge_of

from eitskin_sim.reduced.exact import ExactSheet
from eitskin_sim.reduced.model import ReducedModel
from eitskin_sim.reduced.state import state_of
from eitskin_sim.verification.sets.candidates import Bits, Candidates
from eitskin_sim.verification.sets.exchange import Exchange
from eitskin_sim.verification.sets.judge import REMEMBERED, Judge
from eitskin_sim.verification.sets.neighbours import moves_of
from eitskin_sim.verification.sets.polish import Polish
from eitskin_sim.verification.sets.search import Search

GONE = 3
"""The electrode whose rows are missing."""


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


@pytest.mark.parametrize("missing", [(GONE,), ()])
def test_a_touch_that_a_network_shows_as_many_is_built_from_nothing_where_rows_are_missing(
    sheet: ExactSheet, model: ReducedModel, missing: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """No units are exchanged then; where all rows are there, they are."""
    exchanged, improved = [], Exchange.improved

    def counted(self: Exchange, *given: Any) -> Bits:
        exchanged.append(self)
        return improved(self, *given)

    monkeypatch.setattr(Exchange, "improved", counted)
    judge = judge_of(sheet, model, {13: 50.0}, missing)
    shown = np.array([6, 7, 12, 18, 19, 20])
    search = Search(judge)
    first = search.best_of(
        state_of(model, shown, np.full(6, 50.0)), [], np.where(np.isin(np.arange(24), shown), 0.8, 0.01)
    )
    assert search.run(first).units.tolist() == [13]
    assert bool(exchanged) != bool(missing)


def test_sets_are_modelled_once_and_as_many_kept_as_starts_need(sheet: ExactSheet, model: ReducedModel) -> None:
    judge = judge_of(sheet, model, {13: 50.0})
    first = judge.state(np.array([13]), np.array([50.0]))
    assert judge.state(np.array([13]), np.array([50.0])) is first
    assert judge.evaluations == 1
    for contrast in np.linspace(2.0, 40.0, 2 * REMEMBERED):
        judge.state(np.array([13]), np.array([contrast]))
    assert len(judge._states) == REMEMBERED
    assert judge.state(np.array([13]), np.array([50.0])) is not first
