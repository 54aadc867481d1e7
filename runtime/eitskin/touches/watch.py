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

Place = tuple[float, float, float, float]
"""x, y in mm and their velocities."""

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

    __slots__ = ("_finder", "_found", "_map", "_places", "_rows", "_sign", "_surface", "tracker")

    def __init__(self, grid: Grid, finder: Finder | None = None, kind: TouchKind = "both") -> None:
        self._sign = SIGNS[kind]
        self._finder: Finder = TouchFinder(grid) if finder is None else finder
        self.tracker = Tracker(grid)
        self._found: Found = self._finder.nothing
        self._rows: list[bytes] = []
        self._places: list[Place] = []
        self._map: object = None
        self._surface: Surface | None = None

    def reset(self) -> None:
        """Restart after a time without requests."""
        self.tracker.reset()
        self._found, self._map = self._finder.nothing, None

    def update(
        self, values: npt.NDArray[np.floating] | None, which: object, surface: Surface, device_us: int, fused: int = 1
    ) -> Packed:
        """Return the touches of a frame.

        Args:
            values: (pixels,) its map; None if it has none.
            which: Tells its map from others; while it stays the same, the map is not looked at again.
            surface: In use.
            device_us: When it was scanned.
            fused: Frames that the map is computed of.
        """
        fresh = False
        if values is None:
            self._found, self._map = self._finder.nothing, None
            if self.tracker.idle:
                return b"", b"", 0
        elif which != self._map or surface is not self._surface:
            fresh, self._map, self._surface = True, which, surface
            self._found = self._finder.find(values)
        found = self._found
        tracks, events = self.tracker.step(found, device_us, fused)
        places = [
            (row[0], row[1], 0.0, 0.0) if track is None else (track.x_mm, track.y_mm, *track.velocity_mm_s)
            for row, track in zip(found.rows, tracks, strict=True)
        ]
        if fresh or places != self._places:
            self._places, self._rows = places, _rows(found, places, surface, self._sign)
        rows, pack = self._rows, HEAD.pack
        known = sorted([(track.id, index, track) for index, track in enumerate(tracks) if track is not None])
        parts = []
        for number, index, track in known:
            parts.append(pack(number, track.parent, 1e-6 * max(device_us - track.born_us, 0)))
            parts.append(rows[index])
        return b"".join(parts), b"".join([EVENT_LAYOUT.pack(*event) for event in events]), self._found.more


def _rows(found: Found, places: list[Place], surface: Surface, sign: float) -> list[bytes]:
    """Return what ``LAYOUT`` has of each touch after id, parent and age, by its tracked place and velocity."""
    if not found.rows:
        return []
    areas_mm2 = found.areas_mm2(surface.stretch)
    doubts = found.doubts or [(UNKNOWN,) * 4] * len(found.rows)
    poses = surface.at([place[0] for place in places], [place[1] for place in places])
    rows = [
        (*place[:2], *row[2:], UNKNOWN, UNKNOWN, *pose, area_mm2, *doubt, sign, *place[2:])
        for row, place, pose, area_mm2, doubt in zip(found.rows, places, poses, areas_mm2, doubts, strict=True)
    ]
    raw, width = np.array(rows, dtype="<f4").tobytes(), LAYOUT.size - HEAD.size
    return [raw[at : at + width] for at in range(0, len(raw), width)]
