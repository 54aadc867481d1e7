"""A cloud: the place of each pixel's centre on the measured surface, in mm.

A cloud is (3, rows, columns): x, y, z; rows along y; columns along x. The paper's is (3, 30, 45).

The pose of a cloud depends on the scanner. Before use it is therefore moved rigidly onto the flat sheet, by least
squares (Kabsch, "A solution for the best rotation to relate two sets of vectors", Acta Cryst. A32, 1976). Clouds of the
same shape then have the same numbers. Only proper rotations are used: a mirrored sheet is another sheet.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.skin.grid import Grid
from eitskin_proto.skin.skin import PAPER

LARGEST_MM: Final = 100_000.0
"""Largest coordinate; single precision resolves 0.004 mm there."""

SPREAD_MM: Final = (5.0, 500.0)
"""Limits of the rms distance of the points from their mean: the paper's sheet has 52 mm when flat, 25 mm when rolled
up; the smallest skin has 20 mm when flat, the largest 163 mm."""

INPUT_PARTS: Final = 3
"""A network's unit of length is the sheet's longer side over this number: 50 mm for the paper's."""


def pixel_centres_mm(grid: Grid = PAPER.grid) -> npt.NDArray[np.float64]:
    """Return x and y of every pixel's centre on the flat sheet in mm, (rows, columns, 2)."""
    return grid.pixel_centres_mm()


def flat_cloud(grid: Grid = PAPER.grid) -> npt.NDArray[np.float64]:
    """Return the (3, rows, columns) mm cloud of the flat sheet: pixel centres with z = 0."""
    return grid.flat_cloud_mm()


def check_cloud(cloud: npt.ArrayLike, grid: Grid = PAPER.grid) -> npt.NDArray[np.float64]:
    """Return a cloud as float64 after checking it.

    Args:
        cloud: (3, rows, columns) mm.
        grid: The skin's grid.

    Raises:
        ValueError: Wrong shape or type, a value that is not finite, or a coordinate beyond ``LARGEST_MM``; with the
            value and the bound.
    """
    expected = grid.cloud_shape
    try:
        if np.iscomplexobj(cloud):
            raise TypeError("found complex numbers, expected millimetres")
        with np.errstate(invalid="ignore"):  # a NaN that signals is refused like any other
            points = np.array(cloud, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"a cloud must be numbers of shape {expected} in mm, found {type(cloud).__name__}") from error
    if points.shape != expected:
        raise ValueError(
            f"a cloud has shape {expected} (x y z, rows, columns), found {points.shape}"
            f"{_remedy(points.shape, expected)}"
        )
    finite = np.isfinite(points)
    if not finite.all():
        where = tuple(int(i) for i in np.argwhere(~finite)[0])
        raise ValueError(
            f"cloud{list(where)} is {points[where]}, expected a finite number of mm; {int((~finite).sum())} of "
            f"{points.size} values are not finite"
        )
    largest = float(np.abs(points).max())
    if largest > LARGEST_MM:
        where = tuple(int(i) for i in np.argwhere(np.abs(points) == largest)[0])
        raise ValueError(
            f"cloud{list(where)} is {points[where]:g} mm, expected at most {LARGEST_MM:g} mm from the origin: give "
            "the cloud in mm, with its origin near the sheet"
        )
    return points


def _remedy(shape: tuple[int, ...], expected: tuple[int, ...]) -> str:
    if sorted(shape) == sorted(expected):
        axes = tuple(shape.index(size) for size in expected)
        return f": axes are exchanged; give cloud.transpose{axes}"
    if len(shape) == 2 and 3 in shape:
        return ": unordered points? make a cloud of them with 'eitskin surface'"
    return ""


def align_cloud(cloud: npt.ArrayLike, grid: Grid = PAPER.grid) -> npt.NDArray[np.float64]:
    """Return a cloud moved rigidly onto the flat sheet.

    Args:
        cloud: (3, rows, columns) mm, in any pose.
        grid: The skin's grid.

    Returns:
        (3, rows, columns) mm.

    Raises:
        ValueError: The cloud is malformed, far too small or too large, or all its points are on one line.
    """
    points = check_cloud(cloud, grid).reshape(3, -1)
    target = grid.flat_cloud_mm().reshape(3, -1)
    centred = points - points.mean(axis=1, keepdims=True)
    target_centre = target.mean(axis=1, keepdims=True)
    left, size, right = np.linalg.svd((target - target_centre) @ centred.T)
    if size[1] <= 1e-6 * size[0] or size[0] == 0.0:
        raise ValueError(
            f"the cloud's points lie on one line or in one point (singular values {size[0]:.3g}, {size[1]:.3g}); "
            "expected a surface"
        )
    spread = float(np.sqrt(np.mean(np.sum(centred**2, axis=0))))
    if not SPREAD_MM[0] <= spread <= SPREAD_MM[1]:
        raise ValueError(
            f"the cloud's points are {spread:.3g} mm (rms) from their middle, expected {SPREAD_MM[0]:g} to "
            f"{SPREAD_MM[1]:g} mm: is it in mm?"
        )
    handedness = np.sign(np.linalg.det(left @ right))
    rotation = left @ np.diag([1.0, 1.0, handedness]) @ right
    aligned = rotation @ centred + target_centre
    return np.asarray(aligned.reshape(grid.cloud_shape), dtype=np.float64)


def network_input(cloud: npt.ArrayLike, grid: Grid = PAPER.grid) -> npt.NDArray[np.float32]:
    """Return a network's input, (3, rows, columns) float32: the aligned cloud, centred, in thirds of the longer side.

    Raises:
        ValueError: As for :func:`align_cloud`.
    """
    length, width = grid.size_mm
    centre = np.array([length / 2, width / 2, 0.0]).reshape(3, 1, 1)
    return np.asarray((align_cloud(cloud, grid) - centre) / (max(length, width) / INPUT_PARTS), dtype=np.float32)
