"""Touched units: a verdict on shapes anywhere, snapped to the units of the skin's grid and judged as such.

A map of units is verified as any other, by shapes (:mod:`eitskin_sim.verification.shape_verifier`). A unit counts as
touched if the verified map covers half of it. Then each unit is a rectangle of its own contrast, and the frame is
modelled with just these. If the residual is too large, units are added or removed one at a time while this cost falls
::

    chi-squared + sum of ((log contrast - its mean) / spread)^2 + COST_OF_UNIT * units

Only units in doubt are tried: those that the verified map covers in part, and those on which the network disagrees.
"""

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from eitskin_proto.skin.grid import Grid
from eitskin_sim.arrays import Array, Index
from eitskin_sim.scene.touch_table import RECTANGLE
from eitskin_sim.shapes.parameters import LOG_CONTRAST, N_PARAMETERS
from eitskin_sim.verification import constants as c
from eitskin_sim.verification.fit import Budget
from eitskin_sim.verification.residual import Noise, Rows, change_of
from eitskin_sim.verification.shape_verdict import ShapeVerdict
from eitskin_sim.verification.sheet_model import SheetModel
from eitskin_sim.verification.touch_prior import TouchPrior, by_sign
from eitskin_sim.verification.verdict import LEVEL, Verdict, p_value

Bits = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class UnitTouch:
    """One touched unit."""

    unit: int
    contrast: float
    """Conductivity over the sheet's."""


@dataclass(frozen=True, slots=True)
class UnitVerdict(Verdict[UnitTouch]):
    """One frame, explained by touched units."""

    pieces: Array = field(default_factory=lambda: np.zeros((0, 8)))
    """(n, 8) the shapes that were snapped."""


def too_many(shown: Bits) -> str:
    """Return why a network's units are not verified because there are too many; "" if they are.

    Args:
        shown: (units,) what it shows.
    """
    count = int(shown.sum())
    return f"{count} units are shown, and at most {c.MAX_UNITS} are verified" if count > c.MAX_UNITS else ""


def unit_shares(image: Array, grid: Grid) -> Array:
    """Return the (units,) mean of a (rows, columns) map over the pixels of each unit."""
    unit = grid.unit_of_pixel.ravel()
    pixels = np.maximum(np.bincount(unit, minlength=grid.n_units), 1)
    return np.asarray(np.bincount(unit, weights=image.ravel(), minlength=grid.n_units) / pixels)


@dataclass(frozen=True, slots=True)
class _Set:
    """Units fitted to a frame."""

    bits: Bits
    logs: Array
    """(n,) their log contrasts."""
    misfit: float
    """Chi-squared, and what contrasts cost that differ."""
    degrees_of_freedom: int

    @property
    def cost(self) -> float:
        return self.misfit + c.COST_OF_UNIT * len(self.logs)

    @property
    def p(self) -> float:
        return p_value(self.misfit, self.degrees_of_freedom)


class UnitFrame:
    """One frame, modelled with sets of units.

    Args:
        model: Of the sheet, as the frame's shapes were verified.
        voltages_V: (104,) of the frame.
        reference_V: (104,) flat and untouched; 0 in rows that every frame leaves out.
        noise: Of the frame.
        prior: The prior of touches.
        rows: (104,) which rows there are; None is all.
    """

    def __init__(
        self,
        model: SheetModel,
        voltages_V: Array,
        reference_V: Array,
        noise: Noise,
        prior: TouchPrior,
        rows: Rows | None = None,
    ) -> None:
        self._rows = (reference_V != 0.0) if rows is None else rows & (reference_V != 0.0)
        self._reference = np.where(self._rows, reference_V, np.nan)
        self._change = change_of(voltages_V, self._reference, self._rows)
        self._model, self._noise, self._prior = model, noise, prior
        self._expected = model.expected(model.ratio(self._change))
        self.sets = 0
        """That were fitted."""

    def snapped(self, found: ShapeVerdict, shown: Bits, budget: Budget) -> UnitVerdict:
        """Return the touched units that shapes come to, or others about them that explain the frame better.

        Args:
            found: The shapes.
            shown: (units,) what the network shows.
            budget: The frame's time so far, and its limit.
        """
        grid = self._model.skin.grid
        covered = unit_shares(found.map(grid), grid)
        best = self._fitted(covered >= c.MIN_COVERED_SHARE, found.pieces)
        if best.p < c.MIN_P_OF_SURE_UNITS and not np.array_equal(best.bits, shown):
            best = min(best, self._fitted(shown, found.pieces), key=lambda one: one.cost)
        low, high = c.COVERED_SHARES_IN_DOUBT
        units = np.flatnonzero((covered > low) & (covered < high) | ((covered >= c.MIN_COVERED_SHARE) != shown))
        nearest = np.argsort(np.abs(covered[units] - c.MIN_COVERED_SHARE), kind="stable")
        units = units[nearest[: c.MAX_UNITS_IN_DOUBT]]
        while best.p < c.MIN_P_OF_SURE_UNITS and len(units) and not budget.search_over():
            other = min((self._flipped(best, int(unit), found.pieces) for unit in units), key=lambda one: one.cost)
            if other.cost >= best.cost:
                break
            best = other
        return UnitVerdict(
            touches=tuple(
                UnitTouch(int(unit), float(np.exp(log)))
                for unit, log in zip(np.flatnonzero(best.bits), best.logs, strict=True)
            ),
            chi_squared=best.misfit,
            degrees_of_freedom=best.degrees_of_freedom,
            p_value=best.p,
            level=LEVEL,
            evaluations=found.evaluations + self.sets,
            seconds=budget.seconds,
            unfinished=best.p < LEVEL and budget.search_over(),
            on_dented_sheet=found.on_dented_sheet,
            pieces=found.pieces,
        )

    def _flipped(self, one: _Set, unit: int, pieces: Array) -> _Set:
        bits = one.bits.copy()
        bits[unit] ^= True
        return self._fitted(bits, pieces)

    def _fitted(self, bits: Bits, pieces: Array) -> _Set:
        """Return units with the contrasts that explain the frame best, each begun from that of the nearest shape."""
        self.sets += 1
        units = np.flatnonzero(bits)
        table = _rectangles(units, self._model.skin.grid)
        logs = np.tile(self._prior.usual(np.array(self._prior.sign)), len(units))
        if len(pieces) and len(units):
            apart = np.hypot(*(table[:, None, 1:3] - pieces[None, :, 1:3]).transpose(2, 0, 1))
            logs = np.log(pieces[apart.argmin(axis=1), 6])
        own = np.zeros((len(units), N_PARAMETERS), dtype=np.bool_)
        own[:, LOG_CONTRAST] = True
        alike = (np.eye(len(units)) - by_sign(logs)[1]) / c.OWN_CONTRAST_SD
        best: _Set | None = None
        for _ in range(c.MAX_STEPS_OF_UNITS):
            table[:, 6] = np.exp(logs)
            solved, change = self._model.solve(table)
            signal = c.MODEL_ERROR_OF_UNITS * np.abs(change - self._model.untouched)
            white = self._model.whitener(self._change, self._reference, self._noise, rows=self._rows, own=signal)
            residual, unlike = white.whiten(self._change - self._expected - change), alike @ logs
            misfit = float(residual @ residual + unlike @ unlike)
            gain = np.inf if best is None else best.misfit - misfit
            if gain > 0.0:
                best = _Set(bits, logs, misfit, max(len(residual) - len(units), 1))
            if gain < c.MIN_GAIN_OF_STEP or not len(units):
                break
            by = -white.whiten(self._model.jacobian(solved, own).T).T
            square = by.T @ by + alike.T @ alike + 1e-2 * np.eye(len(units))
            step = -np.linalg.solve(square, by.T @ residual + alike.T @ unlike)
            logs = np.clip(logs + np.clip(step, -1.0, 1.0), *np.log(c.CONTRAST_BOUNDS))
        assert best is not None
        return best


def unverified() -> UnitVerdict:
    """Return the verdict on a frame with too many units: no touches, flagged."""
    return UnitVerdict((), 0.0, 1, 0.0, LEVEL, 0, 0.0)


def _rectangles(units: Index, grid: Grid) -> Array:
    """Return (n, 8) units as touches of contrast 1."""
    boxes = np.array([grid.unit_rect_mm(unit % grid.units[1], unit // grid.units[1]) for unit in units.tolist()])
    table = np.zeros((len(units), 8))
    if len(units):
        table[:, 0], table[:, 6] = RECTANGLE, 1.0
        table[:, 1:3], table[:, 3:5] = (boxes[:, :2] + boxes[:, 2:]) / 2.0, boxes[:, 2:] - boxes[:, :2]
    return table
