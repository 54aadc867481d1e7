"""The measured surface: 3 x 30 x 45 points in mm, one under each pixel's centre, in one agreed pose.

A scanner sees the sheet from anywhere. Before a cloud is stored, learned from or used, it is moved rigidly onto the
flat sheet, as close to it as least squares allow (Kabsch, "A solution for the best rotation to relate two sets of
vectors", Acta Cryst. A32, 1976). Two clouds of the same shape give the same numbers, whatever the pose. Only proper
rotations count: a mirrored sheet is another sheet.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.grid import GRID_SHAPE, SHEET_MM, pixel_centres_mm

CLOUD_SHAPE: Final = (3, *GRID_SHAPE)
"""Axes: x, y, z in mm; row along y; column along x."""

LARGEST_MM: Final = 1000.0
"""No coordinate is further than this from the origin: a cloud in metres or micrometres would be."""

SPREAD_MM: Final = (5.0, 500.0)
"""Root mean square distance of the points from their middle: 52 mm when flat, 25 mm when rolled up."""

INPUT_CENTRE_MM: Final = (SHEET_MM[0] / 2, SHEET_MM[1] / 2, 0.0)
"""What the network's input is centred on."""

INPUT_SCALE_MM: Final = 50.0
"""What the network's input is divided by, so that it is of order one."""


def flat_cloud() -> npt.NDArray[np.float64]:
    """Return the (3, 30, 45) mm cloud of the flat sheet: pixel centres with z = 0."""
    centres = pixel_centres_mm()
    return np.stack([centres[..., 0], centres[..., 1], np.zeros(GRID_SHAPE)])


def check_cloud(cloud: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Return a cloud as float64, or say what is wrong with it.

    Args:
        cloud: (3, 30, 45) mm.

    Raises:
        ValueError: Shape, type, a NaN or infinity, or a coordinate beyond 1000 mm; with the value and the bound.
    """
    try:
        if np.iscomplexobj(cloud):
            raise TypeError("complex numbers are no millimetres")
        points = np.array(cloud, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"a cloud must be numbers of shape {CLOUD_SHAPE} in mm, found {type(cloud).__name__}"
        ) from error
    if points.shape != CLOUD_SHAPE:
        raise ValueError(
            f"a cloud has shape {CLOUD_SHAPE} (x y z, rows, columns), found {points.shape}{_remedy(points.shape)}"
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
        raise ValueError(f"cloud{list(where)} is {points[where]:g} mm, expected at most {LARGEST_MM:g} mm in size")
    return points


def _remedy(shape: tuple[int, ...]) -> str:
    if sorted(shape) == sorted(CLOUD_SHAPE):
        axes = tuple(shape.index(size) for size in CLOUD_SHAPE)
        return f": axes are exchanged; give cloud.transpose{axes}"
    if len(shape) == 2 and 3 in shape:
        return ": unordered points? make a cloud of them with 'eitskin surface'"
    return ""


def align_cloud(cloud: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Return a cloud in the agreed pose: moved rigidly onto the flat sheet.

    Args:
        cloud: (3, 30, 45) mm, in any pose.

    Returns:
        (3, 30, 45) mm.

    Raises:
        ValueError: The cloud is malformed, its points lie on one line and so have no pose, or it is far too small or
            too large.
    """
    points = check_cloud(cloud).reshape(3, -1)
    target = flat_cloud().reshape(3, -1)
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
    return np.asarray(aligned.reshape(CLOUD_SHAPE), dtype=np.float64)


def network_input(cloud: npt.ArrayLike) -> npt.NDArray[np.float32]:
    """Return (3, 30, 45) float32 for a network: aligned, centred on the sheet, divided by 50 mm.

    Raises:
        ValueError: See :func:`align_cloud`.
    """
    centre = np.array(INPUT_CENTRE_MM).reshape(3, 1, 1)
    return np.asarray((align_cloud(cloud) - centre) / INPUT_SCALE_MM, dtype=np.float32)
