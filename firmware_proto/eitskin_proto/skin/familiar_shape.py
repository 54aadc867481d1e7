"""How a cloud's shape is unlike all that a skin's networks learned: by its stretch, its bend, or by dents.

The deformations that a skin's file states stretch, roll and twist the sheet. Such a surface has no Gaussian curvature K
but that of its twist, -(twist / length)^2. A dent or bump of height h and width s has (h / s^2)^2. ::

    stretch   the mean spacing along x or along y is beyond the skin's range by more than ``STRETCH_MARGIN``
    bend      rows and columns turn from end to end by ``BEND_MARGIN_DEG`` more than the skin bends
    dent      the largest |K| exceeds ``DENT_PER_MM2``, and ``TWIST_FACTOR`` times that of the skin's twist

K is that of a quadratic surface through each window of ``WINDOW_MM``, which averages a scanner's noise. In units of
1e-4 per mm2 it was at most 1.0 on 80 draws of family A (:mod:`eitskin_sim.scene.family`) with 0.1 mm of noise, and from
9 on where a dent of 10 mm with sigma 12 mm was added; 24 draws of family B, bumps of 6 mm, had 0.1 to 6.3. It takes
1 ms.
"""

from functools import lru_cache
from typing import Final, Literal

import numpy as np
import numpy.typing as npt
from numpy.lib.stride_tricks import sliding_window_view

from eitskin_proto.skin.grid import Grid
from eitskin_proto.skin.sheet_cloud import turned_deg
from eitskin_proto.skin.skin import PAPER, Skin

Array = npt.NDArray[np.float64]

Mode = Literal["stretch", "bend", "dent"]

STRETCH_MARGIN: Final = 0.04
BEND_MARGIN_DEG: Final = 30.0
DENT_PER_MM2: Final = 1.3e-4
TWIST_FACTOR: Final = 5.0
WINDOW_MM: Final = 24.0


def unlike_family(points: Array, skin: Skin = PAPER) -> tuple[Mode, ...]:
    """Return in which ways a surface is beyond a skin's deformations; none on a surface like them.

    Args:
        points: (3, rows, columns) mm, a cloud that was checked (:func:`eitskin_proto.skin.sheet_cloud.check_sheet`).
        skin: Whose sheet.
    """
    family, pitch_mm = skin.deformations, skin.grid.pixel_mm
    steps = np.diff(points, axis=2), np.diff(points, axis=1)
    means = [float(np.linalg.norm(one, axis=0).mean()) / pitch for one, pitch in zip(steps, pitch_mm, strict=True)]
    stretched = any(
        not low - STRETCH_MARGIN <= mean <= high + STRETCH_MARGIN
        for mean, (low, high) in zip(means, (family.stretch_along, family.stretch_across), strict=True)
    )
    low, high = family.angle_deg
    bent = not min(low, 0.0) - BEND_MARGIN_DEG <= turned_deg(points, skin.grid) <= max(high, 0.0) + BEND_MARGIN_DEG
    twist = np.deg2rad(max(map(abs, family.twist_deg))) / skin.grid.size_mm[0]
    dented = largest_curvature(points, skin.grid) > max(DENT_PER_MM2, TWIST_FACTOR * twist**2)
    found: dict[Mode, bool] = {"stretch": stretched, "bend": bent, "dent": dented}
    return tuple(mode for mode, beyond in found.items() if beyond)


def largest_curvature(points: Array, grid: Grid) -> float:
    """Return the largest |K| of a cloud (3, rows, columns) mm, per mm2."""
    sides, fit = _quadratic(grid)
    windows = sliding_window_view(points, sides, axis=(1, 2))
    by_x, by_y, by_xx, by_xy, by_yy = np.einsum("irck,pk->pirc", windows.reshape(*windows.shape[:3], -1), fit)
    normal = np.cross(by_x, by_y, axis=0)
    area = np.einsum("irc,irc->rc", normal, normal)
    xx, xy, yy = (np.einsum("irc,irc->rc", one, normal) for one in (by_xx, by_xy, by_yy))
    return float(np.max(np.abs(xx * yy - xy**2) / np.maximum(area, 1e-12) ** 2))


@lru_cache(maxsize=8)
def _quadratic(grid: Grid) -> tuple[tuple[int, int], Array]:
    """Return a window's (rows, columns), and (5, k) weights of its points in first and second derivatives per mm."""
    dx, dy = grid.pixel_mm
    half = [max(1, round(WINDOW_MM / pitch / 2.0)) for pitch in (dy, dx)]
    y, x = np.meshgrid(*(np.arange(-n, n + 1) * pitch for n, pitch in zip(half, (dy, dx), strict=True)), indexing="ij")
    x, y = x.ravel(), y.ravel()
    terms = np.stack([x, y, x * x / 2.0, x * y, y * y / 2.0, np.ones_like(x)], axis=-1)
    return (2 * half[0] + 1, 2 * half[1] + 1), np.linalg.pinv(terms)[:5]
