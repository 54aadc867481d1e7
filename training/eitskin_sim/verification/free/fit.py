"""Touches fitted to one frame: Levenberg and Marquardt's steps on whitened residuals, with a prior on what touches are.

What is minimised is chi-squared, what is unseen of the sheet fitted along within its bounds, and the prior's cost
(:mod:`eitskin_sim.verification.free.prior.costs`). Every touch costs the logarithm of the places where it might be
besides (:mod:`eitskin_sim.verification.prior`).
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.skin.skin import Skin
from eitskin_sim.scene.soft_touch import LEAST_BORDER_MM
from eitskin_sim.scene.touch_table import Array
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
from eitskin_sim.verification.free.effort import never
from eitskin_sim.verification.free.prior.costs import cost_rates, costs, own_parameters
from eitskin_sim.verification.free.prior.joints import Joints
from eitskin_sim.verification.free.usual import Usual
from eitskin_sim.verification.residual import Whitener
from eitskin_sim.verification.sheet.model import Model

INSIDE_MM: Final = 0.5
"""From the sheet's border to a centre, at least."""

LEAST_HALF_MM: Final = 1.5
MOST_HALF_MM: Final = 45.0
CONTRASTS: Final = (0.1, 200.0)
"""Bounds of a contrast."""

FORBIDDEN: Final = 0.05
"""A log contrast is at least this far from 0: a touch that changes nothing is none."""

STEPS: Final = np.array([6.0, 6.0, 3.0, 3.0, 0.3, 0.7, 1.5])
"""The longest step of each parameter."""

Linear = tuple[Array, Array, npt.NDArray[np.bool_]]
"""Residuals, derivatives, and what is free."""

AGAINST: Final = 8.0
"""What each touch costs that the start has not: what the network shows, or the last frame had, is evidence too."""

ENOUGH: Final = 1.0
"""A step that gains less of what is minimised is the last, and touches are settled.

One that should gain less is not shortened where it leads up: most often a side lies on a line of the mesh."""

KEPT: Final = 1
"""Steps after which derivatives are kept, but for what the step has shown of them, before they are taken anew."""

AGREES: Final = 0.3
"""Part by which the residual may have changed otherwise than they told."""

SLOW: Final = 0.02
"""A step that gains less of what chi-squared has more than rows is the last, too: something else is wrong."""

NOTHING: Final = 0.02
"""A step that should gain less for each parameter is not tried: it would go a seventh of a standard error."""

TRIES: Final = 4
"""Of one step, each shorter than the one before."""


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One frame, against one model."""

    model: Model
    white: Whitener
    change: Array
    """(104,) dV"""
    usual: Usual
    expected: Array
    """(104,) dV beside the touches."""
    shown: int = 0
    """Touches of the start."""
    joints: Joints = ()
    """Which of the touches that are fitted hang together; none for a search, which adds and removes some."""

    def at(self, pieces: Array, turning: bool = False) -> "Fit":
        """Return touches as they stand.

        Raises:
            ValueError: They cannot be.
        """
        solved, change = self.model.solve(pieces)
        residual = self.white.whiten(self.change - self.expected - change)
        cost = costs(pieces, own_parameters(pieces, turning), self.usual, self.joints)
        price = self.usual.touches.per_touch * len(pieces) + AGAINST * max(len(pieces) - self.shown, 0)
        return Fit(pieces, turning, solved, residual, cost, price, self)


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """Touches and how well they explain a frame."""

    pieces: Array
    """(n, 8)"""
    turning: bool
    """Whether angles are fitted."""
    solved: Solved
    residual: Array
    """(rows,) whitened."""
    unlikely: Array
    """(p,) residuals of the prior; the last is that of the mean contrast."""
    price: float
    """Of its number of touches."""
    frame: "Frame"
    """What it was fitted to."""
    _linear: "list[Linear]" = field(default_factory=list, repr=False)
    """Its derivatives, once somebody asked for them."""
    _before: "Linear | None" = field(default=None, repr=False)
    """Derivatives that tell the errors of a settled one, of here or before a step that gained next to nothing."""

    @property
    def settled(self) -> bool:
        """Whether another step would gain next to nothing."""
        return self._before is not None

    @property
    def errors(self) -> "Linear":
        """Return the same as ``linear``, to tell errors by: derivatives from one short step before serve as well."""
        return self._before if self._before is not None and not self._linear else self.linear

    @property
    def linear(self) -> "Linear":
        """Return the (rows + p,) residuals, their (rows + p, r) derivatives by what is free, and what that is."""
        if not self._linear:
            residual, rate, own = self.residuals()
            by = -self.frame.white.whiten(self.frame.model.jacobian(self.solved, own).T).T
            self._linear.append((residual, np.concatenate([by, rate]), own))
        return self._linear[0]

    def residuals(self) -> "Linear":
        """Return the (rows + p,) residuals, the prior's (p, r) derivatives, and what is free."""
        own = own_parameters(self.pieces, self.turning)
        rate = cost_rates(self.pieces, own, self.frame.usual, self.frame.joints)
        return np.concatenate([self.residual, self.unlikely]), rate, own

    @property
    def chi_squared(self) -> float:
        """Of the residual."""
        return float(self.residual @ self.residual)

    @property
    def cost(self) -> float:
        """What is minimised."""
        return self.chi_squared + float(self.unlikely @ self.unlikely) + self.price + 3.0 * self.turning


def held_prior(fit: Fit) -> float:
    """Return the prior's cost of a fit's touches, but for their mean contrast."""
    return float(fit.unlikely[:-1] @ fit.unlikely[:-1])


def refine(
    frame: Frame,
    fit: Fit,
    steps: int = 8,
    over: Callable[[], bool] = never,
    by: Array | None = None,
) -> Fit:
    """Return touches moved, resized and made to conduct so that they explain a frame better, never worse.

    Args:
        frame: The frame.
        fit: Where to start.
        steps: The most derivatives.
        over: Whether time is over: asked before each derivative and each solution, so that one of them is what a frame
            takes longer at most.
        by: (rows + p, r) derivatives for the first step, from near by; None takes them anew.
    """
    damping, stale = 1e-2, 0
    for _ in range(steps):
        if not len(fit.pieces) or fit.settled or over():
            return fit
        if by is None:
            by, stale = fit.linear[1], 0
        residual, rate, own = fit.residuals()
        by = np.concatenate([by[: len(fit.residual)], rate])
        gradient, square = by.T @ residual, by.T @ by
        scale = np.diag(square) + 1e-9
        best, first = None, True
        for _ in range(TRIES):
            if over():
                return fit
            step = np.asarray(-np.linalg.solve(square + damping * np.diag(scale), gradient), dtype=np.float64)
            told = float(-2.0 * (gradient @ step) - step @ square @ step)
            if told < NOTHING * len(step):
                return _served(fit, by)
            moved = bounded(frame, fit.pieces, own, step)
            try:
                best = frame.at(moved, fit.turning)
            except (ValueError, np.linalg.LinAlgError):
                best = None
            if best is not None and best.cost < fit.cost:
                break
            if told < ENOUGH:
                return _served(fit, by)
            damping *= 8.0
            best, first = None, False
        if best is None:
            if not stale:
                return fit
            by = None
            continue
        gained, before, used = fit.cost - best.cost, fit, by
        fit = best
        if gained < ENOUGH:
            return _served(fit, used)
        if gained < SLOW * (fit.chi_squared - len(fit.residual)):
            return fit
        by, stale = _secant(by, before, fit, own, scale, stale)
        if first:
            damping = max(damping / 5.0, 1e-4)
    return fit


def _served(fit: Fit, by: Array) -> Fit:
    """Return a fit as settled, its errors told by derivatives (rows + p, r) of there or of a short step before."""
    residual, rate, own = fit.residuals()
    return replace(fit, _before=(residual, np.concatenate([by[: len(fit.residual)], rate]), own))


def _secant(
    by: Array, fit: Fit, best: Fit, own: npt.NDArray[np.bool_], scale: Array, stale: int
) -> tuple[Array | None, int]:
    """Return derivatives after a step that keep what it has shown (Broyden), and how often; None to take them anew."""
    step = (parameters_of(best.pieces) - parameters_of(fit.pieces))[own]
    told, seen = by[: len(fit.residual)] @ step, best.residual - fit.residual
    wrong = seen - told
    if stale >= KEPT or wrong @ wrong > AGREES**2 * (told @ told):
        return None, 0
    weight = scale * step
    return by[: len(fit.residual)] + np.outer(wrong, weight / (weight @ step)), stale + 1


def bounded(frame: Frame, pieces: Array, own: npt.NDArray[np.bool_], step: Array) -> Array:
    """Return touches after a step, shortened and held within what touches may be."""
    values = parameters_of(pieces)
    move = np.zeros(own.shape)
    move[own] = step
    before = values[:, LOG_CONTRAST].copy()
    values += np.clip(move, -STEPS, STEPS)
    values[:, [X, Y]] = _held(values[:, [X, Y]], frame.model.skin)
    halves = [HALF_LENGTH, HALF_WIDTH]
    values[:, halves] = np.clip(values[:, halves], LEAST_HALF_MM, MOST_HALF_MM)
    log = np.clip(values[:, LOG_CONTRAST], *np.log(CONTRASTS))
    if frame.usual.sign:
        log = frame.usual.sign * np.maximum(frame.usual.sign * log, FORBIDDEN)
    values[:, LOG_CONTRAST] = np.where(np.abs(log) < FORBIDDEN, np.where(before < 0.0, -FORBIDDEN, FORBIDDEN), log)
    graded = pieces[:, 7] > 0.0
    narrow = 2.0 * values[:, halves].min(axis=1)
    values[graded, BORDER] = np.clip(values[graded, BORDER], LEAST_BORDER_MM, np.minimum(narrow[graded] - 0.01, 8.0))
    return pieces_of(pieces[:, 0], values)


def on_sheet(pieces: Array, skin: Skin) -> Array:
    """Return touches whose centres are held within a skin's sheet."""
    found = pieces.copy()
    found[:, 1:3] = _held(pieces[:, 1:3], skin)
    return found


def _held(centres_mm: Array, skin: Skin) -> Array:
    return np.clip(centres_mm, INSIDE_MM, np.array(skin.outline.size_mm) - INSIDE_MM)
