"""Metrics of a tactile map: the paper's CC, PSNR, RIE and DE, and more specific ones for touch.

One implementation for every solver, with these conventions:

* The truth is a map in [0, 1], 1 where touched. A network's map is judged as it is. An image of a classical solver has
  no scale of its own, so :func:`scaled` clips it at 0 and scales it to maximum 1 before anything is computed.
* CC is Pearson's coefficient over the pixels. A constant map has none: it is 1 if both maps are the same constant,
  else 0.
* PSNR has the peak 1 (the truth's), and stops at ``PSNR_CAP_DB``: a perfect map has no finite one.
* RIE is the Euclidean norm of the error over that of the truth; with an untouched truth it is 0 for an empty map, else
  infinite. Reports leave CC and RIE of an untouched sheet out.
* A *touch* is a connected region (edges, not corners, connect) of at least half the full value. Its place is the
  centroid of the map over the region and the pixels right around it: of a pixel that a border cuts, the covered share
  then counts, whichever side of one half it lies on, and an exact area map has exact places. A truth none of whose
  pixels reaches one half, of touches smaller than a pixel, has its touches where it reaches half of its highest pixel;
  what a map has to reach to show them stays one half. The localisation error
  averages the distance from each true touch to the nearest found one with that from each found touch to the nearest
  true one, so that misses and ghosts both cost.
* ``exact`` is 1 when a unit map decodes to exactly the true set of units (mean of each unit's pixels at least half),
  or, for an area map, when every true touch and every found one pair off within a pixel.
* The two-point distance D is between the *borders* of the two closest touches (paper Fig. 9), a border being where the
  map, linear between pixel centres, crosses one half. DE = |D - D_r| / D_r (paper eq. 8) with D_r measured in the same
  way on the truth. A map that shows fewer than two touches has D = 0, so DE = 1: the two have merged.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy import ndimage
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from eitskin_proto.skin.grid import Grid
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.arrays import Array

TOUCHED: Final = 0.5
"""A pixel or unit at or above this is touched."""

MAX_MATCH_DISTANCE_MM: Final = 15.0
"""A touch is missed if none is found this near to it."""

PSNR_CAP_DB: Final = 120.0
"""The PSNR of a perfect map: a mean square error of 1e-12."""


@dataclass(frozen=True, slots=True)
class Score:
    """The scores of one map."""

    cc: float
    """Correlation coefficient."""
    psnr_db: float
    """Peak signal-to-noise ratio, peak 1."""
    rie: float
    """Relative image error."""
    localisation_mm: float
    """Distance between true and found touches, both ways."""
    exact: float
    """1.0 if the set of touches is exactly right, else 0.0."""
    touches: int
    """Number of touches found."""
    true_touches: int
    """Number of touches in the truth."""
    two_point_mm: float
    """Distance between the borders of the two closest touches; NaN below two touches."""
    distance_error: float
    """The paper's DE; NaN where the truth has fewer than two touches."""


def lost_mm(grid: Grid) -> float:
    """Return the localisation error when one map has touches and the other has none: the sheet's diagonal."""
    return math.hypot(*grid.size_mm)


def scaled(image: npt.NDArray[np.floating]) -> Array:
    """Return a classical image clipped at 0 and scaled to maximum 1; zeros if nothing is positive.

    Args:
        image: (rows, columns) or (n,) values of one map, of any scale.
    """
    clipped = np.maximum(np.asarray(image, dtype=np.float64), 0.0)
    largest = float(clipped.max(initial=0.0))
    return np.asarray(clipped / largest if largest > 0.0 else clipped)


def correlation(image: npt.NDArray[np.floating], truth: npt.NDArray[np.floating]) -> float:
    """Return Pearson's correlation coefficient of two maps, with the module's rule for constant ones."""
    x, y = _pair(image, truth)
    x_centred, y_centred = x - x.mean(), y - y.mean()
    norms = _norm(x_centred), _norm(y_centred)
    # A constant map leaves rounding of its own size behind when its mean is taken away: below it there is no contrast.
    flat = [norm <= 1e-12 * max(_norm(full), 1e-300) for norm, full in zip(norms, (x, y), strict=True)]
    if any(flat):
        return 1.0 if all(flat) and math.isclose(x.mean(), y.mean(), rel_tol=1e-9, abs_tol=1e-12) else 0.0
    return float(np.clip(np.vdot(x_centred / norms[0], y_centred / norms[1]), -1.0, 1.0))


def psnr_db(image: npt.NDArray[np.floating], truth: npt.NDArray[np.floating]) -> float:
    """Return the peak signal-to-noise ratio in dB, for a peak of 1."""
    x, y = _pair(image, truth)
    mean_square = float(np.mean((x - y) ** 2))
    return PSNR_CAP_DB if mean_square <= 10 ** (-PSNR_CAP_DB / 10) else -10.0 * math.log10(mean_square)


def relative_image_error(image: npt.NDArray[np.floating], truth: npt.NDArray[np.floating]) -> float:
    """Return the norm of the error over the norm of the truth."""
    x, y = _pair(image, truth)
    error, size = _norm(x - y), _norm(y)
    if size == 0.0:
        return 0.0 if error == 0.0 else math.inf
    return error / size


def touched_units(image: npt.NDArray[np.floating], grid: Grid = PAPER.grid) -> npt.NDArray[np.bool_]:
    """Return (units,) which units a map (rows, columns) shows as touched; one that holds no pixel's centre is not."""
    unit, values = grid.unit_of_pixel.ravel(), np.asarray(image, dtype=np.float64).ravel()
    sums = np.bincount(unit, weights=values, minlength=grid.n_units)
    pixels = np.bincount(unit, minlength=grid.n_units)
    return np.asarray((pixels > 0) & (sums / np.maximum(pixels, 1) >= TOUCHED))


def truth_level(truth: npt.NDArray[np.floating]) -> float:
    """Return the level at which a pixel of a truth belongs to a touch: one half, or half of a lower maximum."""
    highest = float(np.max(truth, initial=0.0))
    return highest / 2 if 0.0 < highest < TOUCHED else TOUCHED


def touch_centres_mm(image: npt.NDArray[np.floating], grid: Grid = PAPER.grid, level: float = TOUCHED) -> Array:
    """Return (touches, 2) x and y of every touch of a map (rows, columns): of what reaches a level."""
    values = np.asarray(image, dtype=np.float64)
    labels, count = _touches(values, level)
    if count == 0:
        return np.zeros((0, 2))
    labels, values = _with_rim(labels), np.maximum(values, 0.0)
    weight = np.bincount(labels.ravel(), weights=values.ravel(), minlength=count + 1)[1:]
    moments = [
        np.bincount(labels.ravel(), weights=(values * axis).ravel(), minlength=count + 1)[1:]
        for axis in np.moveaxis(grid.pixel_centres_mm(), -1, 0)
    ]
    return np.asarray(np.stack(moments, axis=-1) / weight[:, None])


def count_touches(image: npt.NDArray[np.floating], level: float = TOUCHED) -> int:
    """Return the number of touches in a map (rows, columns)."""
    return _touches(np.asarray(image, dtype=np.float64), level)[1]


def localisation_error_mm(
    image: npt.NDArray[np.floating], truth: npt.NDArray[np.floating], grid: Grid = PAPER.grid
) -> float:
    """Return how far found touches lie from true ones, averaged both ways; 0 if both maps are empty."""
    found, true = touch_centres_mm(image, grid), touch_centres_mm(truth, grid, truth_level(truth))
    if len(found) == 0 and len(true) == 0:
        return 0.0
    if len(found) == 0 or len(true) == 0:
        return lost_mm(grid)
    distance = cdist(true, found)
    return float(0.5 * (distance.min(axis=1).mean() + distance.min(axis=0).mean()))


def distances_mm(image: Array, truth: Array, grid: Grid = PAPER.grid) -> Array:
    """Return (true touches,) mm from each to the nearest that a map shows; infinite where it shows none."""
    true, found = touch_centres_mm(truth, grid, truth_level(truth)), touch_centres_mm(image, grid)
    return np.asarray(cdist(true, found).min(axis=1) if len(found) else np.full(len(true), np.inf))


def missed_and_rms(distance_mm: Array) -> tuple[float | None, float | None]:
    """Return the share of touches that are missed, and the root mean square distance of the others; None for none."""
    near = distance_mm[distance_mm <= MAX_MATCH_DISTANCE_MM]
    missed = float(np.mean(distance_mm > MAX_MATCH_DISTANCE_MM)) if distance_mm.size else None
    return missed, float(np.sqrt(np.mean(near**2))) if near.size else None


def is_exact(
    image: npt.NDArray[np.floating],
    truth: npt.NDArray[np.floating],
    *,
    labels: str = "units",
    grid: Grid = PAPER.grid,
) -> bool:
    """Return whether the set of touches is exactly right.

    Args:
        image: (rows, columns) map.
        truth: (rows, columns) map in [0, 1].
        labels: ``"units"`` compares sets of units; ``"area"`` pairs touches within one pixel.
        grid: The maps'.

    Raises:
        ValueError: ``labels`` is neither.
    """
    if labels == "units":
        return bool(np.array_equal(touched_units(image, grid), touched_units(truth, grid)))
    if labels != "area":
        raise ValueError(f"labels are 'units' or 'area', found {labels!r}")
    found, true = touch_centres_mm(image, grid), touch_centres_mm(truth, grid, truth_level(truth))
    if len(found) != len(true):
        return False
    distance = cdist(true, found)
    return bool(np.all(distance[linear_sum_assignment(distance)] <= grid.pitch_mm))


def two_point_distance_mm(image: npt.NDArray[np.floating], grid: Grid = PAPER.grid, level: float = TOUCHED) -> float:
    """Return the distance between the borders of the two closest touches of a map (rows, columns); NaN below two."""
    values = np.asarray(image, dtype=np.float64)
    labels, count = _touches(values, level)
    borders = [_border_mm(values, labels == touch + 1, grid, level) for touch in range(count)]
    gaps = [float(cdist(a, b).min()) for index, a in enumerate(borders) for b in borders[:index]]
    return min(gaps, default=math.nan)


def score(
    image: npt.NDArray[np.floating],
    truth: npt.NDArray[np.floating],
    *,
    labels: str = "units",
    grid: Grid = PAPER.grid,
) -> Score:
    """Return every measure of one map against its truth.

    Args:
        image: (rows, columns) map; a classical one goes through :func:`scaled` first.
        truth: (rows, columns) map in [0, 1].
        labels: What the truth's pixels mean, ``"units"`` or ``"area"``.
        grid: The maps'.

    Raises:
        ValueError: A map has another shape or is not finite.
    """
    for name, candidate in (("map", image), ("truth", truth)):
        if np.shape(candidate) != grid.shape:
            raise ValueError(f"{name} has shape {np.shape(candidate)}, expected {grid.shape}")
    level = truth_level(truth)
    found_mm, true_mm = two_point_distance_mm(image, grid), two_point_distance_mm(truth, grid, level)
    return Score(
        cc=correlation(image, truth),
        psnr_db=psnr_db(image, truth),
        rie=relative_image_error(image, truth),
        localisation_mm=localisation_error_mm(image, truth, grid),
        exact=float(is_exact(image, truth, labels=labels, grid=grid)),
        touches=count_touches(image),
        true_touches=count_touches(truth, level),
        two_point_mm=found_mm,
        distance_error=math.nan if math.isnan(true_mm) else _relative(found_mm, true_mm),
    )


def _relative(found_mm: float, true_mm: float) -> float:
    if not true_mm > 0.0:
        raise ValueError(f"true distance {true_mm} mm between two touches must be above 0 mm")
    return 1.0 if math.isnan(found_mm) else abs(found_mm - true_mm) / true_mm


def _pair(image: npt.NDArray[np.floating], truth: npt.NDArray[np.floating]) -> tuple[Array, Array]:
    x, y = np.asarray(image, dtype=np.float64).ravel(), np.asarray(truth, dtype=np.float64).ravel()
    if x.shape != y.shape or x.size == 0:
        raise ValueError(
            f"map and truth must have the same, non-empty shape: found {np.shape(image)}, {np.shape(truth)}"
        )
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise ValueError("map and truth must be finite: found NaN or infinity")
    return x, y


def _norm(values: Array) -> float:
    largest = float(np.abs(values).max(initial=0.0))
    return largest * float(np.linalg.norm(values / largest)) if largest > 0.0 else 0.0


def _touches(image: Array, level: float) -> tuple[npt.NDArray[np.intp], int]:
    labels, count = ndimage.label(np.asarray(image) >= level)
    return np.asarray(labels, dtype=np.intp), int(count)


def _with_rim(labels: npt.NDArray[np.intp]) -> npt.NDArray[np.intp]:
    """Every touch with the pixels that its own surround; one between two touches goes to the nearer."""
    distance, nearest = ndimage.distance_transform_edt(labels == 0, return_indices=True)
    return np.asarray(np.where(distance < 1.5, labels[tuple(nearest)], 0), dtype=np.intp)


def _border_mm(image: Array, inside: npt.NDArray[np.bool_], grid: Grid, level: float) -> Array:
    """Points where the map crosses a level on the way out of a touch; on the sheet's border, the border itself."""
    centres, (height, width) = grid.pixel_centres_mm(), grid.shape
    points: list[Array] = []
    for step_row, step_column in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        rows, columns = np.nonzero(inside)
        to_rows, to_columns = rows + step_row, columns + step_column
        on_sheet = (to_rows >= 0) & (to_rows < height) & (to_columns >= 0) & (to_columns < width)
        step_mm = np.array(grid.pixel_mm) * (step_column, step_row)
        points.append(centres[rows[~on_sheet], columns[~on_sheet]] + 0.5 * step_mm)
        rows, columns, to_rows, to_columns = (a[on_sheet] for a in (rows, columns, to_rows, to_columns))
        leaving = image[to_rows, to_columns] < level
        rows, columns, to_rows, to_columns = (a[leaving] for a in (rows, columns, to_rows, to_columns))
        here, there = image[rows, columns], image[to_rows, to_columns]
        points.append(centres[rows, columns] + ((here - level) / (here - there))[:, None] * step_mm)
    return np.concatenate(points)
