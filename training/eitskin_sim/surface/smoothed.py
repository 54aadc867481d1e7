"""The most likely surface of a noisy scan: its metric varies no more than the scan supports.

A scanner's noise bends the fitted surface, most at its border, where the electrodes are: with 0.1 mm the untouched
sheet's voltages are off by half a percent, more than those of a measurement are. A sheet that is bent, stretched or
twisted has a metric that varies little, and over a bump it varies as much as the scan shows clearly. So with u the ways
in which noise moves the fitted surface, each of its standard deviation s, and D the differences of E, F and G from
place to place ::

    D(u) = D + J u     J^T J = Q diag(L) Q^T     w = L^-1 Q^T J^T D     what the fit has of every way, noise or not

The w scatter by s^2 for the noise, and by a / L for the surface, whose metric then varies alike in all its parts. Taken
are the a, and first or second differences, under which the w that are found are likeliest. Of every w the surface gives
back s^2 / (s^2 + a / L), and stays unsure by the variance s^2 (a / L) / (s^2 + a / L): the posterior of a Gaussian
prior whose strength is found by evidence.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np

from eitskin_proto.skin.grid import Grid
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.arrays import Array
from eitskin_sim.surface.predict import FittedSurface, noise_roots, noise_tangents

PLACES_PER_KNOT: Final = 3
"""Places for each of the spline's knots, along a side, between which differences are taken."""

MIN_EIGENVALUE: Final = 1e-8
"""Ways that change the differences by less, of the most, change none: they turn the surface as it is."""

STRENGTHS: Final = np.exp(np.linspace(-20.0, 20.0, 81))
"""The a that are compared, in s^2 times the greatest L."""


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """A scanned surface, and what it may be off by."""

    surface: FittedSurface
    unsure: Array
    """(3 m, k) of the m ways in which noise of 1 mm moves a fitted surface along x, then along y, then along z: the
    mixtures by which it may be off, each of one standard deviation."""
    grid: Grid

    def rates(self, xy_mm: Array) -> Array:
        """Return the (3, n, 3 m) derivatives of E, F and G at flat points (n, 2) by the ways of noise of 1 mm."""
        return _rates(self.surface, xy_mm, *noise_tangents(xy_mm, self.grid))


def smoothed(surface: FittedSurface, noise_mm: float, grid: Grid = PAPER.grid) -> Scan:
    """Return the surface that a scan most likely shows.

    Args:
        surface: Fitted to it by least squares.
        noise_mm: Standard deviation of its points along each direction of space, more than none.
        grid: Of the cloud.
    """
    places, shape, along_x, along_y = _places(grid)
    rates = _rates(surface, places, along_x, along_y).reshape(3, *shape, -1)
    found = surface.metric(places).T.reshape(3, *shape, 1)
    fits = [_Fit.of(_differences(rates, order), _differences(found, order)[:, 0], noise_mm) for order in (1, 2)]
    best = max(fits, key=lambda fit: fit.evidence)
    root_x, root_y = noise_roots(grid)
    back = best.back.reshape(3, len(root_x), len(root_y))
    moved = np.einsum("ia,kab,jb->ijk", root_x, back, root_y, optimize=True)
    return Scan(FittedSurface(surface.coefficients + moved, surface.size_mm), best.unsure, grid)


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """What one order of differences says."""

    evidence: float
    back: Array
    """(3 m,) of the ways of noise, what the surface gives back."""
    unsure: Array
    """(3 m, 3 m) as a scan has them."""

    @classmethod
    def of(cls, rates: Array, differences: Array, noise_mm: float) -> "_Fit":
        """Return it of (d, 3 m) derivatives of (d,) differences by the ways of noise of 1 mm."""
        size, way = np.linalg.eigh(rates.T @ rates)
        told = size > MIN_EIGENVALUE * size[-1]
        w = (way[:, told].T @ (rates.T @ differences)) / size[told]
        noise = noise_mm**2
        shown = STRENGTHS[:, None] * noise * (size[-1] / size[told])
        evidence = -0.5 * np.sum(w**2 / (shown + noise) + np.log(shown / noise + 1.0), axis=1)
        at = int(np.argmax(evidence))
        kept = np.ones(len(size))
        kept[told] = shown[at] / (shown[at] + noise)
        back = way[:, told] @ ((kept[told] - 1.0) * w)
        return cls(float(evidence[at]), back, noise_mm * way * np.sqrt(kept))


def _rates(surface: FittedSurface, xy_mm: Array, along_x: Array, along_y: Array) -> Array:
    """Return (3, n, 3 m) derivatives of E, F and G by (n, m) ways in which noise changes the tangents."""
    found = [
        np.stack([2.0 * x * along_x, x * along_y + y * along_x, 2.0 * y * along_y])
        for x, y in zip(*(one.T[:, :, None] for one in surface.tangents(xy_mm)), strict=True)
    ]
    return np.concatenate(found, axis=2)


def _differences(fields: Array, order: int) -> Array:
    """Return (d, m) differences of first or second order of (3, nx, ny, m) fields along both axes."""
    parts = [np.diff(fields, order, axis=1), np.diff(fields, order, axis=2)]
    if order == 2:
        parts.append(np.sqrt(2.0) * np.diff(np.diff(fields, axis=1), axis=2))
    return np.concatenate([one.reshape(-1, fields.shape[-1]) for one in parts])


@lru_cache(maxsize=4)
def _places(grid: Grid) -> tuple[Array, tuple[int, int], Array, Array]:
    """Return (n, 2) places, how many there are along x and y, and what noise does to the tangents there."""
    along_x, along_y = (PLACES_PER_KNOT * (len(root) - 3) + 1 for root in noise_roots(grid))
    x, y = np.linspace(0.0, grid.size_mm[0], along_x), np.linspace(0.0, grid.size_mm[1], along_y)
    places = np.stack([one.ravel() for one in np.meshgrid(x, y, indexing="ij")], axis=-1)
    return places, (along_x, along_y), *noise_tangents(places, grid)
