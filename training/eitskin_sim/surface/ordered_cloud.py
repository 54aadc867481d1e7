"""From a raw scan of the bent sheet, unordered and in any pose, to the ordered 3 x 30 x 45 cloud in the agreed one.

::

    raw points --unroll--> chart (u, v), outliers gone --outline--> unit square --surface--> smooth, even by arc length
               --corner--> rows along y, columns along x --align_cloud--> the agreed pose

A rectangle looks the same from either side and after half a turn, so four ways to put x and y on it fit the scan
equally well. Only a mark can tell: ``corner_mm``, a point near the sheet's corner (0, 0) in the scan's own frame,
decides between all four, side included, because x is the long way. Without it the scanner's frame is taken as the hint:
of the four, the one whose pose is turned least against that frame; the result then says so.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Final
from zipfile import BadZipFile

import numpy as np
import numpy.typing as npt

from eitskin_proto.errors import MismatchError, SkinError
from eitskin_proto.sensor.cloud import align_cloud, check_cloud, flat_cloud
from eitskin_proto.sensor.grid import SHEET_MM
from eitskin_proto.sensor.ids import GRID_ID
from eitskin_sim.surface.outline import find_outline, largest_hole_mm
from eitskin_sim.surface.smooth_surface import by_arc_length, fit_surface, side_lengths_mm
from eitskin_sim.surface.unroll import unroll

Array = npt.NDArray[np.float64]

LARGEST_HOLE_MM: Final = 15.0
"""A hole up to this diameter is filled."""

HOLE_SLACK_MM: Final = 1.0
"""How much larger a hole of exactly that size may measure: the gaps between the points around it."""

LEAST_POINTS: Final = 1500
"""A scan of fewer points, one in 10 mm^2, does not carry the shape."""

MOST_POINTS: Final = 40_000
"""Points used of a larger scan, taken evenly: 40 a cell of 4 mm, so that 0.1 mm of noise leaves 0.016 mm."""

STRETCH_BOUNDS: Final = (0.7, 1.5)
"""A side outside these multiples of the flat sheet's is not this sheet."""

MAGIC: Final = "eitskin-cloud"
"""First word of a cloud file."""

VERSION: Final = 1
"""Layout of a cloud file."""


class ScanError(SkinError):
    """A scan that cannot be read, or that does not show the sheet."""


@dataclass(frozen=True, slots=True)
class ScanResult:
    """An organised scan and what was found on the way."""

    cloud_mm: Array
    """(3, 30, 45) in the agreed pose, even by arc length."""
    size_mm: tuple[float, float]
    """Mean arc length along x and along y."""
    noise_mm: float
    """Robust standard deviation of the points off the surface."""
    points: int
    """Points used."""
    outliers: int
    """Points left out of those."""
    largest_hole_mm: float
    """Diameter of the largest hole, which was filled."""
    corner: str
    """What decided where (0, 0) is: ``"given"`` or ``"scanner frame"``."""
    rotation: Array
    """(3, 3) that turns the scan's frame into the cloud's."""
    translation_mm: Array
    """(3,) added after the rotation."""


def organise(points_mm: npt.ArrayLike, corner_mm: tuple[float, float, float] | None = None) -> ScanResult:
    """Return the ordered cloud of a raw scan.

    Args:
        points_mm: (n, 3) unordered points, in any pose.
        corner_mm: A point near the sheet's corner (0, 0), in the scan's frame.

    Raises:
        ScanError: Too few points, not the sheet, a hole that is too large, or a corner hint that decides nothing.
    """
    points = _check_points(points_mm)
    try:
        chart = unroll(points)
        outline = find_outline(chart.uv_mm)
    except ValueError as error:
        raise ScanError(f"the scan does not show the sheet: {error}") from error
    _check_size(outline.size_mm)
    square = outline.to_square(chart.uv_mm)
    hole = largest_hole_mm(square, outline.size_mm)
    if hole > LARGEST_HOLE_MM + HOLE_SLACK_MM:
        raise ScanError(
            f"the scan has a hole of {hole:.1f} mm; at most {LARGEST_HOLE_MM:g} mm can be filled: scan that part again"
        )
    size = np.array(outline.size_mm)
    on_sheet = np.all((square > -0.02) & (square < 1.02), axis=0)
    surface = fit_surface(square[:, on_sheet] * size[:, None], chart.points_mm[:, on_sheet], outline.size_mm)
    ordered, corner = _choose_corner(surface, corner_mm)
    raw = by_arc_length(ordered)
    rotation, translation = _pose(raw)
    return ScanResult(
        cloud_mm=align_cloud(raw),
        size_mm=side_lengths_mm(ordered),
        noise_mm=chart.noise_mm,
        points=len(points),
        outliers=chart.outliers + int((~on_sheet).sum()),
        largest_hole_mm=hole,
        corner=corner,
        rotation=rotation,
        translation_mm=translation,
    )


def save_cloud(path: str | Path, result: ScanResult) -> None:
    """Write an organised scan as .npz: ``cloud`` (3, 30, 45) float64 mm, ids, and how it was found."""
    with Path(path).open("wb") as file:
        np.savez(
            file,
            magic=MAGIC,
            version=VERSION,
            grid_id=GRID_ID,
            cloud=result.cloud_mm,
            size_mm=np.array(result.size_mm),
            noise_mm=result.noise_mm,
            corner=result.corner,
            rotation=result.rotation,
            translation_mm=result.translation_mm,
        )


def load_cloud(path: str | Path) -> Array:
    """Return the (3, 30, 45) cloud of a file that :func:`save_cloud` wrote.

    Raises:
        ScanError: The file is no cloud.
        MismatchError: The cloud was made for another grid.
    """
    try:
        with Path(path).open("rb") as raw, np.load(raw, allow_pickle=False) as file:
            if str(file["magic"]) != MAGIC:
                raise ScanError(f"{path} is no cloud: make one with 'eitskin surface'")
            if str(file["grid_id"]) != GRID_ID:
                raise MismatchError(
                    f"{path}: grid_id", found=str(file["grid_id"]), expected=GRID_ID, hint="run 'eitskin surface' again"
                )
            return check_cloud(file["cloud"])
    except (ValueError, KeyError, EOFError, BadZipFile) as error:
        raise ScanError(f"{path} is no cloud ({error}): make one with 'eitskin surface'") from error


def _check_points(points_mm: npt.ArrayLike) -> Array:
    points = np.asarray(points_mm, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ScanError(f"a scan is a list of x, y, z in mm: found shape {points.shape}, expected (n, 3)")
    finite = np.isfinite(points)
    if not finite.all():  # row by row takes 2 ms more
        points = points[finite.all(axis=1)]
    if len(points) > MOST_POINTS:
        points = points[np.arange(MOST_POINTS) * len(points) // MOST_POINTS]
    if len(points) < LEAST_POINTS:
        raise ScanError(f"the scan has {len(points)} finite points; at least {LEAST_POINTS} are needed")
    sample = points[:: len(points) // 5000 + 1]
    spread = np.percentile(sample, 95, axis=0) - np.percentile(sample, 5, axis=0)
    if spread.max() < 5.0 or spread.max() > 5000.0:
        raise ScanError(
            f"the scan spans {spread.max():.3g} mm; the sheet is {SHEET_MM[0]:g} mm long: save the scan in millimetres"
        )
    return points


def _check_size(size_mm: tuple[float, float]) -> None:
    for name, found, flat in zip(("long", "wide"), size_mm, SHEET_MM, strict=True):
        low, high = (bound * flat for bound in STRETCH_BOUNDS)
        if not low <= found <= high:
            raise ScanError(
                f"the scanned sheet is {found:.1f} mm {name}; expected {low:g} to {high:g} mm: "
                "scan the whole conductive layer, in millimetres, and nothing else"
            )


def _choose_corner(surface: Array, corner_mm: tuple[float, float, float] | None) -> tuple[Array, str]:
    """The surface with (0, 0) first, and what decided."""
    candidates = [surface, surface[:, :, ::-1], surface[:, ::-1, :], surface[:, ::-1, ::-1]]
    if corner_mm is None:
        turned = [_alignment(candidate) for candidate in candidates]
        return candidates[int(np.argmax(turned))], "scanner frame"
    hint = np.asarray(corner_mm, dtype=np.float64)
    distance = np.array([np.linalg.norm(candidate[:, 0, 0] - hint) for candidate in candidates])
    nearest, second = np.sort(distance)[:2]
    if not nearest < 0.5 * second:
        raise ScanError(
            f"the corner hint {tuple(float(x) for x in hint)} is {nearest:.1f} and {second:.1f} mm from the two "
            "nearest corners: give a point, in the scan's frame, clearly nearest to the corner (0, 0)"
        )
    return candidates[int(np.argmin(distance))], "given"


def _alignment(surface: Array) -> float:
    """Trace of the rotation that lays a surface's nodes on the flat sheet: 3 for none, -1 for half a turn."""
    rows, columns = np.meshgrid(*(np.linspace(-0.5, 0.5, n) for n in surface.shape[1:]), indexing="ij")
    flat = np.stack([SHEET_MM[0] * columns, SHEET_MM[1] * rows, np.zeros_like(rows)]).reshape(3, -1)
    left, _, right = np.linalg.svd(flat @ (surface - surface.mean(axis=(1, 2), keepdims=True)).reshape(3, -1).T)
    return float(np.trace(left @ np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))]) @ right))


def _pose(cloud: Array) -> tuple[Array, Array]:
    """The rigid motion that ``align_cloud`` applies."""
    points, aligned = cloud.reshape(3, -1), align_cloud(cloud - cloud.mean(axis=(1, 2), keepdims=True)).reshape(3, -1)
    target = flat_cloud().reshape(3, -1).mean(axis=1)
    centre = points.mean(axis=1)
    rotation = (aligned - target[:, None]) @ np.linalg.pinv(points - centre[:, None])
    left, _, right = np.linalg.svd(rotation)  # a flat sheet leaves the pseudo-inverse blind along its normal
    proper = left @ np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))]) @ right
    return np.asarray(proper), np.asarray(target - proper @ centre)
