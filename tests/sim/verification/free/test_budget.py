"""A frame keeps its budget, whatever it says: work is counted by solutions and derivatives, not by a clock."""

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from eitskin_proto.skin.cloud import flat_cloud
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.verification.free.effort import Effort
from eitskin_sim.verification.free.found import map_of
from eitskin_sim.verification.free.search import FreeVerifier
from eitskin_sim.verification.residual import Noise
from eitskin_sim.verification.sheet.deformation import ANEW
from eitskin_sim.verification.sheet.model import Model, flat_model_V

Array = npt.NDArray[np.float64]

STEP = 4
"""The derivative and the solution underway, the last derivative for errors and degrees of freedom, and one to spare."""


class Work:
    """Counts what a model is asked for, and is the clock."""

    def __init__(self) -> None:
        self.done = 0

    def __call__(self) -> float:
        return float(self.done)


@pytest.fixture(scope="module")
def flat_V() -> Array:
    return flat_model_V(PAPER)


@pytest.fixture(scope="module")
def prepared(flat_V: Array) -> Model:
    own = FreeVerifier(flat_V, Noise("N2", 50.0))
    own.deform(flat_cloud())
    return own.deformation.model


@pytest.fixture
def counted(flat_V: Array, prepared: Model, monkeypatch: pytest.MonkeyPatch) -> tuple[FreeVerifier, Work]:
    """Return a verifier whose clock is its own work, on a model that stays as it is."""
    work = Work()
    for name in ("solve", "jacobian"):
        whole = getattr(Model, name)

        def count(*arguments: Any, whole: Any = whole) -> Any:
            work.done += 1
            return whole(*arguments)

        monkeypatch.setattr(Model, name, count)
    own = FreeVerifier(flat_V, Noise("N2", 50.0), clock=work)
    own.deformation.scan(lambda: prepared)
    own.deformation._anew = ANEW
    return own, work


def pieces_of(count: int) -> Array:
    rng = np.random.default_rng(1)
    sides = rng.uniform(5.0, 12.0, (count, 2))
    at = np.column_stack([rng.uniform(8.0, 142.0, count), rng.uniform(8.0, 92.0, count)])
    still = np.tile([0.0, 50.0, 0.0], (count, 1))
    return np.column_stack([np.zeros(count), at, sides, still])


def shares_of(pieces: Array) -> Array:
    return np.array([map_of(one[None]) for one in pieces]).reshape(len(pieces), *PAPER.grid.shape)


FRAMES = {
    "random, none shown": (0, "random"),
    "random, three shown": (3, "random"),
    "signs at random": (3, "signs"),
    "saturated": (3, "saturated"),
    "40 touches shown": (40, "random"),
    "a map full of touch": (-1, "random"),
}


@pytest.mark.parametrize("name", FRAMES)
def test_nonsense_keeps_its_budget_and_is_flagged(name: str, counted: tuple[FreeVerifier, Work], flat_V: Array) -> None:
    shown, kind = FRAMES[name]
    own, work = counted
    rng = np.random.default_rng(5)
    volts = {
        "random": flat_V * rng.uniform(0.2, 3.0, 104),
        "signs": flat_V * 3.0 * rng.standard_normal(104),
        "saturated": np.full(104, 5.0) * np.sign(flat_V),
    }[kind]
    shares = np.ones((1, *PAPER.grid.shape)) if shown < 0 else shares_of(pieces_of(shown))
    budget = 3 if shown == 40 else 12
    verdict = own.verify(volts, shares, budget_s=budget)
    assert work.done <= budget + STEP
    assert verdict.flagged
    assert np.isfinite(verdict.pieces).all()


def test_more_time_gives_no_worse_answer(counted: tuple[FreeVerifier, Work], prepared: Model, flat_V: Array) -> None:
    own, _ = counted
    two = pieces_of(2)
    volts = flat_V * (1.0 + prepared.solve(two)[1]) * (1.0 + 3e-3 * np.random.default_rng(3).standard_normal(104))
    frame = own._frame(volts / flat_V - 1.0)
    start = two + np.array([0, 3.0, -2.0, 2.0, 1.0, 0, 0, 0])
    costs = []
    for budget in (1, 2, 4, 8, 16, 32):
        found = own.verify(volts, shares_of(start), budget_s=budget)
        costs.append(frame.at(found.pieces).cost)
    assert costs == sorted(costs, reverse=True)
    assert costs[-1] < costs[0]


def test_a_touch_that_there_was_no_time_to_confirm_flags_the_frame(
    counted: tuple[FreeVerifier, Work], prepared: Model, flat_V: Array
) -> None:
    own, _ = counted
    one = pieces_of(1)
    volts = flat_V * (1.0 + prepared.solve(one)[1])
    none = np.zeros((0, *PAPER.grid.shape))
    assert own.verify(volts, none, one, budget_s=1.0).flagged
    assert not own.verify(volts, none, one, budget_s=500.0).flagged


def test_what_is_no_frame_is_said_in_a_line(counted: tuple[FreeVerifier, Work], flat_V: Array) -> None:
    own, _ = counted
    none = np.zeros((0, *PAPER.grid.shape))
    odd = flat_V.copy()
    odd[[3, 7]] = np.nan, np.inf
    for volts, shares, text in (
        (odd, none, "voltages: 2 of 104 are not finite"),
        (flat_V, np.full((1, *PAPER.grid.shape), np.nan), "shares of the map: 1350 of 1350 are not finite"),
        (flat_V[:8], none, r"voltages \(8,\): expected \(104,\)"),
    ):
        with pytest.raises(ValueError, match=text) as error:
            own.verify(volts, shares, budget_s=1.0)
        assert "\n" not in str(error.value)
    few = FreeVerifier(np.where(np.arange(104) < 103, 0.0, flat_V), Noise())
    few.deformation = own.deformation
    with pytest.raises(ValueError, match="1 rows are left"):
        few.verify(flat_V, none, budget_s=1.0)


def test_a_frame_of_nonsense_does_not_spoil_the_model_of_the_next(
    counted: tuple[FreeVerifier, Work], flat_V: Array
) -> None:
    own, _ = counted
    own.deformation._anew, before = 0, own.deformation.model
    own.verify(flat_V * np.random.default_rng(5).uniform(0.2, 3.0, 104), shares_of(pieces_of(1)), budget_s=8)
    assert own.deformation.model is before


def test_models_count_apart_and_there_must_be_time() -> None:
    now = [0.0]
    effort = Effort(1.0, lambda: now[0])
    now[0] = 0.9
    assert (effort.searched(), effort.over()) == (True, False)
    effort.setup_s = 0.5
    assert not effort.searched()
    now[0] = 1.2
    assert (effort.over(), effort.over_with_models()) == (False, True)
    for budget in (0.0, -1.0, np.nan):
        with pytest.raises(ValueError, match="must be above 0"):
            Effort(budget)
