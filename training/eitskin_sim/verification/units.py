"""Touched units that physics has checked: from a network's map to a set that explains the frame, or says it does not.

Each start is modelled once. Where one explains the frame, that is all: the network is usually right. Otherwise units
are added, removed and moved, and contrasts fitted, whichever lowers the cost most::

    cost = chi-squared / inflation  +  what the prior takes for each touch
    inflation = chi-squared of the set in hand / degrees of freedom, at least 1

so that a sheet that is not the model's is not filled with touches. While the residual stays unexplained the search
widens: contrasts of either sign, a set built from nothing, two units changed at once. It ends with its time, and
returns the best that it has seen.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_sim.reduced.model import ReducedModel
from eitskin_sim.reduced.state import State, state_of
from eitskin_sim.verification.chi_squared import LEVEL, p_value
from eitskin_sim.verification.frame import Frame
from eitskin_sim.verification.prior import Prior
from eitskin_sim.verification.residual import Array, Noise, Rows
from eitskin_sim.verification.sets.judge import Judge
from eitskin_sim.verification.sets.price import UnitPrice
from eitskin_sim.verification.sets.search import Search
from eitskin_sim.verification.sheet.model import Model
from eitskin_sim.verification.verdict import Verdict

CONTRAST: Final = 50.0
"""Of a touched unit, where nothing else is known."""

COARSE: Final = 8
"""Patterns a unit of the model on which units are exchanged: chi-squared of a true set is a quarter higher by it."""

ROUGH: Final = 4
"""Of the model that only says which units may help."""

BUDGET_S: Final = 0.02
"""What a frame may take, unless told otherwise,"""

HARD_BUDGET_S: Final = 0.06
"""and one that shows more than ``FEW`` units, or whose rows are not all there: there is more to try, and each try costs
more."""

FEW: Final = 6

SEARCHED: Final = 0.85
"""Part of the budget after which nothing new is begun."""


@dataclass(frozen=True, slots=True)
class UnitTouch:
    """One touched unit."""

    unit: int
    contrast: float
    """Conductivity over the sheet's."""


class UnitVerifier:
    """Explains frames of one shape of the sheet.

    Args:
        model: The sheet at its present shape.
        flat_V: (rows,) V under 1 A of the same model's flat, untouched sheet.
        sheet: How model and sheet may differ; None is not at all.
        contrast: Of touches, at first.
        prior: What touches are like.
        level: Below which p is flagged.
    """

    def __init__(
        self,
        model: ReducedModel,
        flat_V: Array,
        sheet: Model | None = None,
        contrast: float = CONTRAST,
        prior: Prior | None = None,
        level: float = LEVEL,
    ) -> None:
        self._model, self._flat, self._sheet, self._level = model, flat_V, sheet, level
        self._coarse = model.of_rank(min(COARSE, model.rank))
        self._rough = self._coarse.of_rank(min(ROUGH, model.rank))
        self._contrast, self._prior = contrast, prior or Prior(places=model.n_units)

    def verify(
        self,
        change: npt.ArrayLike,
        reference: npt.ArrayLike,
        starts: Sequence[npt.ArrayLike],
        noise: Noise,
        *,
        rows: Rows | None = None,
        budget_s: float | None = None,
        before: Sequence[UnitTouch] = (),
        heights: npt.ArrayLike | None = None,
        clock: Callable[[], float] = time.perf_counter,
    ) -> Verdict[UnitTouch]:
        """Return the set of touched units that explains a frame best.

        Args:
            change: (104,) dV of the frame.
            reference: (104,) V of the flat, untouched sheet.
            starts: (units,) truth values each: what a network's map shows, at one threshold or several.
            noise: Of the frame.
            rows: (104,) which rows there are; None is all.
            budget_s: The search ends after it; 0 only judges the starts. None is ``BUDGET_S``, or ``HARD_BUDGET_S``.
            before: The last frame's touches, another start.
            heights: (units,) of the network's map, from 0 to 1: how sure it is of each unit; None is not known.
            clock: What the budget is counted by, in seconds; ``time.process_time`` on a machine that is shared.

        Raises:
            ValueError: The budget is below 0, or shapes differ.
        """
        begin = time.perf_counter()
        if budget_s is not None and not budget_s >= 0.0:
            raise ValueError(f"a budget of {budget_s:g} s; expected 0 or more")
        dv, held = np.asarray(change, dtype=np.float64), np.asarray(reference, dtype=np.float64)
        sets = [self._start(one) for one in starts]
        shown = self._heights(heights)
        if before:
            sets.append((np.array([one.unit for one in before]), np.array([one.contrast for one in before])))
        sets = sets or [self._start(np.zeros(self._model.n_units))]
        price = UnitPrice(self._model.shape, self._prior, self._contrast)
        hard_s = HARD_BUDGET_S if budget_s is None else budget_s
        if budget_s is None:
            missing = rows is not None and not rows.all()
            budget_s = HARD_BUDGET_S if missing or any(len(units) > FEW for units, _ in sets) else BUDGET_S
        begun = clock()
        ends = begun + SEARCHED * budget_s, begun + SEARCHED * hard_s
        first = state_of(self._model, *sets[0])
        frame = Frame(dv, held, noise, self._sheet, rows, self._signal(first))
        judge = Judge(
            self._model, self._coarse, self._rough, self._flat, frame, price, self._contrast, ends[0], clock, ends[1]
        )
        search = Search(judge)
        best = search.run(search.best_of(first, sets[1:], shown))
        ratio = best.volts / self._flat
        if self._sheet is not None:
            frame = Frame(dv, held, noise, self._sheet, rows, self._signal(best))
        chi = float(frame.chi_squared(ratio))
        degrees = max(len(frame.white) - search.fitted(best), 1)
        order = np.argsort(best.units)
        return Verdict(
            touches=tuple(
                UnitTouch(int(unit), float(contrast))
                for unit, contrast in zip(best.units[order], best.contrasts[order], strict=True)
            ),
            chi_squared=chi,
            degrees_of_freedom=degrees,
            p_value=p_value(chi, degrees),
            level=self._level,
            evaluations=judge.evaluations,
            seconds=time.perf_counter() - begin,
            unfinished=judge.late(),
        )

    def left(
        self, change: Array, reference: Array, noise: Noise, rows: Rows | None, touches: Sequence[UnitTouch]
    ) -> tuple[Frame, Array]:
        """Return a frame as it is judged with some touches, and the (104,) dV of it that they do not explain.

        Args:
            change: (104,) dV of the frame.
            reference: (104,) V of the flat, untouched sheet.
            noise: Of the frame.
            rows: (104,) which rows there are; None is all.
            touches: On it.
        """
        units = np.array([one.unit for one in touches], dtype=np.intp)
        state = state_of(self._model, units, np.array([one.contrast for one in touches]))
        frame = Frame(change, reference, noise, self._sheet, rows, self._signal(state))
        return frame, frame.ratio - state.volts / self._flat

    def _start(self, bits: npt.ArrayLike) -> tuple[npt.NDArray[np.intp], Array]:
        found = np.asarray(bits, dtype=np.bool_)
        if found.shape != (self._model.n_units,):
            raise ValueError(f"a start of shape {found.shape}; expected ({self._model.n_units},) truth values")
        units = np.flatnonzero(found)
        return units, np.full(len(units), self._contrast)

    def _heights(self, heights: npt.ArrayLike | None) -> Array | None:
        if heights is None:
            return None
        found = np.asarray(heights, dtype=np.float64)
        if found.shape != (self._model.n_units,) or not np.isfinite(found).all():
            raise ValueError(f"heights of shape {found.shape}; expected {self._model.n_units} finite ones, from 0 to 1")
        return found

    def _signal(self, state: State) -> Array:
        """Return (rows,) dV that a set of touches makes."""
        return np.asarray((state.volts - self._model.untouched_V) / self._flat)
