"""Exchanges of units: what steps of one unit cannot mend, and that they end."""

import numpy as np
import pytest
from tests.sim.verification.small_frames import judge_of

from eitskin_sim.reduced.exact import ExactSheet
from eitskin_sim.reduced.model import ReducedModel
from eitskin_sim.reduced.state import state_of
from eitskin_sim.verification.sets.candidates import Candidates
from eitskin_sim.verification.sets.exchange import Exchange

TRUE = [8, 10, 19]
CONTENT = 130.0


class Case:
    """An exchange on one frame, and what starts it."""

    def __init__(
        self,
        sheet: ExactSheet,
        model: ReducedModel,
        late: bool = False,
        content: float = CONTENT,
        heights: np.ndarray | None = None,
        contrasts: tuple[float, ...] = (50.0,),
    ) -> None:
        true = dict.fromkeys(TRUE, contrasts[0])
        self.judge = judge_of(sheet, model, true, deadline=-1.0 if late else 1.0, heights=heights)
        self.judge.content = content
        self.candidates = Candidates.of(*(np.full(24, one) for one in contrasts))
        self.search = Exchange(self.judge, self._explains)

    def _explains(self, units: np.ndarray, contrasts: np.ndarray) -> bool:
        return self.judge.explained(self.judge.state(units, contrasts))

    def found(self, *starts: list[int], most: int | None = None) -> list[int]:
        every = [self.candidates.bits(np.array(one, dtype=np.intp)) for one in starts]
        return sorted(self.candidates.units[self.search.improved(every, self.candidates, most)].tolist())


def test_a_unit_between_two_that_are_touched_becomes_the_two(sheet: ExactSheet, model: ReducedModel) -> None:
    assert Case(sheet, model).found([9, 19]) == TRUE


def test_two_that_are_each_one_place_off_are_put_right(sheet: ExactSheet, model: ReducedModel) -> None:
    assert Case(sheet, model).found([2, 16, 19]) == TRUE


def test_what_the_network_doubts_is_tried_first(sheet: ExactSheet, model: ReducedModel) -> None:
    heights = np.full(24, 0.0005)
    heights[[8, 10, 19, 9]] = 0.3, 0.2, 0.999, 0.7
    doubting, blind = Case(sheet, model, content=1000.0, heights=heights), Case(sheet, model, content=1000.0)
    assert doubting.found([9, 19]) == blind.found([9, 19]) == TRUE
    assert doubting.judge.evaluations < blind.judge.evaluations


def test_a_map_that_is_wrong_and_sure_of_it_is_overruled(sheet: ExactSheet, model: ReducedModel) -> None:
    heights = np.full(24, 0.0005)
    heights[[9, 19]] = 0.9995
    assert Case(sheet, model, heights=heights).found([9, 19]) == TRUE


def test_a_unit_is_in_a_set_at_one_contrast_only(sheet: ExactSheet, model: ReducedModel) -> None:
    case = Case(sheet, model, contrasts=(0.4, 50.0))
    bits = case.search.improved([case.candidates.bits(np.array([9, 19 + 24]))], case.candidates)
    assert sorted(case.candidates.units[bits].tolist()) == TRUE
    assert case.candidates.contrasts[bits].tolist() == [0.4, 0.4, 0.4]


def test_a_search_that_was_interrupted_goes_on_where_it_was(sheet: ExactSheet, model: ReducedModel) -> None:
    case = Case(sheet, model, content=0.0)
    chi = [np.inf]
    for _ in range(12):
        units = case.found([2], most=1)
        state = case.judge.state(np.array(units, dtype=np.intp), np.full(len(units), 50.0), coarse=True)
        chi.append(case.judge.cost(state, case.judge.chi(state), 2.0))
        assert chi[-1] <= chi[-2]
    assert chi[-1] < chi[1]


def test_the_search_ends_where_nothing_explains_the_frame(sheet: ExactSheet, model: ReducedModel) -> None:
    case = Case(sheet, model, content=0.0)
    assert case.found([9]) == TRUE
    assert case.judge.evaluations < 20_000


def test_without_time_the_cheapest_start_is_the_answer(sheet: ExactSheet, model: ReducedModel) -> None:
    assert Case(sheet, model, late=True).found([9], [8, 10], [0]) == [8, 10]


def test_a_model_of_fewer_patterns_is_nearly_the_model(sheet: ExactSheet, model: ReducedModel) -> None:
    coarse, units = model.of_rank(8), np.array(TRUE)
    whole, part = (state_of(one, units, np.full(3, 50.0)).volts for one in (model, coarse))
    off = np.sqrt(np.mean(np.log(part / whole) ** 2))
    assert 0.0 < off < 0.02
    assert coarse.nbytes < model.nbytes / 3
    with pytest.raises(ValueError, match="expected from 1 to 16"):
        model.of_rank(17)


def test_two_candidates_beside_a_set_are_the_set_with_both(model: ReducedModel) -> None:
    state = state_of(model, np.array([8, 19]), np.array([50.0, 0.4]))
    places = np.array([0, 3, 9, 22])
    found = state.beside(places, 20.0).two(np.array([0, 1]), np.array([2, 3]))
    for row, pair in zip(found, ([0, 9], [3, 22]), strict=True):
        whole = state_of(model, np.array([8, 19, *pair]), np.array([50.0, 0.4, 20.0, 20.0]))
        assert row == pytest.approx(whole.volts, rel=1e-9)
