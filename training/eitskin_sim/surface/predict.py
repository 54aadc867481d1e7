"""V_pred: the voltages of the untouched, deformed sheet, predicted from its cloud alone.

The cloud is the place in space of every pixel's centre. A tensor-product cubic spline through it, least squares on
far fewer coefficients than points, takes the scanner's noise out and gives tangents everywhere, up to the border half
a pixel beyond the outermost points; their inner products are the metric E, F, G that
:func:`eitskin_sim.fem.forward.assemble` asks for. The voltages are solved on a coarse mesh and corrected by what the
same mesh is off on the flat sheet, which is known.

A cloud cannot show where the material is stretched unevenly within the surface. The cloud divides rows and columns by
arc length, so V_pred is that of the evenly stretched sheet.

A network's head takes the prediction as :func:`predicted_log`, the logarithm of its ratio to the same model's flat
sheet: what the two have in common, the model's own error and the current, drops out.
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy import linalg
from scipy.interpolate import BSpline

from eitskin_proto.sensor.normalise import log_prediction
from eitskin_proto.sensor.table import N_ROWS
from eitskin_proto.skin.cloud import check_cloud
from eitskin_proto.skin.grid import Grid
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.arrays import Array
from eitskin_sim.fem.forward import assemble
from eitskin_sim.fem.mesh import TensorMesh
from eitskin_sim.fem.meshing import scene_mesh
from eitskin_sim.scene.nominal import flat_metric_of, nominal_electrodes, nominal_scene, nominal_sheet

KNOTS_MM: Final = 20.0
"""The spline's knots are no farther apart: 88 coefficients for the paper's 1350 points, and a bump of sigma 12 mm still
fits."""

COARSE_MM: Final = 4.5
"""Element size of the solve."""

FINE_MM: Final = 1.5
"""Element size of the flat sheet's correction, solved once a process and skin."""

SKINS_KEPT: Final = 4
"""Skins whose flat sheets and meshes are kept while the process runs."""

_DEGREE: Final = 3


@dataclass(frozen=True, slots=True)
class FittedSurface:
    """A spline through a cloud, in the flat sheet's coordinates."""

    coefficients: Array
    """(nx, ny, 3) mm."""
    size_mm: tuple[float, float]
    """Length and width of the flat sheet."""

    def metric(self, xy_mm: Array) -> Array:
        """Return the (n, 3) first fundamental form E, F, G at flat points (n, 2)."""
        along_x, along_y = self.tangents(xy_mm)
        return np.stack([np.sum(a * b, 1) for a, b in ((along_x, along_x), (along_x, along_y), (along_y, along_y))], -1)

    def tangents(self, xy_mm: Array) -> tuple[Array, Array]:
        """Return the (n, 3) derivatives of the place by x and by y at flat points (n, 2)."""
        return self._evaluate(xy_mm, (1, 0)), self._evaluate(xy_mm, (0, 1))

    def points(self, xy_mm: Array) -> Array:
        """Return the (n, 3) positions in mm of flat points (n, 2)."""
        return self._evaluate(xy_mm, (0, 0))

    def _evaluate(self, xy_mm: Array, derivative: tuple[int, int]) -> Array:
        # Meshes repeat their coordinates: a few hundred different values of each serve tens of thousands of points.
        x, at_x = np.unique(xy_mm[:, 0], return_inverse=True)
        y, at_y = np.unique(xy_mm[:, 1], return_inverse=True)
        count_x, count_y, _ = self.coefficients.shape
        in_x = _basis(x, self.size_mm[0], count_x, derivative[0])
        in_y = _basis(y, self.size_mm[1], count_y, derivative[1])
        return np.asarray((in_y @ np.tensordot(in_x, self.coefficients, 1))[at_x, at_y])


def fit_cloud(cloud_mm: npt.ArrayLike, grid: Grid = PAPER.grid) -> FittedSurface:
    """Return the smooth surface through a cloud (3, rows, columns) of a grid's pixels in mm, in any pose.

    Raises:
        ValueError: The cloud is malformed.
    """
    cloud = check_cloud(cloud_mm, grid)
    to_x, to_y = _fitters(grid)
    return FittedSurface(np.einsum("ic,jr,krc->ijk", to_x, to_y, cloud, optimize=True), grid.size_mm)


def noise_tangents(xy_mm: Array, grid: Grid = PAPER.grid) -> tuple[Array, Array]:
    """Return the effect of a scanner's noise on the tangents of a fitted surface; exact, because the fit is linear.

    Args:
        xy_mm: (n, 2) flat points.
        grid: Of the cloud.

    Returns:
        (n, m) derivatives by x and by y of m independent ways in which noise of 1 mm moves the surface along any one
        direction of space, each of one standard deviation.
    """
    parts = []
    for axis, (root, extent) in enumerate(zip(noise_roots(grid), grid.size_mm, strict=True)):
        parts.append([_basis(xy_mm[:, axis], extent, len(root), derivative) @ root for derivative in (0, 1)])
    (x, by_x), (y, by_y) = parts
    along_x, along_y = (np.einsum("ni,nj->nij", *pair).reshape(len(xy_mm), -1) for pair in ((by_x, y), (x, by_y)))
    return along_x, along_y


def noise_roots(grid: Grid = PAPER.grid) -> tuple[Array, Array]:
    """Return the (nx, nx) and (ny, ny) coefficients along x and along y of the ways of :func:`noise_tangents`."""
    along_x, along_y = (np.asarray(linalg.cholesky(to @ to.T, lower=True)) for to in _fitters(grid))
    return along_x, along_y


def predict(cloud_mm: npt.ArrayLike, skin: Skin = PAPER) -> Array:
    """Return the (104,) V that the forward model computes for an untouched sheet at a cloud, under 1 A.

    Args:
        cloud_mm: (3, rows, columns) mm, in any pose.
        skin: The skin of the cloud; the model uses its stated values.

    Raises:
        ValueError: The cloud is malformed, or folds in its own plane.
    """
    fine, coarse = _flat(skin)
    return np.asarray(_solve(skin, fit_cloud(cloud_mm, skin.grid).metric, COARSE_MM) * (fine / coarse))


def flat_voltages(skin: Skin = PAPER) -> Array:
    """Return the (104,) V of the same model for the flat sheet, to compare V_pred with."""
    return _flat(skin)[0].copy()


def predicted_log(clouds_mm: Iterable[npt.ArrayLike], skin: Skin = PAPER) -> npt.NDArray[np.float32]:
    """Return the (D, 104) log |V_pred| / |V_flat| of D sheets: the head's second input.

    About 40 ms a sheet on one core.

    Args:
        clouds_mm: D clouds (3, rows, columns) mm, in any pose.
        skin: Whose clouds.

    Raises:
        ValueError: A cloud is malformed, or folds in its own plane.
    """
    predicted = np.array([predict(cloud, skin) for cloud in clouds_mm]).reshape(-1, N_ROWS)
    return log_prediction(predicted, _flat(skin)[0])


@lru_cache(maxsize=SKINS_KEPT)
def _flat(skin: Skin) -> tuple[Array, Array]:
    metric = flat_metric_of(skin)
    return _solve(skin, metric, FINE_MM), _solve(skin, metric, COARSE_MM)


@lru_cache(maxsize=2 * SKINS_KEPT)
def _mesh(skin: Skin, element_size_mm: float) -> TensorMesh:
    return scene_mesh(nominal_scene(skin, element_size_mm=element_size_mm))


def _solve(skin: Skin, metric: Callable[[Array], Array], element_size_mm: float) -> Array:
    mesh = _mesh(skin, element_size_mm)
    return assemble(mesh, nominal_sheet(skin), nominal_electrodes(skin), metric).factorise().voltages()


def _counts(grid: Grid) -> tuple[int, int]:
    """Spline coefficients along x and along y: no more than there are pixels."""
    along = (math.ceil(extent / KNOTS_MM) + _DEGREE for extent in grid.size_mm)
    count_x, count_y = (min(count, n) for count, n in zip(along, grid.shape[::-1], strict=True))
    return count_x, count_y


def _basis(at_mm: Array, extent_mm: float, count: int, derivative: int = 0) -> Array:
    """(n, count) values of the cubic B-splines on a side of the sheet, or of their derivatives in 1 / mm."""
    inner = np.linspace(0.0, extent_mm, count - _DEGREE + 1)
    knots = np.concatenate([np.zeros(_DEGREE), inner, np.full(_DEGREE, extent_mm)])
    splines = BSpline(knots, np.eye(count), _DEGREE)
    return np.asarray(splines(np.clip(at_mm, 0.0, extent_mm), nu=derivative))


@lru_cache(maxsize=SKINS_KEPT)
def _fitters(grid: Grid) -> tuple[Array, Array]:
    """(nx, columns) and (ny, rows) least squares from samples at pixel centres to spline coefficients."""
    found = []
    sides = zip(grid.size_mm, _counts(grid), grid.shape[::-1], grid.pixel_mm, strict=True)
    for extent, count, n, pixel in sides:
        centres = np.asarray((np.arange(n) + 0.5) * pixel, dtype=np.float64)
        found.append(np.asarray(linalg.pinv(_basis(centres, extent, count)), dtype=np.float64))
    return found[0], found[1]
