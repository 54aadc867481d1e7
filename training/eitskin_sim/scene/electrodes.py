"""The places of the sixteen electrodes on the flat sheet: pieces of the border, and the patches behind them.

A centre is an arc length, counter-clockwise from the corner (0, 0)::

              <- side 2
          +---------------+
    side 3|               | side 1      side 0: y = 0, x rises      side 2: y = width, x falls
     down |               |  up         side 1: x = length, y rises side 3: x = 0, y falls
          +---------------+
              side 0 ->

An "edge" electrode may go round a corner; it then has two pieces. A "patch" is a square with one side on the border, so
its centre keeps at least half its size from every corner.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from eitskin_sim.scene.parts import Electrodes, SceneError, Sheet

ROUNDING_MM = 1e-9
"""Electrodes that touch at a point are apart; this much overlap is rounding."""


@dataclass(frozen=True, slots=True)
class Piece:
    """A straight piece of the border under one electrode."""

    electrode: int
    side: int
    start_mm: float
    """Lower end: x on sides 0 and 2, y on sides 1 and 3."""
    stop_mm: float

    def patch_mm(self, sheet: Sheet, depth_mm: float) -> tuple[float, float, float, float]:
        """Return the rectangle (x0, y0, x1, y1) of given depth behind the piece."""
        length, width = sheet.size_mm
        a, b = self.start_mm, self.stop_mm
        return (
            (a, 0.0, b, depth_mm),
            (length - depth_mm, a, length, b),
            (a, width - depth_mm, b, width),
            (0.0, a, depth_mm, b),
        )[self.side]


def place(sheet: Sheet, electrodes: Electrodes) -> tuple[Piece, ...]:
    """Return the pieces of the border under the electrodes.

    Raises:
        SceneError: Electrodes are out of order, overlap, or reach where their contact cannot.
    """
    length, width = sheet.size_mm
    perimeter = 2.0 * (length + width)
    centres, sizes = np.array(electrodes.arc_length_mm), electrodes.sizes_mm()
    where = "scene.electrodes"
    for k, centre in enumerate(centres):
        if not 0.0 <= centre < perimeter:
            raise SceneError(f"{where}.arc_length_mm[{k}] is {centre:g}; it must be at least 0 and below {perimeter:g}")
    if sizes.max() > min(length, width) / 2:
        key = f"size_mm[{sizes.argmax()}]" if isinstance(electrodes.size_mm, tuple) else "size_mm"
        raise SceneError(f"{where}.{key} is {sizes.max():g}; it must be at most {min(length, width) / 2:g}")
    gaps = np.roll(centres, -1) - centres
    if np.count_nonzero(gaps <= 0.0) != 1:
        k = int(np.flatnonzero(gaps[:-1] <= 0.0)[0])
        raise SceneError(
            f"{where}.arc_length_mm[{k + 1}] is {centres[k + 1]:g} after {centres[k]:g}; electrodes must go "
            "counter-clockwise, once round"
        )
    for k, (gap, least) in enumerate(zip(gaps % perimeter, (sizes + np.roll(sizes, -1)) / 2, strict=True)):
        if gap < least - ROUNDING_MM:
            raise SceneError(
                f"electrodes {k} and {(k + 1) % 16} overlap: their centres are {gap:g} mm apart; "
                f"they must be at least {least:g} mm (size_mm) apart"
            )
    pieces = [
        piece
        for k, (centre, size) in enumerate(zip(centres, sizes, strict=True))
        for piece in _pieces(k, centre, size, sheet)
    ]
    if electrodes.contact == "patch":
        _check_patches(pieces, sheet, electrodes)
    return tuple(pieces)


def _pieces(electrode: int, centre: float, size: float, sheet: Sheet) -> list[Piece]:
    length, width = sheet.size_mm
    corners = np.array([0.0, length, length + width, 2 * length + width, 2 * (length + width)])
    found = []
    for turn in (-corners[-1], 0.0, corners[-1]):
        for side in range(4):
            a = max(centre - size / 2 + turn, corners[side]) - corners[side]
            b = min(centre + size / 2 + turn, corners[side + 1]) - corners[side]
            if b - a <= ROUNDING_MM:
                continue
            extent = corners[side + 1] - corners[side]
            start, stop = (a, b) if side < 2 else (extent - b, extent - a)
            found.append(Piece(electrode, side, float(start), float(stop)))
    return found


def _check_patches(pieces: list[Piece], sheet: Sheet, electrodes: Electrodes) -> None:
    sizes = electrodes.sizes_mm()
    for a, b in pairwise(pieces):
        if a.electrode == b.electrode:
            raise SceneError(
                f"electrode {a.electrode} is a patch round a corner: its centre is at arc length "
                f"{electrodes.arc_length_mm[a.electrode]:g} mm; a patch's centre must be at least "
                f"{sizes[a.electrode] / 2:g} mm from "
                "every corner (contact 'edge' may go round one)"
            )
    boxes = [piece.patch_mm(sheet, float(sizes[piece.electrode])) for piece in pieces]
    for i, a_box in enumerate(boxes):
        for j in range(i):
            b_box = boxes[j]
            overlap_x = min(a_box[2], b_box[2]) - max(a_box[0], b_box[0])
            overlap_y = min(a_box[3], b_box[3]) - max(a_box[1], b_box[1])
            if overlap_x > ROUNDING_MM and overlap_y > ROUNDING_MM:
                raise SceneError(
                    f"electrodes {pieces[j].electrode} and {pieces[i].electrode} overlap in a corner by "
                    f"{overlap_x:g} x {overlap_y:g} mm; their patches must be apart"
                )
