"""Touches fitted to one frame: steps of Levenberg and Marquardt on whitened residuals and the prior of touches.

It minimises the *cost*: chi-squared, in which the sheet's deviations are fitted within their spread, plus the cost of
the touches by their prior (:mod:`eitskin_sim.verification.touch_prior`).
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.skin.skin import Skin
from eitskin_sim.arrays import Array
from eitskin_sim.scene.soft_touch import MIN_BORDER_MM
from eitskin_sim.shapes.parameters import (
    BORDER,
    HALF_LENGTH,
    HALF_WIDTH,
    LOG_CONTRAST,
    X,
    Y,
    parameters_of,
    pieces_of,
)
from eitskin_sim.shapes.sheet import Solved
from eitskin_sim.verification import constants as c
from eitskin_sim.verification.residual import Whitener
from eitskin_sim.verification.sheet_model import SheetModel
from eitskin_sim.verification.touch_prior import Joints, TouchPrior, fitted_parameters
from eitskin_sim.verification.verdict import LEVEL, p_value

IMPOSSIBLE_TOUCH_ERRORS: Final = (ValueError, np.linalg.LinAlgError)
"""What touches raise that the sheet cannot have."""


class Budget:
    """The time that one frame may take. Models of the sheet count apart: they serve all frames of a deformation.

    Args:
        budget_s: For the frame.
        clock: In seconds.

    Raises:
        ValueError: The budget is not above 0.
    """

    def __init__(self, budget_s: float, clock: Callable[[], float] = time.perf_counter) -> None:
        if not budget_s > 0.0:
            raise ValueError(f"a budget of {budget_s:g} s: it must be above 0")
        self._budget_s, self._clock, self._begin = budget_s, clock, clock()
        self.models_s = 0.0
        """Spent on models of the sheet."""
        self.fits = 0
        """How often touches were fitted."""

    @property
    def seconds(self) -> float:
        """Return the time spent on the frame, without models."""
        return self._clock() - self._begin - self.models_s

    def begin_again(self) -> None:
        """Count all time until now as spent on models."""
        self.models_s += self.seconds

    def search_over(self) -> bool:
        """Return whether nothing new is to be tried."""
        return self.seconds >= c.SEARCH_SHARE_OF_BUDGET * self._budget_s

    def over(self) -> bool:
        """Return whether the budget is spent."""
        return self.seconds >= self._budget_s

    def over_with_models(self) -> bool:
        """Return whether the budget is spent, models counted."""
        return self.seconds + self.models_s >= self._budget_s


Linear = tuple[Array, Array, npt.NDArray[np.bool_]]
"""(rows + p,) residuals of frame and prior, their (rows + p, r) derivatives, and (n, 7) which parameters are fitted."""


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One frame, against one model of the sheet."""

    model: SheetModel
    white: Whitener
    change: Array
    """(104,) dV"""
    expected: Array
    """(104,) dV that is expected beside the touches'."""
    prior: TouchPrior
    n_shown: int = 0
    """Touches that the search started from."""
    joints: Joints = ()
    """Which of the fitted touches hang together."""

    def at(self, pieces: Array, turning: bool = False) -> "Fit":
        """Return how well some touches explain the frame.

        Args:
            pieces: (n, 8) touches.
            turning: Whether their angles are fitted.

        Raises:
            ValueError: The sheet cannot have them.
        """
        solved, change = self.model.solve(pieces)
        residual = self.white.whiten(self.change - self.expected - change)
        unlikely = self.prior.residuals(pieces, fitted_parameters(pieces, turning), self.joints)
        return Fit(pieces, turning, solved, residual, unlikely, self)


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """Touches, and how well they explain a frame."""

    pieces: Array
    """(n, 8)"""
    turning: bool
    """Whether angles are fitted."""
    solved: Solved
    residual: Array
    """(rows,) whitened."""
    unlikely: Array
    """(p,) residuals of the prior; the last two are those of the mean contrasts."""
    frame: Frame
    _linear: list[Linear] = field(default_factory=list, repr=False)
    """Derivatives here, once they were asked for."""
    _converged: Linear | None = field(default=None, repr=False)
    """Derivatives of a converged fit, from here or before a step that gained next to nothing."""

    @property
    def converged(self) -> bool:
        """Whether another step would gain next to nothing."""
        return self._converged is not None

    @property
    def linear(self) -> Linear:
        """Return residuals and derivatives here."""
        if not self._linear:
            fitted = fitted_parameters(self.pieces, self.turning)
            by = self.frame.model.jacobian(self.solved, fitted)
            self._linear.append(self.with_prior(-self.frame.white.whiten(by.T).T))
        return self._linear[0]

    @property
    def linear_nearby(self) -> Linear:
        """Return the same; of a converged fit from one short step before, which serves for errors."""
        return self._converged if self._converged is not None and not self._linear else self.linear

    def with_prior(self, by: Array) -> Linear:
        """Return residuals and derivatives: those of the rows (rows, r) from elsewhere, the prior's from here."""
        fitted = fitted_parameters(self.pieces, self.turning)
        by_prior = self.frame.prior.jacobian(self.pieces, fitted, self.frame.joints)
        residual = np.concatenate([self.residual, self.unlikely])
        return residual, np.concatenate([by[: len(self.residual)], by_prior]), fitted

    @property
    def chi_squared(self) -> float:
        """The residual of the frame."""
        return float(self.residual @ self.residual)

    @property
    def prior_cost(self) -> float:
        """Cost of what each touch is like, without that of the mean contrasts."""
        return float(self.unlikely[:-2] @ self.unlikely[:-2])

    @property
    def cost(self) -> float:
        """The cost that is minimised."""
        n = len(self.pieces)
        number = self.frame.prior.per_touch * n + c.COST_OF_TOUCH_NOT_SHOWN * max(n - self.frame.n_shown, 0)
        return self.chi_squared + float(self.unlikely @ self.unlikely) + number

    @property
    def degrees_of_freedom(self) -> int:
        """How many of the frame's rows are left once the touches were fitted, the prior counted; 1 at least."""
        rows = len(self.residual)
        if not len(self.pieces):
            return rows
        _, by, _ = self.linear_nearby
        whole, data = by.T @ by, by[:rows].T @ by[:rows]
        fitted = np.trace(np.linalg.solve(whole + 1e-9 * np.diag(np.diag(whole) + 1e-9), data))
        return max(rows - round(float(fitted)), 1)

    @property
    def p_value(self) -> float:
        """The chance that right touches leave as much of the frame, or more."""
        return p_value(self.chi_squared, self.degrees_of_freedom)

    @property
    def explains(self) -> bool:
        """Whether the search need not go on."""
        return self.p_value > c.EXPLAINED_P_OVER_LEVEL * LEVEL


def refine(
    frame: Frame,
    fit: Fit,
    steps: int,
    over: Callable[[], bool] = lambda: False,
    by: Array | None = None,
    below: float = np.inf,
) -> Fit:
    """Return touches moved, resized and made to conduct so that they explain a frame better, never worse.

    Args:
        frame: The frame.
        fit: Where to start.
        steps: The most steps.
        over: Whether time is over: asked before each derivative and each solution, so that one of each is what a frame
            may take longer.
        by: (rows + p, r) derivatives for the first step, from nearby; None takes them anew.
        below: The cost that is of use: where derivatives promise far less, the search ends.
    """
    damping, kept = c.FIRST_DAMPING, False
    for _ in range(steps):
        if not len(fit.pieces) or fit.converged or over():
            return fit
        kept = kept and by is not None
        residual, by, fitted = fit.linear if by is None else fit.with_prior(by)
        gradient, square = by.T @ residual, by.T @ by
        scale = np.diag(square) + 1e-9
        better, shortened = None, False
        for _ in range(c.MAX_STEP_TRIES):
            if over():
                return fit
            step = np.asarray(-np.linalg.solve(square + damping * np.diag(scale), gradient), dtype=np.float64)
            promised = float(-2.0 * (gradient @ step) - step @ square @ step)
            if promised < c.MIN_PROMISED_GAIN_PER_PARAMETER * len(step):
                return replace(fit, _converged=fit.with_prior(by))
            if fit.cost - c.MAX_GAIN_OVER_PROMISED * promised > below:
                return fit
            tried = _try(frame, fit, fitted, step)
            if tried is not None and tried.cost < fit.cost:
                better = tried
                break
            if promised < c.MIN_GAIN_OF_STEP:  # a side may lie on a line of the mesh, where derivatives jump
                return replace(fit, _converged=fit.with_prior(by))
            damping *= c.DAMPING_UP
            shortened = True
        if better is None:
            if not kept:
                return fit
            by = None
            continue
        gain = fit.cost - better.cost
        if gain < c.MIN_GAIN_OF_STEP:
            return replace(better, _converged=better.with_prior(by))
        if gain < c.MIN_GAIN_SHARE_OF_EXCESS * (better.chi_squared - len(better.residual)):
            return better
        by = None if kept else _broyden(by, fit, better, fitted, scale)
        kept, fit = by is not None, better
        if not shortened:
            damping = max(damping / c.DAMPING_DOWN, c.MIN_DAMPING)
    return fit


def _try(frame: Frame, fit: Fit, fitted: npt.NDArray[np.bool_], step: Array) -> Fit | None:
    try:
        return frame.at(bounded(frame.prior, frame.model.skin, fit.pieces, fitted, step), fit.turning)
    except IMPOSSIBLE_TOUCH_ERRORS:
        return None


def _broyden(by: Array, before: Fit, after: Fit, fitted: npt.NDArray[np.bool_], scale: Array) -> Array | None:
    """Return derivatives that agree with what a step has shown; None if it has shown too much."""
    step = (parameters_of(after.pieces) - parameters_of(before.pieces))[fitted]
    rows = by[: len(before.residual)]
    promised = rows @ step
    wrong = after.residual - before.residual - promised
    if wrong @ wrong > c.MAX_ERROR_OF_KEPT_DERIVATIVES**2 * (promised @ promised):
        return None
    weight = scale * step
    return np.asarray(rows + np.outer(wrong, weight / (weight @ step)))


def bounded(prior: TouchPrior, skin: Skin, pieces: Array, fitted: npt.NDArray[np.bool_], step: Array) -> Array:
    """Return touches after a step, shortened and held within what touches may be."""
    values = parameters_of(pieces)
    move = np.zeros(fitted.shape)
    move[fitted] = step
    sign = np.sign(values[:, LOG_CONTRAST])
    values += np.clip(move, -np.array(c.MAX_STEP), c.MAX_STEP)
    values[:, [X, Y]] = on_sheet(values[:, [X, Y]], skin)
    halves = [HALF_LENGTH, HALF_WIDTH]
    values[:, halves] = np.clip(values[:, halves], c.MIN_HALF_SIDE_MM, c.MAX_HALF_SIDE_MM)
    log = np.clip(values[:, LOG_CONTRAST], *np.log(c.CONTRAST_BOUNDS))
    values[:, LOG_CONTRAST] = sign * np.maximum(sign * log, c.MIN_ABS_LOG_CONTRAST)
    graded = pieces[:, 7] > 0.0
    widest = np.minimum(2.0 * values[:, halves].min(axis=1) - 0.01, c.MAX_BORDER_MM)
    values[graded, BORDER] = np.clip(values[graded, BORDER], MIN_BORDER_MM, widest[graded])
    return pieces_of(pieces[:, 0], values)


def on_sheet(centres_mm: Array, skin: Skin) -> Array:
    """Return (n, 2) centres moved onto a skin's sheet."""
    return np.clip(centres_mm, c.MIN_FROM_EDGE_MM, np.array(skin.outline.size_mm) - c.MIN_FROM_EDGE_MM)
