"""Damped Gauss-Newton with priors: the most probable parameters and their covariance.

It minimises |r(z)|^2 + |z|^2, r the whitened residuals and z in prior standard deviations: minus twice the logarithm of
the posterior. With J the derivative, H = J^T J + 1 is its curvature and H^-1 the covariance of z. If the stated
uncertainties are right, the minimum is chi-square distributed with as many degrees of freedom as there are rows,
because of the priors. So a misfit can be distinguished from noise without counting parameters.

A device that is 20 % off is two hundred times its noise away, where the problem is far from linear. So rows first get a
relative error of ``SOFTENING_ERRORS``, then less, and in the end their own.

Parameters stay where a sheet is possible: the model gives their bounds, and a parameter at its bound stays there while
it is pushed out. A search that does not converge returns the best parameters that it found, and says so.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from scipy.stats import chi2

from eitskin_proto.errors import SkinError
from eitskin_sim.arrays import Array

SOFTENING_ERRORS: Final = (0.1, 0.01, 0.002, 0.0)
"""Relative errors that are added to every row, one after the other."""

MAX_STEP_SD: Final = 1.0
"""Largest change of a parameter in a step, in prior standard deviations."""

UPHILL_STEPS: Final = 4
"""First steps that may go uphill: a bent valley is crossed in one where damped steps creep along its floor."""

PUSH_SD: Final = 1e-6
"""A parameter that cannot move so far down the misfit is at its bound."""

MAX_STEPS: Final = 25
FINAL_STEP_SD: Final = 0.02
ROUGH_STEP_SD: Final = 0.3
"""A step that is shorter, in posterior standard deviations of a parameter, is the last one; or the last but exact."""

MAX_DAMPING: Final = 1e6
MISFIT_LEVEL: Final = 1e-4
"""How often an honest recording is called a misfit."""

NAMED_ROW_SD: Final = 4.0
"""Rows whose residual exceeds its expected size by this factor are named."""


MIN_GAIN: Final = 0.1
"""Of minus twice the log posterior: a step that gains less moves no parameter by what its standard error would show."""

MIN_GAIN_SHARE: Final = 1e-3
"""The same as a share of the whole, where the whole is far above noise."""

LEVEL_STEPS: Final = 5
"""The search ends where none of this many last steps gained ``MIN_GAIN``, or ``MIN_GAIN_SHARE`` of the whole: it then
zigzags along a curved valley, with small gains."""


class CalibrationError(SkinError):
    """Nothing could be calibrated; the text says why, and what to do."""


class Residuals(Protocol):
    """What is fitted."""

    @property
    def count(self) -> int:
        """How many parameters."""

    def inside(self, z: Array) -> Array:
        """Return the nearest (count,) parameters that a sheet can have."""

    def soften(self, z: Array, error: float) -> None:
        """Take rows for uncertain by a share of them."""

    def residuals(self, z: Array) -> Array:
        """Return the (rows,) whitened residuals."""

    def linearised(self, z: Array) -> tuple[Array, Array]:
        """Return them, and the (rows, count) Jacobian of what should be read."""


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """The most probable parameters."""

    z: Array
    """(count,) in prior standard deviations."""
    sd: Array
    """(count,) standard errors of them: 1 where nothing was learned."""
    residuals: Array
    """(rows,) over their noise."""
    expected: Array
    """(rows,) standard deviations that they should have, below 1 where parameters follow them."""
    steps: int
    settled: bool = True
    """Whether the search converged."""

    @property
    def misfit(self) -> float:
        """|r|^2 + |z|^2, over the rows: about 1."""
        return float((self.residuals @ self.residuals + self.z @ self.z) / len(self.residuals))

    @property
    def limit(self) -> float:
        """The limit that chance alone exceeds once in ten thousand recordings."""
        return _limit(len(self.residuals)) / len(self.residuals)

    @property
    def far(self) -> Array:
        """(rows,) residuals over what they should be."""
        return np.asarray(self.residuals / np.maximum(self.expected, 0.1))


def fit(
    model: Residuals,
    progress: Callable[[int, float], None] | None = None,
    *,
    start: Array | None = None,
    soft: Sequence[float] = SOFTENING_ERRORS,
    done: int = 0,
    rough: bool = False,
) -> Fit:
    """Return the most probable parameters.

    Args:
        model: What is fitted.
        progress: Called before each step with its number and the misfit.
        start: (count,) where the search begins; None is the stated values.
        soft: Relative errors that are added to every row, one after the other; the last is 0.
        done: Steps that were taken already.
        rough: The model is not smooth, as under touches whose borders cross elements: stop when the gain is
            insignificant.

    The misfit may be above its limit: the caller checks it.
    """
    z = np.zeros(model.count) if start is None else start
    steps = done
    for error in soft:
        model.soften(z, error)
        last = error == soft[-1]
        found, taken, settled = _descend(model, z, last=last, done=steps, progress=progress, rough=rough)
        z, residuals, jacobian = found
        steps += taken
    covariance = np.linalg.inv(jacobian.T @ jacobian + np.eye(len(z)))
    learned = np.einsum("ri,ij,rj->r", jacobian, covariance, jacobian)
    return Fit(z, np.sqrt(np.diag(covariance)), residuals, np.sqrt(np.clip(1.0 - learned, 0.0, 1.0)), steps, settled)


def _descend(
    model: Residuals,
    z: Array,
    *,
    last: bool,
    done: int,
    progress: Callable[[int, float], None] | None,
    rough: bool,
) -> tuple[tuple[Array, Array, Array], int, bool]:
    """Return where the misfit is least, with residuals and Jacobian, the steps, and whether no step gains any more.

    Only the last descent need be exact.
    """
    damping = 0.0
    residuals, jacobian = model.linearised(z)
    cost, gains = float(residuals @ residuals + z @ z), []
    least, best = cost, (z, residuals, jacobian)
    for step in range(1, MAX_STEPS + 1):
        if progress is not None:
            progress(done + step, cost / len(residuals))
        curvature = jacobian.T @ jacobian + np.eye(len(z))
        slope = jacobian.T @ residuals - z
        held = np.abs(model.inside(z + PUSH_SD * np.sign(slope)) - z) < PUSH_SD / 2.0
        held &= slope != 0.0
        curvature[held], curvature[:, held], slope[held] = 0.0, 0.0, 0.0
        curvature[held, held] = 1.0
        while True:
            change = np.linalg.solve(curvature + damping * np.diag(np.diag(curvature)), slope)
            whole = change * min(1.0, MAX_STEP_SD / np.abs(change).max())
            at = model.inside(z + whole)
            tried = _cost(model, at)
            if tried <= cost * (1.0 + 1e-9) or (step <= UPHILL_STEPS and not damping and np.isfinite(tried)):
                break
            damping = max(10.0 * damping, 1e-2)
            if damping > MAX_DAMPING:
                return best, step, rough or cost <= _limit(len(residuals))
        far = float(np.sqrt(whole @ curvature @ whole / len(z)))
        damped = damping > 1e-3
        damping = damping / 10.0 if damped else 0.0
        try:
            residuals, jacobian = model.linearised(at)
        except (ValueError, RuntimeError):  # there is such a sheet, but none beside it
            return best, step, False
        z, before, cost = at, cost, float(residuals @ residuals + at @ at)
        if cost <= least:
            least, best = cost, (z, residuals, jacobian)
        gains.append(abs(before - cost))
        if rough and step > UPHILL_STEPS and gains[-1] < MIN_GAIN + MIN_GAIN_SHARE * cost:
            return best, step, True
        if far < (FINAL_STEP_SD if last else ROUGH_STEP_SD) and not damped:
            return best, step, True
        if step >= LEVEL_STEPS and max(gains[-LEVEL_STEPS:]) < max(MIN_GAIN, MIN_GAIN_SHARE * cost):
            return best, step, max(gains[-LEVEL_STEPS:]) < MIN_GAIN
    return best, MAX_STEPS, False


def _limit(rows: int) -> float:
    """Return the value that |r|^2 + |z|^2 exceeds by chance once in ten thousand recordings."""
    return float(chi2.isf(MISFIT_LEVEL, rows))


def _cost(model: Residuals, z: Array) -> float:
    try:
        found = model.residuals(z)
    except (ValueError, RuntimeError):  # of parameters that no sheet has
        return np.inf
    return float(found @ found + z @ z)
