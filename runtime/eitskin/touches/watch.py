"""The touches of one frame after another, as bytes for a message; made only on request."""

from typing import Final, Protocol

import numpy as np
import numpy.typing as npt

from eitskin.touches.moments import Found, TouchFinder
from eitskin.touches.surface import Surface
from eitskin.touches.touch import EVENT_LAYOUT, HEAD, LAYOUT
from eitskin.touches.tracking import Tracker
from eitskin_proto.skin.grid import Grid
from eitskin_proto.skin.touch_kind import TouchKind

UNKNOWN: Final = float("nan")
"""Strength and confidence: nothing that runs tells the one, and nothing calibrates the other."""

SIGNS: Final[dict[TouchKind, float]] = {"raise": 1.0, "lower": -1.0, "both": UNKNOWN}
"""Of touches by the kind that a network knows: a map of both kinds does not tell them apart."""

Packed = tuple[bytes, bytes, int]
"""Touches, events, and how many touches are not listed."""


class Finder(Protocol):
    """Finds the touches of one map after another."""

    nothing: Found
    """No touches."""

    def find(self, values: npt.NDArray[np.floating]) -> Found:
        """Return the touches of a map."""


class TouchWatch:
    """Finds and numbers the touches of one frame after another.

    Args:
        grid: Of the skin.
        finder: Finds them; None finds pieces of the map.
        kind: Which way the touches on the maps change conductance.
    """

    __slots__ = ("_finder", "_found", "_map", "_rows", "_sign", "_surface", "tracker")

    def __init__(self, grid: Grid, finder: Finder | None = None, kind: TouchKind = "both") -> None:
        self._sign = SIGNS[kind]
        self._finder: Finder = TouchFinder(grid) if finder is None else finder
        self.tracker = Tracker(grid)
        self._found: Found = self._finder.nothing
        self._rows: list[bytes] = []
        self._map: object = None
        self._surface: Surface | None = None

    def reset(self) -> None:
        """Restart after a time without requests."""
        self.tracker.reset()
        self._found, self._map = self._finder.nothing, None

    def update(
        self, values: npt.NDArray[np.floating] | None, which: object, surface: Surface, device_us: int
    ) -> Packed:
        """Return the touches of a frame.

        Args:
            values: (pixels,) its map; None if it has none.
            which: Tells its map from others; while it stays the same, the map is not looked at again.
            surface: In use.
            device_us: When it was scanned.
        """
        if values is None:
            self._found, self._map = self._finder.nothing, None
            if self.tracker.idle:
                return b"", b"", 0
        elif which != self._map or surface is not self._surface:
            self._map, self._surface = which, surface
            self._found = self._finder.find(values)
            self._rows = _rows(self._found, surface, self._sign)
        tracks, events = self.tracker.step(self._found, device_us)
        rows, pack = self._rows, HEAD.pack
        known = sorted([(track.id, index, track) for index, track in enumerate(tracks) if track is not None])
        parts = []
        for number, index, track in known:
            parts.append(pack(number, track.parent, 1e-6 * max(device_us - track.born_us, 0)))
            parts.append(rows[index])
        return b"".join(parts), b"".join([EVENT_LAYOUT.pack(*event) for event in events]), self._found.more


def _rows(found: Found, surface: Surface, sign: float) -> list[bytes]:
    """Return what ``LAYOUT`` has of each touch behind id, parent and age."""
    if not found.rows:
        return []
    xs, ys = [row[0] for row in found.rows], [row[1] for row in found.rows]
    areas_mm2 = found.areas_mm2(surface.stretch)
    doubts = found.doubts or [(UNKNOWN,) * 4] * len(found.rows)
    rows = [
        (*row, UNKNOWN, UNKNOWN, *place, area_mm2, *doubt, sign)
        for row, place, area_mm2, doubt in zip(found.rows, surface.at(xs, ys), areas_mm2, doubts, strict=True)
    ]
    raw, width = np.array(rows, dtype="<f4").tobytes(), LAYOUT.size - HEAD.size
    return [raw[at : at + width] for at in range(0, len(raw), width)]
