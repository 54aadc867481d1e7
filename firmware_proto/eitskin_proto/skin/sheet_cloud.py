"""Checks whether a cloud can be of this sheet: its size, spacing, angles and noise against the sheet's limits.

A cloud of another size, order or scale has the right shape and no NaN, and silently makes every map wrong. The limits
of a sheet were measured on 810 clouds with a scanner's noise of 0.1 mm: the paper's ten bends, and 400 draws each of
the families A and B (:mod:`eitskin_sim.scene.family`). Lengths are in multiples of the flat sheet's::

                                                  drawn              refused outside     warned of outside
    mean along x, along y                         0.96-1.25, 0.91-1.16  0.80-1.60, 0.75-1.40
    the step from one row or column to the next   0.90-1.26             0.50-1.70
    |cosine| between row and column               at most 0.41          0.75
    noise, by fourth differences                  0.095-0.105 mm        0.5 mm           0.25 mm
    one point off its neighbours                  at most 0.77 mm       2.5 mm           1 mm
    the same, in multiples of the noise           at most 7.7           and 12           and 9
    turn of rows and columns, towards the front   at least -15 deg                       -40 deg

That is the paper's skin. If another skin's description bends or stretches it further, its bounds are wider by the same
factor. If its pixels are larger than ``COARSE_MM``, neighbours may be further from a smooth curve by that factor.

A rectangle looks the same from either side, so a flat cloud with x and y exchanged, or with its rows in reverse, *is*
the flat sheet in another pose, and is used as it should be. A bent one is a sheet that bends to the other side: a real
sheet may, but no network was trained on it, so it causes a warning. A cloud with both orders reversed is a sheet turned
by half a turn, which the cloud alone cannot show. The check takes 0.6 ms.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.skin.cloud import check_cloud
from eitskin_proto.skin.grid import Grid
from eitskin_proto.skin.skin import PAPER, Skin

Array = npt.NDArray[np.float64]
Range = tuple[float, float]

MEAN_ALONG_X: Final = (0.80, 1.60)
MEAN_ALONG_Y: Final = (0.75, 1.40)
"""Mean spacing along x and along y, in multiples of the flat sheet's."""

SPACING: Final = (0.50, 1.70)
"""Mean step from a row or column to the next."""

LARGEST_COSINE: Final = 0.75
"""Between the directions of a row and a column where they meet; 0 on the flat sheet."""

LARGEST_NOISE_MM: Final = 0.5
NOTED_NOISE_MM: Final = 0.25
"""Standard deviation of a coordinate; the networks learned with 0.1 mm."""

LARGEST_OFF: Final = (2.5, 12.0)
NOTED_OFF: Final = (1.0, 9.0)
"""Distance of a point from the curve through its neighbours: in mm, and in multiples of the noise; both must be
exceeded."""

LEAST_TURN_DEG: Final = -40.0
"""How far rows and columns together turn towards the sheet's front, end to end; a network learned -15 to 205."""

COARSE_MM: Final = 10.0
"""Pixels up to here show a bend's curve; the look at noise and single points is for these."""

_FOURTH: Final = float(np.sqrt(70.0))
"""Fourth differences 1 -4 6 -4 1 multiply the noise by this, and contain almost nothing of a sheet's shape."""


@dataclass(frozen=True, slots=True)
class _Bounds:
    """The limits of a skin's clouds."""

    grid: Grid
    mean_x: Range
    mean_y: Range
    spacing: Range
    coarse: float
    turn_deg: float


@lru_cache(maxsize=8)
def _bounds(skin: Skin) -> _Bounds:
    own, paper = skin.deformations, PAPER.deformations
    low_x, high_x = _beyond(own.stretch_along, paper.stretch_along)
    low_y, high_y = _beyond(own.stretch_across, paper.stretch_across)
    low, high = min(low_x, low_y), max(high_x, high_y)
    return _Bounds(
        skin.grid,
        (MEAN_ALONG_X[0] * low_x, MEAN_ALONG_X[1] * high_x),
        (MEAN_ALONG_Y[0] * low_y, MEAN_ALONG_Y[1] * high_y),
        (SPACING[0] * low, SPACING[1] * high),
        max(1.0, max(skin.grid.pixel_mm) / COARSE_MM),
        LEAST_TURN_DEG + min(0.0, own.angle_deg[0]),
    )


def _beyond(own: Range, paper: Range) -> Range:
    return min(1.0, own[0] / paper[0]), max(1.0, own[1] / paper[1])


def check_sheet(cloud: npt.ArrayLike, skin: Skin = PAPER) -> tuple[Array, tuple[str, ...]]:
    """Return a cloud as float64, and warnings about it.

    Args:
        cloud: (3, rows, columns) mm, in any pose.
        skin: The skin of the surface.

    Raises:
        ValueError: The cloud is malformed (:func:`eitskin_proto.skin.cloud.check_cloud`) or does not fit this sheet;
            with what was found, what was expected and what to do.
    """
    bounds = _bounds(skin)
    points = check_cloud(cloud, bounds.grid)
    along_x, along_y = np.diff(points, axis=2), np.diff(points, axis=1)
    dx, dy = bounds.grid.pixel_mm
    of_x, of_y = _length(along_x, dx), _length(along_y, dy)
    _check_size(of_x, of_y, bounds)
    _check_order(of_x, of_y, bounds)
    noise_mm, off_mm = _noise(along_x, along_y)
    coarse = bounds.coarse
    if noise_mm > LARGEST_NOISE_MM * coarse:
        raise ValueError(
            f"the cloud's points are {noise_mm:.2g} mm (rms) off a smooth surface, expected at most "
            f"{LARGEST_NOISE_MM * coarse:g} mm: smooth it, or make it with 'eitskin surface'"
        )
    alone = (
        f"a point of the cloud is {off_mm:.2g} mm off its neighbours, expected at most {NOTED_OFF[0] * coarse:g} "
        "mm: leave such points out, or make the cloud with 'eitskin surface'"
    )
    if off_mm > max(LARGEST_OFF[0] * coarse, LARGEST_OFF[1] * noise_mm):
        raise ValueError(alone)
    _check_angles(*_across(along_x, along_y))
    doubts = []
    if noise_mm > NOTED_NOISE_MM * coarse:
        doubts.append(
            f"the cloud's points are {noise_mm:.2g} mm (rms) off a smooth surface, more than the "
            f"{NOTED_NOISE_MM * coarse:g} mm up to which maps are as accurate as stated: smooth it, or make it with "
            "'eitskin surface'"
        )
    if off_mm > max(NOTED_OFF[0] * coarse, NOTED_OFF[1] * noise_mm):
        doubts.append(alone)
    turn_deg = turned_deg(points, bounds.grid)
    if turn_deg < bounds.turn_deg:
        doubts.append(
            f"the cloud bends to the sheet's back by {-turn_deg:.0f} degrees, where networks learned bends to its "
            "front: if the sheet does not, the order of its rows or columns is reversed, or x and y are exchanged"
        )
    return points, tuple(doubts)


def _length(steps: Array, pitch_mm: float) -> Array:
    """Size of vectors along the first axis, in steps of the flat sheet."""
    return np.asarray(np.sqrt(np.einsum("irc,irc->rc", steps, steps)) / pitch_mm)


def _check_size(along_x: Array, along_y: Array, bounds: _Bounds) -> None:
    long, wide = float(along_x.mean()), float(along_y.mean())
    (low_x, high_x), (low_y, high_y) = bounds.mean_x, bounds.mean_y
    if low_x <= long <= high_x and low_y <= wide <= high_y:
        return
    length_mm, width_mm = bounds.grid.size_mm
    n_rows, n_columns = bounds.grid.shape
    remedy = (
        f"x runs along the {n_columns} columns, y along the {n_rows} rows; are they exchanged?"
        if long < low_x and wide > high_y
        else "give the whole conductive layer and nothing else, in mm"
    )
    raise ValueError(
        f"the cloud's sheet is {long * length_mm:.3g} mm along x and {wide * width_mm:.3g} mm along y, expected "
        f"{low_x * length_mm:.4g} to {high_x * length_mm:.4g} and "
        f"{low_y * width_mm:.4g} to {high_y * width_mm:.4g} mm: {remedy}"
    )


def _check_order(along_x: Array, along_y: Array, bounds: _Bounds) -> None:
    """Look at the mean step from each column or row to the next: one that is out of order or twice there shows."""
    dx, dy = bounds.grid.pixel_mm
    low, high = bounds.spacing
    for steps, pitch_mm, kind in ((along_x.mean(axis=0), dx, "column"), (along_y.mean(axis=1), dy, "row")):
        odd = np.flatnonzero((steps < low) | (steps > high))
        if odd.size:
            at = int(odd[0])
            raise ValueError(
                f"the cloud's {kind}s {at} and {at + 1} are {steps[at] * pitch_mm:.3g} mm apart, expected "
                f"{low * pitch_mm:.3g} to {high * pitch_mm:.3g} mm: is a {kind} missing, doubled or out of order?"
            )


def _noise(along_x: Array, along_y: Array) -> tuple[float, float]:
    """Standard deviation of a coordinate in mm, and the farthest that a point is off the curve of its neighbours."""
    fourths = np.diff(along_x, n=3, axis=2), np.diff(along_y, n=3, axis=1)
    squares = [np.einsum("irc,irc->rc", fourth, fourth) for fourth in fourths]
    noise = np.sqrt(sum(float(square.mean()) for square in squares) / 6.0) / _FOURTH
    return float(noise), float(np.sqrt(max(float(square.max()) for square in squares))) / 6.0


def _check_angles(across_x: Array, across_y: Array) -> None:
    product = np.einsum("irc,irc->rc", across_x, across_y)
    sizes = np.einsum("irc,irc->rc", across_x, across_x) * np.einsum("irc,irc->rc", across_y, across_y)
    cosine = np.abs(product) / np.sqrt(sizes + 1e-12)
    worst = float(cosine.max())
    if worst > LARGEST_COSINE:
        row, column = np.unravel_index(int(np.argmax(cosine)), cosine.shape)
        found, least = np.degrees(np.arccos([min(worst, 1.0), LARGEST_COSINE]))
        raise ValueError(
            f"the cloud's rows and columns meet at {found:.0f} degrees near row {row}, column {column}, expected at "
            f"least {least:.0f}: rows run along y and columns along x; are they in order?"
        )


def _across(along_x: Array, along_y: Array) -> tuple[Array, Array]:
    """Twice the mean step along x, and along y, of the sides of each square between four points."""
    return along_x[:, :-1] + along_x[:, 1:], along_y[:, :, :-1] + along_y[:, :, 1:]


def turned_deg(points: Array, grid: Grid) -> float:
    """Return the sum of the mean turns of rows and columns from end to end, positive towards the front of the sheet.

    Args:
        points: (3, rows, columns) mm.
        grid: Of them.
    """
    along_x, along_y = np.diff(points, axis=2), np.diff(points, axis=1)
    across_x, across_y = _across(along_x, along_y)
    front = np.stack(
        [
            across_x[1] * across_y[2] - across_x[2] * across_y[1],
            across_x[2] * across_y[0] - across_x[0] * across_y[2],
            across_x[0] * across_y[1] - across_x[1] * across_y[0],
        ]
    )
    front /= np.sqrt(np.einsum("irc,irc->rc", front, front)) + 1e-12
    of_rows = np.einsum("irc,irc->rc", np.diff(along_x, axis=2)[:, :-1], front[:, :, 1:]).sum(axis=1).mean()
    of_columns = np.einsum("irc,irc->rc", np.diff(along_y, axis=1)[:, :, :-1], front[:, 1:]).sum(axis=0).mean()
    dx, dy = grid.pixel_mm
    return float(np.degrees(of_rows / dx + of_columns / dy))
