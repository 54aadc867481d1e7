"""What sets of touched units cost on one frame, and whether they explain it."""

import time
from collections.abc import Callable
from typing import Final

import numpy as np

from eitskin_sim.fem.mesh import Array, Index
from eitskin_sim.reduced.model import ReducedModel
from eitskin_sim.reduced.state import State, state_of
from eitskin_sim.verification.chi_squared import least_chi_squared
from eitskin_sim.verification.frame import Frame
from eitskin_sim.verification.sets.price import UnitPrice

REMEMBERED: Final = 32
"""Sets that are kept: starts are asked for again and again."""

CONTENT: Final = 0.05
"""The search ends where p is above."""


class Judge:
    """Judges sets on one frame.

    Args:
        model: The sheet.
        coarse: The same of a lower rank, where many sets are tried.
        rough: Of a rank that only says which units may help.
        flat_V: (rows,) V of the flat, untouched one.
        frame: What is to be explained.
        price: Of sets.
        usual: The usual contrast.
        deadline: What the clock shows when time is up.
        clock: In seconds.
        hard_deadline: What it shows then where a frame turns out to be hard; None is the same.
    """

    def __init__(
        self,
        model: ReducedModel,
        coarse: ReducedModel,
        rough: ReducedModel,
        flat_V: Array,
        frame: Frame,
        price: UnitPrice,
        usual: float,
        deadline: float,
        clock: Callable[[], float] = time.perf_counter,
        hard_deadline: float | None = None,
    ) -> None:
        self.model, self.coarse, self.rough = model, coarse, rough
        self.flat, self.frame = flat_V, frame
        self.price, self.usual, self._deadline, self._clock = price, usual, deadline, clock
        self._hard_deadline = deadline if hard_deadline is None else hard_deadline
        self.content = least_chi_squared(CONTENT, len(frame.white))
        """Chi-squared below which a set explains the frame."""
        row, column = np.divmod(np.arange(model.n_units), model.shape[1])
        self.distance: Index = np.maximum(np.abs(row[:, None] - row), np.abs(column[:, None] - column))
        """(units, units) how far they lie from each other, along or across."""
        self.rows_missing = not frame.white.rows.all()
        """Whether a frame lacks rows: several sets may explain what is left."""
        self.evaluations = 0
        self._states: dict[tuple[bytes, bytes, bool], State] = {}

    def is_hard(self) -> None:
        """Take the time that a hard frame has."""
        self._deadline = self._hard_deadline

    def late(self) -> bool:
        """Return whether time is up."""
        return self._clock() >= self._deadline

    def state(self, units: Index, contrasts: Array, *, coarse: bool = False) -> State:
        """Return a set of touched units on the whole model, or on the coarse one."""
        key = units.tobytes(), contrasts.tobytes(), coarse
        if key not in self._states:
            self.evaluations += 1
            while len(self._states) >= REMEMBERED:
                self._states.pop(next(iter(self._states)))
            self._states[key] = state_of(self.coarse if coarse else self.model, units, contrasts)
        return self._states[key]

    def as_whole(self, state: State) -> State:
        """Return a set on the whole model."""
        return state if state.model is self.model else self.state(state.units, state.contrasts)

    def as_coarse(self, state: State) -> State:
        """Return a set on the coarse model."""
        return state if state.model is self.coarse else self.state(state.units, state.contrasts, coarse=True)

    def chi(self, state: State) -> float:
        """Return the chi-squared of a set."""
        return float(self.frame.chi_squared(state.volts / self.flat))

    def chis(self, volts: Array) -> Array:
        """Return (n,) the chi-squared of as many sets' (n, rows) V."""
        self.evaluations += len(volts)
        return self.frame.chi_squared(volts / self.flat)

    def explained(self, state: State) -> bool:
        """Return whether a set explains the frame."""
        return self.chi(state) <= self.content

    def cost(self, state: State, chi: float, inflation: float = 1.0) -> float:
        """Return the cost of a set."""
        return chi / inflation + self.price.of(state.units, state.contrasts)

    def inflation(self, chi: float) -> float:
        """Return what gains are divided by where no set is known that leaves less."""
        return max(chi / len(self.frame.white), 1.0)

    def better(self, first: State, second: State) -> State:
        """Return the cheaper of two sets, at the inflation of the better explained one."""
        one, two = self.chi(first), self.chi(second)
        inflation = self.inflation(min(one, two))
        return second if self.cost(second, two, inflation) < self.cost(first, one, inflation) else first
