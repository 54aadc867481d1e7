"""Sets of touched units of any contrast, grown from what physics alone says: no network need have seen them.

What a unit adds to the whitened voltages has nearly the same form at all contrasts c, and the size g(c) = 2 (c - 1) /
(c + 1), of either sign. So with d_u the change that unit u brings at one contrast beside the present set, and the
set's own contrasts free to change along (their slopes are projected out of d and of what the set leaves, r)::

    gain_u = (d_u r)^2 / |d_u|^2,        amplitude_u = d_u r / |d_u|^2        a matched filter, of both signs

The best units of a step, in the order of orthogonal least squares, come in together, each with the contrast that its
amplitude says. All contrasts are then fitted on the model, and units taken out again that do not pay.
"""

from collections.abc import Callable
from typing import Final

import numpy as np

from eitskin_sim.fem.mesh import Array, Index
from eitskin_sim.reduced.model import ReducedModel
from eitskin_sim.reduced.state import State, state_of
from eitskin_sim.verification.frame import Frame
from eitskin_sim.verification.sets.contrasts import fitted, within
from eitskin_sim.verification.sets.price import FREE, UnitPrice

LOOK: Final = 3.0
"""Contrast at which changes are looked at; g is 1 there."""

TOGETHER: Final = 6
"""Units that come in with one step, at most."""

SHARE: Final = 0.03
"""A unit comes in with others where it answers such a part of what is unexplained: less may be their curvature."""

INFLATION: Final = 2.0
"""Gains in chi-squared are divided by it."""

MOST: Final = 14
"""Sets grow no further."""

SPARE: Final = 2
"""Units that hardly count, each taken out once more with the others' contrasts fitted anew."""

FITS: Final = 3
"""Steps of a fit of contrasts."""


class Growth:
    """Grows sets on one frame.

    Args:
        model: The sheet; a coarse one will do.
        flat_V: (rows,) V of the flat, untouched one.
        frame: What is to be explained.
        price: Of sets.
        content: Chi-squared below which a set explains the frame.
        late: Says when time is up.
    """

    def __init__(
        self,
        model: ReducedModel,
        flat_V: Array,
        frame: Frame,
        price: UnitPrice,
        content: float,
        late: Callable[[], bool],
    ) -> None:
        self._model, self._flat, self._frame, self._price = model, flat_V, frame, price
        self._content, self._late = content, late
        self.evaluations = 0

    def grown(self, units: Index, contrasts: Array) -> State:
        """Return the cheapest set that is reached from some units; theirs are the first contrasts."""
        best = self._state(units, contrasts)
        if len(units):
            best = self._pruned(self._fit(best))
        while not self._late() and len(best.units) < MOST and self._chi(best) > self._content:
            new, amplitudes = self._additions(best)
            found = best
            for count in dict.fromkeys((len(new), 1)):
                if not count or self._late():
                    break
                found = self._with(best, new[:count], amplitudes[:count])
                if self._cost(found) < self._cost(best):
                    break
            if self._cost(found) >= self._cost(best):
                break
            best = found
        return self._settled(best)

    def _settled(self, state: State) -> State:
        """Return a set without units that do not pay once the others' contrasts have changed along."""
        while len(state.units) > 1 and not self._late():
            without = self._frame.chi_squared(state.without_each() / self._flat)
            fewer = [self._fit(state.without(number)) for number in np.argsort(without)[:SPARE].tolist()]
            best = min(fewer, key=self._cost)
            if self._cost(best) >= self._cost(state):
                break
            state = best
        return state

    def _with(self, state: State, new: Index, amplitudes: Array) -> State:
        """Return a set with some units more, of contrasts by their amplitudes, fitted and rid of what does not pay."""
        size = np.clip(amplitudes, -1.63, 1.98)
        logs = within(np.log((2.0 + size) / (2.0 - size)), np.sign(size))
        more = self._state(np.append(state.units, new), np.append(state.contrasts, np.exp(logs)))
        return self._pruned(self._fit(more))

    def _additions(self, state: State) -> tuple[Index, Array]:
        """Return units that would answer most of what a set leaves, the best first, and their amplitudes."""
        free = np.setdiff1d(np.arange(self._model.n_units), state.units)
        self.evaluations += len(free)
        changes = self._frame.whiten((state.with_each(free, LOOK) - state.volts) / self._flat)
        left = self._left(state)
        whole = float(left @ left)
        if len(state.units):
            basis = np.linalg.qr(self._frame.whiten(state.slopes() / self._flat).T)[0]
            changes, left = changes - (changes @ basis) @ basis.T, left - basis @ (basis.T @ left)
        # a unit whose change is nearly that of the set's own contrasts says nothing of its own
        size = np.einsum("nr,nr->n", changes, changes)
        least = 1e-3 * float(size.max())
        chosen: list[int] = []
        now, rest = changes.copy(), left.copy()
        price = self._price.more(free, state.units) + FREE
        for _ in range(TOGETHER):
            size = np.einsum("nr,nr->n", now, now)
            gain = np.where(size > least, (now @ rest) ** 2 / np.maximum(size, least), 0.0)
            at = int(np.argmax(gain / INFLATION - price))
            if gain[at] / INFLATION <= price[at] or (chosen and gain[at] < SHARE * whole):
                break
            chosen.append(at)
            one = now[at] / np.sqrt(size[at])
            rest = rest - one * (one @ rest)
            now = now - np.outer(now @ one, one)
        if not chosen:
            return free[:0], np.zeros(0)
        amplitudes = np.asarray(np.linalg.lstsq(changes[chosen].T, left, rcond=None)[0], dtype=np.float64)
        return free[chosen], amplitudes

    def _pruned(self, state: State) -> State:
        """Return a set without units that do not pay, the least first."""
        while len(state.units) and not self._late():
            self.evaluations += len(state.units)
            chis = self._frame.chi_squared(state.without_each() / self._flat)
            costs = [
                chi / INFLATION + self._price.of(np.delete(state.units, i), np.delete(state.contrasts, i))
                for i, chi in enumerate(chis.tolist())
            ]
            at = int(np.argmin(costs))
            if costs[at] >= self._cost(state):
                break
            state = state.without(at)
        return state

    def _fit(self, state: State) -> State:
        found = fitted(self._frame, self._flat, state, common=False, steps=FITS, late=self._late)
        self.evaluations += FITS
        return found

    def _state(self, units: Index, contrasts: Array) -> State:
        self.evaluations += 1
        return state_of(self._model, units, contrasts)

    def _left(self, state: State) -> Array:
        return self._frame.whiten(self._frame.ratio - state.volts / self._flat)

    def _chi(self, state: State) -> float:
        return float(self._frame.chi_squared(state.volts / self._flat))

    def _cost(self, state: State) -> float:
        return self._chi(state) / INFLATION + self._price.of(state.units, state.contrasts)
