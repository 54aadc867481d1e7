"""From raw points of the bent sheet, unordered and in any pose, to the ordered cloud in the agreed one.

::

    raw points --unroll--> chart (u, v), outliers gone --outline--> unit square --surface--> smooth, even by arc length
               --corner--> rows along y, columns along x --align_cloud--> the agreed pose

A rectangle looks the same from either side and after half a turn, so four ways to put x and y on it fit the points
equally well. Only a mark can tell: ``corner_mm``, a point near the sheet's corner (0, 0) in the points' own frame,
decides between all four, side included, because it is known which way is the long one. Without it the scanner's frame
is taken as the hint: of the four, the one whose pose is turned least against that frame; the result then says so. On a
sheet that is nearly square x may go either way, and a corner decides between eight but for the side: the frame does.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.spatial import QhullError

from eitskin_proto.errors import SkinError
from eitskin_proto.skin.cloud import align_cloud, flat_cloud
from eitskin_proto.skin.cloud_file import Surface, save_surface
from eitskin_proto.skin.grid import Grid
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.arrays import Array
from eitskin_sim.surface.outline import find_outline, largest_hole_mm
from eitskin_sim.surface.pieces import keep_sheet
from eitskin_sim.surface.smooth_surface import by_arc_length, fit_surface, nodes_of, side_lengths_mm
from eitskin_sim.surface.unroll import unroll

LARGEST_HOLE_MM: Final = 15.0
"""A hole up to this diameter is filled."""

HOLE_SLACK_MM: Final = 1.0
"""How much larger a hole of exactly that size may measure: the gaps between the points around it."""

MIN_POINTS_PER_MM2: Final = 0.1
"""Fewer points do not carry the shape: 1500 on the paper's sheet."""

MAX_POINTS_PER_MM2: Final = 8 / 3
"""Points used of more, taken by chance: 40 a cell of 4 mm, so that 0.1 mm of noise leaves 0.016 mm."""

MAX_RATIO_OF_SQUARE: Final = 1.35
"""A sheet whose sides differ by less may be stretched until the shorter is the longer."""

STRETCH_BOUNDS: Final = (0.7, 1.5)
"""A side outside these multiples of the flat sheet's is not this sheet."""

RMS_PER_MM: Final = 0.12
"""Error of V_pred for each millimetre of the sides' uncertainty: the median of 350 draws of families A and B, points
0.7 to 3 mm apart, noise 0.05 to 0.3 mm."""

RMS_PER_SHIFT_MM: Final = 0.045
"""The same where whole sides are shifted: that changes lengths, but bends nothing."""

DOUBTFUL_RMS: Final = 0.02
"""With more than this V_pred may harm: one sheet in ten is then off by 5 % or more, and a V_pred that was 5 % off made
the sample scene's maps worse than none."""


OTHER_LENGTH: Final = 1.03
"""A side longer or shorter than the flat sheet's by this factor may not be that of the whole sheet alone."""

RMS_PER_EXCESS_MM: Final = 0.02
"""Error of V_pred for each millimetre that the sides are off the flat sheet's, where that may be no stretch."""


class PointCloudError(SkinError):
    """Points that do not show the sheet."""


@dataclass(frozen=True, slots=True)
class OrderedCloud:
    """The ordered cloud, and what was found on the way."""

    cloud_mm: Array
    """(3, rows, columns) in the agreed pose, even by arc length."""
    size_mm: tuple[float, float]
    """Mean arc length along x and along y."""
    outline_sigma_mm: float
    """Uncertainty of the places of the sheet's sides, rms."""
    prediction_rms: float
    """Error of V_pred, relative and rms over the rows: the median of drawn sheets with such an outline, of which one in
    ten is off by three times as much."""
    noise_mm: float
    """Robust standard deviation of the points off the surface."""
    points: int
    """Points used."""
    outliers: int
    """Points left out of those."""
    largest_hole_mm: float
    """Diameter of the largest hole, which was filled."""
    corner: str
    """The source of the place of (0, 0): ``"given"`` or ``"scanner frame"``."""
    rotation: Array
    """(3, 3) that turns the points' frame into the cloud's."""
    translation_mm: Array
    """(3,) added after the rotation."""
    doubts: tuple[str, ...] = ()
    """What the scan may show beside the sheet, and what to do about it."""


def organise(
    points_mm: npt.ArrayLike,
    corner_mm: npt.ArrayLike | None = None,
    grid: Grid = PAPER.grid,
    rim_mm: tuple[float, float] | None = None,
) -> OrderedCloud:
    """Return the ordered cloud of raw points.

    Args:
        points_mm: (n, 3) unordered points, in any pose.
        corner_mm: (3,) near the sheet's corner (0, 0), in the points' frame, such as its place in the previous scan.
        grid: The skin's grid: size of the sheet and pixels of the cloud.
        rim_mm: Width to cut off at both ends of the longer sides, and along them; None: not known, so sides of another
            length than the flat sheet's make V_pred doubtful.

    Raises:
        PointCloudError: Two sheets, too few points, not the sheet, too large a hole, or a corner hint that fits two
            corners.
    """
    points = _check_points(points_mm, grid)
    try:
        return _organise(points, corner_mm, grid, rim_mm)
    except (np.linalg.LinAlgError, QhullError) as error:
        raise PointCloudError(
            f"the {len(points)} points lie on a line or crowd at a few places, so they show no surface: expected "
            "points all over the sheet; scan it again"
        ) from error


def _organise(
    points: Array, corner_mm: npt.ArrayLike | None, grid: Grid, rim_mm: tuple[float, float] | None
) -> OrderedCloud:
    flat_mm = max(grid.size_mm), min(grid.size_mm)  # as the chart has it: the longer side first
    try:
        chart = unroll(points, flat_mm)
        outline = find_outline(chart.uv_mm, chart.noise_mm, flat_mm)
    except (np.linalg.LinAlgError, QhullError):
        raise
    except ValueError as error:
        raise PointCloudError(f"the points do not show the sheet: {error}") from error
    if rim_mm is not None:
        outline = outline.without_rim(rim_mm)
    _check_size(outline.size_mm, flat_mm)
    excess = np.subtract(outline.size_mm, flat_mm) if rim_mm is None else np.zeros(2)
    square = outline.to_square(chart.uv_mm)
    hole = largest_hole_mm(square, outline.size_mm)
    if hole > LARGEST_HOLE_MM + HOLE_SLACK_MM:
        raise PointCloudError(
            f"the points leave a hole of {hole:.1f} mm; at most {LARGEST_HOLE_MM:g} mm can be filled: measure "
            "that part again"
        )
    size = np.array(outline.size_mm)
    on_sheet = np.all((square > -0.02) & (square < 1.02), axis=0)
    places = square[:, on_sheet] * size[:, None]
    surface = fit_surface(places, chart.points_mm[:, on_sheet], outline.size_mm, nodes_of(flat_mm))
    ordered, corner = _choose_corner(_ways(surface, grid.size_mm), corner_mm, grid.size_mm)
    raw = by_arc_length(ordered, grid.shape)
    rotation, translation = _pose(raw, grid)
    return OrderedCloud(
        cloud_mm=align_cloud(raw, grid),
        size_mm=side_lengths_mm(ordered),
        outline_sigma_mm=float(np.hypot(outline.sigma_mm, outline.shift_mm)),
        prediction_rms=float(
            np.linalg.norm(
                [RMS_PER_MM * outline.sigma_mm, RMS_PER_SHIFT_MM * outline.shift_mm, *RMS_PER_EXCESS_MM * excess]
            )
        ),
        noise_mm=chart.noise_mm,
        points=len(points),
        outliers=chart.outliers + int((~on_sheet).sum()),
        largest_hole_mm=hole,
        corner=corner,
        rotation=rotation,
        translation_mm=translation,
        doubts=_doubts(outline.size_mm, flat_mm, rim_mm),
    )


def _doubts(
    size_mm: tuple[float, float], flat_mm: tuple[float, float], rim_mm: tuple[float, float] | None
) -> tuple[str, ...]:
    share = np.divide(size_mm, flat_mm)
    low, high = float(share.min()), float(share.max())
    found = f"{size_mm[0]:.1f} x {size_mm[1]:.1f} mm, the skin {flat_mm[0]:g} x {flat_mm[1]:g} mm"
    if rim_mm is not None:
        if not any(rim_mm) or 1.0 / OTHER_LENGTH <= low <= OTHER_LENGTH:
            return ()
        return (
            f"without its rim the scan is {found}: expected a rim that leaves the whole skin; check --rim, whose first "
            "width is that at the ends of the longer sides",
        )
    if high > OTHER_LENGTH:
        why = (
            "it may show a rim or clamps, or the sheet is stretched; cut a rim off with --rim MM or clamps with "
            "--crop, or say --rim 0 if it is stretched"
        )
    elif low < 1.0 / OTHER_LENGTH:
        why = (
            "it may show only a part of the sheet or in another scale, or the sheet is compressed; scan all of it in "
            "true millimetres, or say --rim 0 if it is compressed"
        )
    else:
        return ()
    return (f"the scan is {found}: {why}",)


def save_cloud(
    path: str | Path, result: OrderedCloud, predicted: tuple[Array, Array] | None = None, skin: Skin = PAPER
) -> None:
    """Write an ordered cloud, and how it was found, as the file that the runtime takes.

    Args:
        path: See :mod:`eitskin_proto.skin.cloud_file` for what is in it.
        result: The cloud.
        predicted: (104,) V_pred of it and (104,) of the flat sheet, by :mod:`eitskin_sim.surface.predict`.
        skin: The skin of the cloud.

    Raises:
        OSError: The file cannot be written.
    """
    about = {
        "size_mm": np.array(result.size_mm),
        "noise_mm": result.noise_mm,
        "outline_sigma_mm": result.outline_sigma_mm,
        "corner": result.corner,
    }
    predicted_V, flat_V = predicted or (None, None)
    surface = Surface(result.cloud_mm, predicted_V, flat_V, result.rotation, result.translation_mm)
    save_surface(path, surface, about, skin)


def _check_points(points_mm: npt.ArrayLike, grid: Grid) -> Array:
    area_mm2 = grid.size_mm[0] * grid.size_mm[1]
    least, most = round(MIN_POINTS_PER_MM2 * area_mm2), round(MAX_POINTS_PER_MM2 * area_mm2)
    points = np.asarray(points_mm, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise PointCloudError(f"points are a list of x, y, z in mm: found shape {points.shape}, expected (n, 3)")
    points = points[np.isfinite(points).all(axis=1)]
    unseen = ~points.any(axis=1)  # cameras write zeros for what they do not see
    if np.count_nonzero(unseen) > 1:
        points = points[~unseen]
    flat_mm = max(grid.size_mm), min(grid.size_mm)
    try:
        points = keep_sheet(points, flat_mm, lambda piece: _size(_thinned(piece, most), flat_mm))
    except ValueError as error:
        raise PointCloudError(str(error)) from error
    points = _thinned(points, most)
    if len(points) < least:
        raise PointCloudError(
            f"found {len(points)} finite points, expected at least {least}: measure the sheet more densely"
        )
    sample = points[:: len(points) // 5000 + 1]
    spread = np.percentile(sample, 95, axis=0) - np.percentile(sample, 5, axis=0)
    if spread.max() < 5.0 or spread.max() > 5000.0:
        raise PointCloudError(
            f"the points span {spread.max():.3g} mm; the sheet is {max(grid.size_mm):g} mm long: "
            "save them in millimetres, or give --unit m if they are in metres"
        )
    return points


def _thinned(points: Array, most: int) -> Array:
    if len(points) <= most:
        return points
    # By chance: every second or third point of a regular grid would leave out whole rows.
    return points[np.random.default_rng(0).choice(len(points), most, replace=False, shuffle=False)]


def _size(points: Array, flat_mm: tuple[float, float]) -> tuple[float, float]:
    """The two sides of a piece of the scan."""
    try:
        chart = unroll(points, flat_mm)
        return find_outline(chart.uv_mm, chart.noise_mm, flat_mm).size_mm
    except (np.linalg.LinAlgError, QhullError) as error:
        raise ValueError(str(error)) from error


def _check_size(size_mm: tuple[float, float], flat_mm: tuple[float, float]) -> None:
    for name, found, flat in zip(("long", "wide"), size_mm, flat_mm, strict=True):
        low, high = (bound * flat for bound in STRETCH_BOUNDS)
        if not low <= found <= high:
            raise PointCloudError(
                f"the points' sheet is {found:.1f} mm {name}; expected {low:g} to {high:g} mm: "
                "scan the whole sheet in true millimetres, and cut off the rest with --crop, --plane or --depth"
            )


def _ways(surface: Array, size_mm: tuple[float, float]) -> list[Array]:
    """The ways to put x and y on a surface whose rows run along its longer side: four, or eight if near square."""
    length, width = size_mm
    laid = [surface] if length * MAX_RATIO_OF_SQUARE >= width else []
    if width * MAX_RATIO_OF_SQUARE >= length:
        laid.append(surface.transpose(0, 2, 1))
    return [one[:, ::down, ::back] for one in laid for down in (1, -1) for back in (1, -1)]


def _choose_corner(
    candidates: list[Array], corner_mm: npt.ArrayLike | None, size_mm: tuple[float, float]
) -> tuple[Array, str]:
    """The surface with (0, 0) first, and what decided."""
    turned = np.array([_alignment(candidate, size_mm) for candidate in candidates])
    if corner_mm is None:
        return candidates[int(np.argmax(turned))], "scanner frame"
    hint = np.asarray(corner_mm, dtype=np.float64)
    if hint.shape != (3,):
        raise PointCloudError(f"the corner hint has shape {hint.shape}, expected x, y and z in mm")
    corners = np.array([candidate[:, 0, 0] for candidate in candidates])
    distance = np.linalg.norm(corners - hint, axis=1)
    at_it = np.all(corners == corners[int(np.argmin(distance))], axis=1)  # two candidates where x may go either way
    nearest, second = float(distance.min()), float(distance[~at_it].min())
    if not nearest < 0.5 * second:
        raise PointCloudError(
            f"the corner hint {tuple(float(x) for x in hint)} is {nearest:.1f} and {second:.1f} mm from the two "
            "nearest corners: give a point, in the points' frame, clearly nearest to the corner (0, 0)"
        )
    return candidates[int(np.argmax(np.where(at_it, turned, -np.inf)))], "given"


def _alignment(surface: Array, size_mm: tuple[float, float]) -> float:
    """Trace of the rotation that lays a surface's nodes on the flat sheet: 3 for none, -1 for half a turn."""
    rows, columns = np.meshgrid(*(np.linspace(-0.5, 0.5, n) for n in surface.shape[1:]), indexing="ij")
    flat = np.stack([size_mm[0] * columns, size_mm[1] * rows, np.zeros_like(rows)]).reshape(3, -1)
    left, _, right = np.linalg.svd(flat @ (surface - surface.mean(axis=(1, 2), keepdims=True)).reshape(3, -1).T)
    return float(np.trace(left @ np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))]) @ right))


def _pose(cloud: Array, grid: Grid) -> tuple[Array, Array]:
    """The rigid motion that ``align_cloud`` applies."""
    centred = cloud - cloud.mean(axis=(1, 2), keepdims=True)
    points, aligned = cloud.reshape(3, -1), align_cloud(centred, grid).reshape(3, -1)
    target = flat_cloud(grid).reshape(3, -1).mean(axis=1)
    centre = points.mean(axis=1)
    rotation = (aligned - target[:, None]) @ np.linalg.pinv(points - centre[:, None])
    left, _, right = np.linalg.svd(rotation)  # a flat sheet leaves the pseudo-inverse blind along its normal
    proper = left @ np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))]) @ right
    return np.asarray(proper), np.asarray(target - proper @ centre)
