"""Displacements of the sheet's material under the points of its scan, as waves, and their effect on a metric.

A scan without marks divides rows and columns by arc length, so it misses how stretch is distributed along them: the
material may be displaced within the surface. Its border stays on the border.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.interpolate import NdBSpline, make_interp_spline

from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.arrays import Array
from eitskin_sim.fem.mesh import Metric
from eitskin_sim.verification import constants as c

WAVES = (len(c.WAVE_SPREADS[0]), len(c.WAVE_SPREADS[1]))
"""Half waves along x and along y."""

ORDERS = 3
"""Polynomials across, orders 0 to 2."""


@dataclass(frozen=True, slots=True)
class Waves:
    """Ways in which the sheet's material may lie elsewhere under the scan's points, its border on the border."""

    sd: Array
    """(n,) of the stretch that each brings."""
    size_mm: tuple[float, float]

    def along(self, axis: int, xy_mm: Array) -> tuple[Array, Array, Array]:
        """Return (k, n) displacements along an axis by its waves' amplitudes, mm, and their slopes along and across it.

        The waves of x come first, then those of y; each moves material along its own axis.
        """
        sine, cosine, power, rise = self._factors(axis, xy_mm)

        def each(wave: Array, across: Array) -> Array:
            return (wave[:, None] * across).reshape(-1, len(xy_mm)).T

        return each(sine, power), each(cosine, power), each(sine, rise)

    def _factors(self, axis: int, xy_mm: Array) -> tuple[Array, Array, Array, Array]:
        """Return (waves, k) waves and their slopes, and (orders, k) polynomials across them and their slopes."""
        along, across = self.size_mm[axis], self.size_mm[1 - axis]
        wave = np.pi * np.arange(1, WAVES[axis] + 1)[:, None] / along
        t = 2.0 * xy_mm[:, 1 - axis] / across - 1.0
        one = np.ones_like(t)
        power = np.stack([one, t, 1.5 * t * t - 0.5])
        rise = np.stack([0.0 * one, one, 3.0 * t]) * 2.0 / across
        # Powers of one rotation, which are faster than sines and cosines of each wave.
        turned = np.repeat(np.exp(1j * wave[:1] * xy_mm[:, axis]), len(wave), axis=0).cumprod(axis=0)
        return turned.imag / wave, turned.real.copy(), power, rise

    def _displaced(self, xy_mm: Array, amplitudes: Array) -> tuple[Array, Array]:
        """Return (k, 2) displacements, mm, and their (2, 2, k) slopes: of which axis, along which."""
        move, slope = np.empty((len(xy_mm), 2)), np.empty((2, 2, len(xy_mm)))
        parts = np.split(amplitudes, [WAVES[0] * ORDERS])
        for axis, own in enumerate(parts):
            sine, cosine, power, rise = self._factors(axis, xy_mm)
            table = own.reshape(-1, ORDERS).T
            sines = table @ sine
            move[:, axis] = np.sum(sines * power, axis=0)
            slope[axis, axis] = np.sum((table @ cosine) * power, axis=0)
            slope[axis, 1 - axis] = np.sum(sines * rise, axis=0)
        return move, slope

    def mirrored(self, axis: int) -> Array:
        """Return (n,) signs by which amplitudes are multiplied where the sheet is mirrored along an axis."""
        signs = []
        for own, count in enumerate(WAVES):
            wave, order = np.meshgrid(np.arange(1, count + 1), np.arange(ORDERS), indexing="ij")
            signs.append((-1.0) ** (wave if own == axis else order).ravel())
        return np.concatenate(signs)

    def moved(self, metric: Metric) -> Callable[[Array], Metric]:
        """Return the metric of the displaced material by amplitudes, from that of the scan's points."""
        x, y = (np.linspace(0.0, extent, round(extent / c.MOVED_METRIC_GRID_MM) + 1) for extent in self.size_mm)
        whole = metric(np.stack([one.ravel() for one in np.meshgrid(x, y, indexing="ij")], axis=-1))
        along = make_interp_spline(x, whole.reshape(len(x), len(y), 3))
        across = make_interp_spline(y, np.swapaxes(along.c, 0, 1))
        spline = NdBSpline((along.t, across.t), np.swapaxes(across.c, 0, 1), 3)

        def found(amplitudes: Array, xy_mm: Array) -> Array:
            move, slope = self._displaced(xy_mm, amplitudes)
            E, F, G = spline(np.clip(xy_mm + move, 0.0, self.size_mm)).T
            (a, b), (c, d) = np.eye(2)[:, :, None] + slope
            return np.stack(
                [
                    a * a * E + 2.0 * a * c * F + c * c * G,
                    a * b * E + (a * d + b * c) * F + c * d * G,
                    b * b * E + 2.0 * b * d * F + d * d * G,
                ],
                axis=-1,
            )

        return lambda amplitudes: partial(found, amplitudes)

    def rates(self, metric: Metric, at: Array) -> tuple[Array, Array, Array]:
        """Return (k, n) derivatives of E, F and G by the amplitudes, at none."""
        steps = np.array([(0.0, 0.0), (0.5, 0.0), (0.0, 0.5), (-0.5, 0.0), (0.0, -0.5)])
        whole = metric((steps[:, None, :] + at).reshape(-1, 2)).reshape(5, -1, 3)
        E, F, G = whole[0].T[:, :, None]
        found = []
        for axis in (0, 1):
            carried = (whole[1 + axis] - whole[3 + axis]).T[:, :, None]
            move, along, across = self.along(axis, at)
            if axis == 0:
                own = 2.0 * along * E, across * E + along * F, 2.0 * across * F
            else:
                own = 2.0 * across * F, along * F + across * G, 2.0 * along * G
            found.append([part * move + rest for part, rest in zip(carried, own, strict=True)])
        by_E, by_F, by_G = (np.concatenate(both, axis=1) for both in zip(*found, strict=True))
        return by_E, by_F, by_G


def waves_of(skin: Skin = PAPER) -> Waves:
    """Return the waves of a skin's sheet."""
    return Waves(np.concatenate([np.ravel(spreads) for spreads in c.WAVE_SPREADS]), skin.outline.size_mm)
