"""Contrasts of a set of touched units, fitted to a frame: one for all of them, or one for each."""

from collections.abc import Callable
from typing import Final

import numpy as np

from eitskin_sim.fem.mesh import Array
from eitskin_sim.reduced.state import State, state_of
from eitskin_sim.verification.frame import Frame
from eitskin_sim.verification.sets.candidates import Free
from eitskin_sim.verification.sets.judge import Judge
from eitskin_sim.verification.sets.price import LOG_SD

RANGE: Final = (0.1, 200.0)
"""Contrasts are fitted within."""

NEAR_ONE: Final = 0.05
"""No contrast's logarithm is fitted nearer to 0: such a touch is none."""

MOST_DIPOLE: Final = 0.98
"""Of a unit of contrast 100, over that of a perfect conductor."""

STEPS: Final = 4
"""Of Gauss-Newton."""


def never() -> bool:
    """Return False: there is always time."""
    return False


def fitted(
    frame: Frame, flat_V: Array, state: State, *, common: bool, steps: int = STEPS, late: Callable[[], bool] = never
) -> State:
    """Return a set with its contrasts fitted by Gauss and Newton, each within its sign, never worse.

    Args:
        frame: What is to be explained.
        flat_V: (rows,) V of the flat, untouched sheet.
        state: The set to begin with; at least one unit.
        common: All change by one factor; else each by its own.
        steps: The most.
        late: Says when time is up.
    """
    start = np.log(state.contrasts)
    at = start.copy()
    best, best_chi = state, float(frame.chi_squared(state.volts / flat_V))
    for _ in range(steps):
        slopes = frame.whiten(state.slopes() / flat_V)
        left = frame.whiten(frame.ratio - state.volts / flat_V)
        if common:
            slopes = slopes.sum(axis=0, keepdims=True)
        inflation = max(float(left @ left) / len(frame.white), 1.0)
        square = slopes @ slopes.T / inflation + np.eye(len(slopes)) / LOG_SD**2
        pull = slopes @ left / inflation
        if not common:
            pull = pull + (start - at) / LOG_SD**2
        at = within(at + np.clip(np.linalg.solve(square, pull), -1.0, 1.0), np.sign(start))
        state = state_of(state.model, state.units, np.exp(at))
        chi = float(frame.chi_squared(state.volts / flat_V))
        if chi >= best_chi * (1.0 - 1e-4):
            break
        best, best_chi = state, chi
        if late():
            break
    return best


def refitted(judge: Judge, state: State, free: Free, steps: int = STEPS) -> State:
    """Return a set with its contrasts fitted as far as they are free.

    Args:
        judge: Of sets on the frame.
        state: The set.
        free: Which contrasts.
        steps: Of Gauss and Newton, the most.
    """
    if free == "none" or not len(state.units):
        return state
    judge.evaluations += steps
    return fitted(judge.frame, judge.flat, state, common=free == "common", steps=steps, late=judge.late)


def within(logs: Array, signs: Array) -> Array:
    """Return logarithms of contrasts held within ``RANGE``, each on the side of 1 that its sign says."""
    most = np.where(signs > 0, np.log(RANGE[1]), -np.log(RANGE[0]))
    return np.asarray(signs * np.clip(signs * logs, NEAR_ONE, most))


def estimated(frame: Frame, flat_V: Array, state: State) -> Array:
    """Return the contrast of each unit of a set that the frame says by least squares, of either sign.

    What a unit changes has nearly one form at all contrasts c, and the size of a disc's dipole, (c - 1) / (c + 1).

    Args:
        frame: What is to be explained.
        flat_V: (rows,) V of the flat, untouched sheet.
        state: The set; its contrasts are not 1.
    """
    nothing = state_of(state.model, state.units[:0], state.contrasts[:0])
    volts = np.empty((len(state.units), len(frame.ratio)))
    for contrast in np.unique(state.contrasts):
        at = state.contrasts == contrast
        volts[at] = nothing.with_each(state.units[at], float(contrast))
    forms = frame.whiten((volts - nothing.volts) / flat_V).T
    left = frame.whiten(frame.ratio - nothing.volts / flat_V)
    shares, *_ = np.linalg.lstsq(forms, left, rcond=None)
    dipoles = np.clip(shares * (state.contrasts - 1.0) / (state.contrasts + 1.0), -MOST_DIPOLE, MOST_DIPOLE)
    logs = np.log((1.0 + dipoles) / (1.0 - dipoles))
    return np.asarray(np.exp(within(logs, np.where(logs < 0.0, -1.0, 1.0))))
