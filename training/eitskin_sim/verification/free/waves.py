"""Displacements of the sheet's material under the points of its scan, as waves, and what they do to a metric.

A scan without marks divides rows and columns by arc length, so it misses how stretch is distributed along them: the
material may lie elsewhere within the surface. Its border stays on the border.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.interpolate import RectBivariateSpline

from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.fem.mesh import Metric
from eitskin_sim.scene.touch_table import Array

SPREADS: Final = (
    (
        (0.006, 0.045, 0.005), (0.072, 0.008, 0.004), (0.004, 0.006, 0.004), (0.004, 0.003, 0.003),
        (0.0015, 0.002, 0.002), (0.0015, 0.0015, 0.002),
    ),
    ((0.008, 0.085, 0.012), (0.008, 0.02, 0.008), (0.003, 0.01, 0.005), (0.003, 0.004, 0.002)),
)  # fmt: skip
"""Standard deviations of the waves along x and along y: half waves 1, 2, ..; across each, polynomials of order 0 to 2.

As found of 40 deformations each of the families A and B, from the metrics of sheets and of their clouds: uneven stretch
along the sheet is wave 2, order 0 along x; twist is wave 1, order 1 along both. The others are bumps.
"""

WAVES: Final = (len(SPREADS[0]), len(SPREADS[1]))
"""Half waves along x and along y."""

ORDERS: Final = 3
"""Polynomials across, orders 0 to 2."""

GRID_MM: Final = 2.5
"""Of the points between which a moved metric is a spline: its own knots are eight times further apart."""


@dataclass(frozen=True, slots=True)
class Waves:
    """Ways in which the sheet's material may lie elsewhere under the scan's points, its border on the border."""

    names: tuple[str, ...]
    sd: Array
    """(n,) of the stretch that each brings."""
    size_mm: tuple[float, float]

    def at(self, xy_mm: Array) -> tuple[Array, Array]:
        """Return (k, n, 2) displacements by the amplitudes, mm, and (k, n, 2, 2) derivatives: of which, by which."""
        move, slope = [], []
        for axis, count in enumerate(WAVES):
            along, across = self.size_mm[axis], self.size_mm[1 - axis]
            wave = np.pi * np.arange(1, count + 1) / along
            t = 2.0 * xy_mm[:, 1 - axis] / across - 1.0
            power = np.stack([np.ones_like(t), t, 1.5 * t * t - 0.5], axis=-1)
            rise = np.stack([np.zeros_like(t), np.ones_like(t), 3.0 * t], axis=-1) * 2.0 / across
            sine = np.sin(wave * xy_mm[:, axis, None]) / wave
            cosine = np.cos(wave * xy_mm[:, axis, None])
            n = count * ORDERS
            moved, by = np.zeros((len(xy_mm), n, 2)), np.zeros((len(xy_mm), n, 2, 2))
            moved[:, :, axis] = (sine[:, :, None] * power[:, None, :]).reshape(-1, n)
            by[:, :, axis, axis] = (cosine[:, :, None] * power[:, None, :]).reshape(-1, n)
            by[:, :, axis, 1 - axis] = (sine[:, :, None] * rise[:, None, :]).reshape(-1, n)
            move.append(moved)
            slope.append(by)
        return np.concatenate(move, axis=1), np.concatenate(slope, axis=1)

    def moved(self, metric: Metric, amplitudes: Array) -> Metric:
        """Return the metric of the material, if it lies so under that of the scan's points."""
        x, y = (np.linspace(0.0, extent, round(extent / GRID_MM) + 1) for extent in self.size_mm)
        whole = metric(np.stack([one.ravel() for one in np.meshgrid(x, y, indexing="ij")], axis=-1))
        parts = [RectBivariateSpline(x, y, one.reshape(len(x), len(y))) for one in whole.T]

        def found(xy_mm: Array) -> Array:
            move, slope = self.at(xy_mm)
            where = xy_mm + np.einsum("kna,n->ka", move, amplitudes)
            E, F, G = (part.ev(*np.clip(where, 0.0, self.size_mm).T) for part in parts)
            (a, b), (c, d) = np.moveaxis(np.eye(2) + np.einsum("knab,n->kab", slope, amplitudes), 0, -1)
            return np.stack(
                [
                    a * a * E + 2.0 * a * c * F + c * c * G,
                    a * b * E + (a * d + b * c) * F + c * d * G,
                    b * b * E + 2.0 * b * d * F + d * d * G,
                ],
                axis=-1,
            )

        return found

    def rates(self, metric: Metric, at: Array) -> tuple[Array, Array, Array]:
        """Return (k, n) derivatives of E, F and G by the amplitudes, at none."""
        move, slope = self.at(at)
        by = []
        for axis in (0, 1):
            step = np.zeros(2)
            step[axis] = 0.5
            by.append(metric(at + step) - metric(at - step))
        grad = np.stack(by, axis=-1)  # (k, 3, 2)
        carried = np.einsum("kca,kna->ckn", grad, move)
        E, F, G = metric(at).T[:, :, None]
        (a, b), (c, d) = np.moveaxis(slope, (2, 3), (0, 1))
        return (
            carried[0] + 2.0 * (a * E + c * F),
            carried[1] + b * E + (a + d) * F + c * G,
            carried[2] + 2.0 * (b * F + d * G),
        )


def waves_of(skin: Skin = PAPER) -> Waves:
    """Return the waves of a skin's sheet."""
    names, sd = [], []
    for axis, count in zip("xy", WAVES, strict=True):
        for wave in range(1, count + 1):
            for order in range(ORDERS):
                names.append(f"stretch {axis}{wave}.{order}")
                sd.append(SPREADS["xy".index(axis)][wave - 1][order])
    return Waves(tuple(names), np.array(sd), skin.outline.size_mm)
