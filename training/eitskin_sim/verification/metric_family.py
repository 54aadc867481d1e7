"""The metrics of a skin's own deformations: a mean and a few modes of their logarithm.

Voltages see a bent sheet through one field alone, its metric g. With log g a polynomial in x and y, drawn deformations
give its principal modes, each of one standard deviation ::

    log g(x, y) = mean(x, y) + sum of z_k mode_k(x, y)      z_k about N(0, 1)

Every z is a metric that is positive, so a fit may go anywhere; :mod:`eitskin_sim.verification.likely_bend` goes back
to a deformation.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.polynomial import chebyshev

from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.arrays import Array
from eitskin_sim.fem.mesh import Metric
from eitskin_sim.scene.bend import bend_metric
from eitskin_sim.scene.family import NO_FAMILY, draw, is_family
from eitskin_sim.scene.nominal import flat_metric_of, nominal_sheet
from eitskin_sim.scene.parts import Bend

DRAWS: Final = 120
"""Deformations that the modes are made of; their mirror images come on top, and uneven stretch the other way."""

SEED: Final = 61_403

ORDERS: Final = (6, 5)
"""Of the polynomials along x and y."""

MODES: Final = 45
"""The voltages of 40 deformations of another seed need as many: 30 leave 0.2 % of some."""

SPREAD: Final = 2.0
"""Times that a mode's standard deviation is that of the draws: most of these are gentle, and some are far out."""

PLACES: Final = (15, 11)
"""Along x and y, where deformations are looked at."""

DIFFERENCE: Final = 1e-4
"""Step of a derivative, in standard deviations."""


@dataclass(frozen=True, slots=True, eq=False)
class MetricFamily:
    """The modes of a skin."""

    mean: Array
    """(3, q) coefficients of log g: xx, xy, yy."""
    modes: Array
    """(k, 3, q)"""
    stretch: Array
    """(k, k) root mean square of the stretch, half of log g, that each brings."""
    skin: Skin
    bends: tuple[Bend, ...]
    """Some deformations of the family."""
    drawn: Array
    """(n, k) their amplitudes."""
    middle: Array
    """(p, 3) log g at ``PLACES`` where all amplitudes are 0."""
    projection: Array
    """(k, 3 p) amplitudes by log g less that."""

    def amplitudes(self, bend: Bend) -> Array:
        """Return the (k,) amplitudes of a deformation."""
        return np.asarray(self.projection @ (_log_metric(bend, self.skin) - self.middle).ravel())

    def metric(self, amplitudes: Array) -> Metric:
        """Return the metric at (k,) amplitudes."""
        found = self.mean + np.tensordot(amplitudes, self.modes, 1)
        return lambda xy_mm: _exponential(_basis(xy_mm, self.skin.outline.size_mm) @ found.T)

    def rates(self, amplitudes: Array, metric: Metric, xy_mm: Array) -> tuple[Array, Array, Array]:
        """Return the (3, n, k) derivatives of E, F and G by amplitudes at flat points (n, 2), and nothing else."""
        basis = _basis(xy_mm, self.skin.outline.size_mm)
        here = basis @ (self.mean + np.tensordot(amplitudes, self.modes, 1)).T
        step = DIFFERENCE * np.moveaxis(self.modes @ basis.T, 1, 2)  # (k, n, 3)
        change = (_exponential(here + step) - _exponential(here - step)) / (2.0 * DIFFERENCE)
        return np.moveaxis(change, (2, 0), (0, 2)), np.zeros((3, len(xy_mm), 0)), np.zeros((0, 0))

    def at_rest(self) -> "MetricFamily":
        """Return the same: it may be anything."""
        return self

    @property
    def modes_at_places(self) -> Array:
        """(3 p, k) of log g at the places, by each amplitude."""
        basis = _basis(places_of(self.skin), self.skin.outline.size_mm)
        return np.asarray((basis @ np.swapaxes(self.modes, 1, 2)).reshape(len(self.modes), -1).T)

    def about(self, amplitudes: Array, ways: Array) -> "MetricFamily":
        """Return the same metrics by other amplitudes: those of this one are (k,) amplitudes + (k, k) ways @ them."""
        return replace(
            self,
            mean=self.mean + np.tensordot(amplitudes, self.modes, 1),
            modes=np.tensordot(ways.T, self.modes, 1),
            stretch=self.stretch @ ways,
            drawn=np.asarray(np.linalg.solve(ways, (self.drawn - amplitudes).T).T, dtype=np.float64),
            middle=self.middle + (self.modes_at_places @ amplitudes).reshape(-1, 3),
            projection=np.asarray(np.linalg.solve(ways, self.projection), dtype=np.float64),
        )


@lru_cache(maxsize=4)
def metric_family(skin: Skin = PAPER) -> MetricFamily:
    """Return the modes of a skin's deformations.

    Raises:
        ValueError: The skin has none.
    """
    if not is_family(skin.deformations):
        raise ValueError(NO_FAMILY)
    fields, bends = [], draw("A", DRAWS, SEED, skin, apart=False)
    for bend in bends:
        for either in (bend, replace(bend, nonuniformity=-bend.nonuniformity)):  # no scan tells which
            log = _log_metric(either, skin).reshape(*PLACES[::-1], 3)
            for mirrors in ((), (0,), (1,), (0, 1)):
                turned = np.flip(log, axis=mirrors) * [1.0, (-1.0) ** len(mirrors), 1.0]
                fields.append(turned.reshape(-1, 3))
    drawn = np.array(fields)
    mean = drawn.mean(axis=0)
    _, values, ways = np.linalg.svd((drawn - mean).reshape(len(drawn), -1), full_matrices=False)
    sizes = SPREAD * values[:MODES] / np.sqrt(len(drawn))
    at = places_of(skin)
    to_coefficients = np.linalg.pinv(_basis(at, skin.outline.size_mm))
    modes = np.array([to_coefficients @ way.reshape(-1, 3) * one for one, way in zip(sizes, ways, strict=False)])
    rms = sizes / np.sqrt(len(at)) / 2.0
    projection = ways[: len(sizes)] / sizes[:, None]
    own = (drawn[::8] - mean).reshape(len(bends), -1) @ projection.T
    about = (to_coefficients @ mean).T
    return MetricFamily(about, np.swapaxes(modes, 1, 2), np.diag(rms), skin, bends, own, mean, projection)


def places_of(skin: Skin) -> Array:
    """Return the (p, 2) flat places where deformations are looked at, ``PLACES`` of them."""
    x, y = (np.linspace(0.01, 0.99, n) * extent for n, extent in zip(PLACES, skin.outline.size_mm, strict=True))
    return np.stack([one.ravel() for one in np.meshgrid(x, y)], axis=-1)


def _log_metric(bend: Bend, skin: Skin) -> Array:
    """Return the (p, 3) logarithm of a deformation's metric."""
    at = places_of(skin)
    E, _, G = flat_metric_of(skin)(at[:1])[0]
    return logarithm(np.array([E, np.sqrt(E * G), G]) * bend_metric(bend, nominal_sheet(skin))(at))


def _basis(xy_mm: Array, size_mm: tuple[float, float]) -> Array:
    """Return (n, q) polynomials."""
    u, v = (2.0 * xy_mm / size_mm - 1.0).T
    along, across = chebyshev.chebvander(u, ORDERS[0]), chebyshev.chebvander(v, ORDERS[1])
    return np.asarray((along[:, :, None] * across[:, None, :]).reshape(len(xy_mm), -1))


def _exponential(log: Array) -> Array:
    """Return (..., 3) E, F, G of symmetric (..., 3) logarithms."""
    a, b, c = np.moveaxis(log, -1, 0)
    half = (a - c) / 2.0
    apart = np.hypot(half, b)
    factor, cosh = np.exp((a + c) / 2.0), np.cosh(apart)
    slope = np.sinh(apart) / np.maximum(apart, 1e-300)
    return np.stack([factor * (cosh + slope * half), factor * slope * b, factor * (cosh - slope * half)], axis=-1)


def logarithm(form: Array) -> Array:
    """Return the symmetric (..., 3) logarithms of (..., 3) E, F, G."""
    a, b, c = np.moveaxis(form, -1, 0)
    half, middle = (a - c) / 2.0, (a + c) / 2.0
    apart = np.hypot(half, b)
    high, low = np.log(middle + apart), np.log(middle - apart)
    slope = np.where(apart > 1e-12, (high - low) / 2.0 / np.maximum(apart, 1e-12), 1.0 / middle)
    return np.stack([(high + low) / 2.0 + slope * half, slope * b, (high + low) / 2.0 - slope * half], axis=-1)
