"""Finds the shape of a sheet that nothing scanned from one frame: its metric, its layer and its touches together.

Voltages change by a bend up to ten times as much as noise lets rows be off, so derivatives reach a part of the way. A
search takes steps of Gauss and Newton in logarithms of voltages, with rows believed little at first and as their noise
allows at last; every few steps the model is made again where it has come to ::

    log V/V0 = log V(touches, shape)/V_flat + columns (amplitudes - those of the model)      amplitudes about N(0, 1)

It starts from the touches that the network shows, and from places of one touch of the skin's usual size, whose answers
on the family's mean shape are known. Touches of these are chosen one after another, each with the shape that explains
the frame best beside it.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.arrays import Array
from eitskin_sim.scene.touch_table import RECTANGLE
from eitskin_sim.verification import constants as c
from eitskin_sim.verification.fit import IMPOSSIBLE_TOUCH_ERRORS, bounded
from eitskin_sim.verification.network_map import of_signs
from eitskin_sim.verification.residual import Noise, Rows
from eitskin_sim.verification.sheet_model import SheetModel, model_without_scan
from eitskin_sim.verification.touch_prior import TouchPrior, fitted_parameters


@dataclass(frozen=True, slots=True, eq=False)
class FoundShape:
    """A shape, and touches on it."""

    model: SheetModel
    pieces: Array
    """(n, 8)"""
    chi_squared: float
    cost: float
    """Chi-squared, and the cost of amplitudes and touches by their priors."""


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """What one frame says in logarithms."""

    log: Array
    """(r,) log V/V0."""
    sd: Array
    """(r,)"""
    kept: Rows

    def residual(self, model: SheetModel, change: Array, off: Array) -> Array:
        """Return (r,) what touches that change the model's sheet by (104,) dV, and amplitudes off it, leave."""
        found = np.log(np.maximum(np.abs(1.0 + change[self.kept]), 1e-6))
        return np.asarray(self.log - found - self.columns(model) @ off)

    def columns(self, model: SheetModel) -> Array:
        """Return (r, m) log V by amplitudes."""
        return np.asarray((model.unseen.columns / model.touched.untouched_V[:, None])[self.kept])


class ShapeSearch:
    """Shapes of one skin.

    Args:
        prior: Of its touches.
        skin: The skin.

    Raises:
        ValueError: The skin has no family of deformations.
    """

    def __init__(self, prior: TouchPrior, skin: Skin = PAPER) -> None:
        self._prior, self._skin = prior, skin
        self._mean = model_without_scan(skin)
        _dictionary(prior, skin)

    def shape(
        self, change: Array, reference: Array, noise: Noise, starts: list[Array] | None, rows: Rows
    ) -> FoundShape | None:
        """Return the shape that explains a frame best; None if there is none, or none near enough for touches.

        Args:
            change: (104,) dV.
            reference: (104,) V.
            noise: Of the frame.
            starts: (n, 8) touches each, to start from, beside those of the dictionary; None for an untouched frame.
            rows: (104,) which rows it has.
        """
        size = np.maximum(np.abs(1.0 + change[rows]), 1e-6)
        frame = _Rows(np.log(size), np.hypot(noise.sd(change, reference)[rows] / size, c.MESH_ERROR), rows)
        best: FoundShape | None = None
        for pieces in self._starts(frame, starts):
            found = self._from(frame, pieces)
            if found is not None and (best is None or found.cost < best.cost):
                best = found
            if best is not None and best.chi_squared < len(size) + 3.0 * np.sqrt(2.0 * len(size)):
                break
        is_far = starts and best is not None and best.chi_squared > c.MIN_MISFIT_WITHOUT_NETWORK * len(size)
        return None if is_far else best

    def model(self, change: Array, reference: Array, noise: Noise, rows: Rows) -> SheetModel | None:
        """Return the model of an untouched sheet; arguments as of :meth:`shape`."""
        found = self.shape(change, reference, noise, None, rows)
        return None if found is None else found.model

    def _starts(self, frame: _Rows, starts: list[Array] | None) -> Iterator[Array]:
        if starts is None:
            yield np.zeros((0, 8))
            return
        chosen = self._chosen(frame)
        yield chosen
        for pieces in starts:
            if not _alike(pieces, chosen):
                yield pieces
        for count in reversed(range(1, len(chosen))):
            yield chosen[:count]

    def _from(self, frame: _Rows, pieces: Array) -> FoundShape | None:
        """Return where a search from some touches ends; None if it ends where no sheet is."""
        model, turning = self._mean, bool(pieces[:, 5].any())
        amplitudes, shape = np.zeros(model.unseen.columns.shape[1]), slice(model.unseen.n_waves)
        last = len(c.SEARCH_LOG_SDS) - 1
        try:
            for number in range(c.SEARCH_MAX_MODELS):
                sd = np.hypot(frame.sd, c.SEARCH_LOG_SDS[min(number, last)])
                off = _off(model, amplitudes)
                for _ in range(c.SEARCH_STEPS if len(pieces) else 1):
                    pieces, by = self._step(frame, model, pieces, turning, off, sd)
                    off = off + by
                    off[shape] = np.clip(off[shape], -c.SEARCH_MAX_STEP, c.SEARCH_MAX_STEP)
                amplitudes = amplitudes - _off(model, amplitudes) + off
                again = model.about(amplitudes)
                if again is None:
                    return None
                model = again
                if number >= last and np.abs(off[shape]).max() < c.SEARCH_MIN_STEP:
                    break
            change = model.solve(pieces)[1]
        except IMPOSSIBLE_TOUCH_ERRORS:
            return None
        left = frame.residual(model, change, _off(model, amplitudes)) / frame.sd
        unlikely = self._prior.residuals(pieces, fitted_parameters(pieces, turning))
        cost = float(left @ left + amplitudes @ amplitudes + unlikely @ unlikely) + self._prior.per_touch * len(pieces)
        return FoundShape(model, pieces, float(left @ left), cost)

    def _step(
        self, frame: _Rows, model: SheetModel, pieces: Array, turning: bool, off: Array, sd: Array
    ) -> tuple[Array, Array]:
        """Return touches after a step of Gauss and Newton, and (m,) by how much amplitudes change with it.

        Args:
            frame: The frame.
            model: About which derivatives are taken.
            pieces: (n, 8) the touches before.
            turning: Whether their angles are fitted.
            off: (m,) amplitudes less those of the model.
            sd: (r,) by which rows may be off.
        """
        solved, change = model.solve(pieces)
        fitted, columns = fitted_parameters(pieces, turning), frame.columns(model)
        by = (model.jacobian(solved, fitted) / (1.0 + change)[:, None])[frame.kept]
        unlikely, by_prior = self._prior.residuals(pieces, fitted), self._prior.jacobian(pieces, fitted)
        n, m = by.shape[1], len(off)
        whole = np.block(
            [
                [by / sd[:, None], columns / sd[:, None]],
                [-by_prior, np.zeros((len(unlikely), m))],
                [np.zeros((m, n)), np.eye(m)],
            ]
        )
        amplitudes = off.copy()
        amplitudes[: len(model.held)] += model.held
        target = np.concatenate([frame.residual(model, change, off) / sd, unlikely, -amplitudes])
        step = np.linalg.lstsq(whole, target, rcond=1e-9)[0]
        return bounded(self._prior, self._skin, pieces, fitted, step[:n]), np.asarray(step[n:])

    def _chosen(self, frame: _Rows) -> Array:
        """Return (n, 8) touches of the dictionary, chosen one after another."""
        pieces, answers = _dictionary(self._prior, self._skin)
        columns, answers = frame.columns(self._mean), answers[:, frame.kept]
        loose = np.hypot(frame.sd, c.DICTIONARY_LOG_SD)
        inverse = np.linalg.inv(columns @ columns.T + np.diag(loose**2))
        left = frame.residual(self._mean, self._mean.untouched, np.zeros(columns.shape[1]))
        seen = answers @ inverse
        curvature = np.einsum("nr,nr->n", seen, answers) + 1.0 / c.DICTIONARY_STRENGTH_SD**2
        found: list[int] = []
        free = np.ones(len(pieces), dtype=np.bool_)
        while len(found) < c.DICTIONARY_TOUCHES:
            strength = np.maximum((seen @ left + 1.0 / c.DICTIONARY_STRENGTH_SD**2) / curvature, 0.0)
            gain = 2.0 * strength * (seen @ left) - strength**2 * np.einsum("nr,nr->n", seen, answers)
            gain -= ((strength - 1.0) / c.DICTIONARY_STRENGTH_SD) ** 2
            best = int(np.argmax(np.where(free, gain, -np.inf)))
            if gain[best] < self._prior.per_touch + c.COST_OF_TOUCH_NOT_SHOWN:
                break
            found.append(best)
            free &= np.linalg.norm(pieces[:, 1:3] - pieces[best, 1:3], axis=1) > c.DICTIONARY_APART_MM
            left = left - strength[best] * answers[best]
        return pieces[found]


def _off(model: SheetModel, amplitudes: Array) -> Array:
    """Return (m,) amplitudes less those that a model has already."""
    found = amplitudes.copy()
    found[: len(model.held)] -= model.held
    return found


def _alike(one: Array, other: Array) -> bool:
    """Return whether touches are as many and as near as steps bring together."""
    if len(one) != len(other) or not len(one):
        return len(one) == len(other)
    apart = np.linalg.norm(one[:, None, 1:3] - other[None, :, 1:3], axis=-1)
    return bool((apart.min(axis=1) < c.ALIKE_MM).all() and (apart.min(axis=0) < c.ALIKE_MM).all())


@lru_cache(maxsize=4)
def _dictionary(prior: TouchPrior, skin: Skin) -> tuple[Array, Array]:
    """Return (n, 8) touches on a grid, and their (n, 104) change of log V on the family's mean shape."""
    model, size = model_without_scan(skin), prior.size_mm
    x, y = (np.arange(c.DICTIONARY_MM / 2, extent, c.DICTIONARY_MM) for extent in skin.outline.size_mm)
    places = np.stack([one.ravel() for one in np.meshgrid(x, y)], axis=-1)
    rectangles = np.zeros((len(places), 8))
    rectangles[:, 0], rectangles[:, 1:3], rectangles[:, 3:5] = RECTANGLE, places, size
    signs = (prior.sign,) if prior.sign else (1, -1)
    pieces = np.concatenate([of_signs(rectangles, np.full(len(places), sign), prior) for sign in signs])
    answers = [np.log(np.abs(model.touched.solve(one[None]).voltages_V / model.touched.untouched_V)) for one in pieces]
    return pieces, np.array(answers)
