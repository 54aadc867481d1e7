"""Follows touches from frame to frame: each keeps its number while it moves.

A touch is expected where its velocity takes it. It continues as the nearest touch of the next frame, if that is within
``GATE_MM`` or covers the same place; the nearest pairs are matched first. While a touch rests, its place is that of the
frames' mean. Otherwise a Kalman filter weighs what is expected against what the frame shows; its velocity changes as a
random walk::

    place += velocity dt        velocity += noise of variance WALK dt        shown = place + noise

Touches without a match begin or end::

    born      no touch was here before, and it rises to ``BIRTH`` at least
    split     it is where another touch was, its parent, which continues elsewhere
    merged    another touch is now where this one was; its number is never seen again
    died      not seen for ``HOLD_FRAMES`` frames; until then it is not listed, but keeps its number if it is back

A touch is listed in the first frame that shows it; to avoid flicker, check its age. Numbers begin with 1 and are not
used twice until they run out.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from eitskin.touches.moments import MOST_TOUCHES, Found
from eitskin.touches.touch import BORN, DIED, MERGED, SPLIT
from eitskin_proto.skin.grid import Grid

MAX_ID: Final = 2**32 - 1
"""The largest number of a message, after which they begin again; a fragmented map takes a month to get there."""

GATE_MM: Final = 10.0
"""How far a touch moves from one frame to the next: 2 m/s at 200 frames/s. Nearer touches are not resolved anyway."""

BIRTH: Final = 0.6
"""The peak of a new touch; one that is known goes on down to one half."""

HOLD_FRAMES: Final = 5
"""Frames for which a touch that is not seen keeps its number."""


WALK: Final = 1.5e3
"""mm2/s3, by which the variance of a velocity grows: 12 mm/s in 100 ms."""

SPEED_MM_S: Final = 50.0
"""Of a touch whose velocity is not known, standard deviation along x and y."""

NOISE_MM: Final = 0.5
"""Standard deviation along x and y of the place that one frame shows, until frames have told."""

LEAST_MM: Final = 0.05
"""The least that it is taken for."""

LEARNING: Final = 1.0 / 16.0
"""Share of a frame in what is known of that noise."""

MOST_LEARNED: Final = 2.0
"""A squared deviation over its variance, beyond which the rest is taken for a change of velocity, not for noise."""

JUMP: Final = 16.0
"""A squared deviation over its variance beyond which a touch has begun to move otherwise."""

SETTLE_FRAMES: Final = 16
"""Frames after the end of a mean by which a velocity is known to 7 mm/s."""

LONGEST_S: Final = 0.1
"""Time between frames after which nothing is expected, so a touch is where the frame shows it."""


@dataclass(slots=True)
class Track:
    """A touch from frame to frame."""

    id: int
    parent: int
    """The touch that it split from; 0 for none."""
    born_us: int
    x_mm: float
    y_mm: float
    unseen: int = 0
    """Frames since it was seen last."""
    velocity_mm_s: tuple[float, float] = (0.0, 0.0)
    fused: int = 1
    """Frames that its place was averaged over."""
    settling: int = 0
    """Frames until its velocity is known."""
    noise_var: float = NOISE_MM**2
    """Variance along x and y of the place that one frame shows."""
    place_var: float = NOISE_MM**2
    both_var: float = 0.0
    velocity_var: float = SPEED_MM_S**2
    """Variances of place and velocity along x and y, and their covariance."""

    @property
    def moves(self) -> bool:
        """Whether frames are not to be averaged: it moves, or may have begun to."""
        speed = math.hypot(*self.velocity_mm_s)
        return self.settling > 0 or speed * speed > 9.0 * self.velocity_var

    def expect(self, passed_s: float) -> None:
        """Go where the velocity leads."""
        vx, vy = self.velocity_mm_s
        self.x_mm, self.y_mm = self.x_mm + passed_s * vx, self.y_mm + passed_s * vy
        more = WALK * passed_s
        self.place_var += passed_s * (2.0 * self.both_var + passed_s * (self.velocity_var + more / 3.0))
        self.both_var += passed_s * (self.velocity_var + 0.5 * more)
        self.velocity_var += more
        self.settling = max(0, self.settling - 1)

    def follow(self, x_mm: float, y_mm: float, fused: int) -> None:
        """Correct what is expected by what a frame shows, or the mean of several."""
        if fused < self.fused:
            self.settling = SETTLE_FRAMES
        self.fused, self.unseen = fused, 0
        across, along, total = x_mm - self.x_mm, y_mm - self.y_mm, self.place_var + self.noise_var
        apart = 0.5 * (across * across + along * along)
        if fused > 1 or apart > JUMP * total:
            self.x_mm, self.y_mm, self.velocity_mm_s = x_mm, y_mm, (0.0, 0.0)
            self.place_var, self.both_var, self.velocity_var = self.noise_var / fused, 0.0, SPEED_MM_S**2
            return
        place, velocity = self.place_var / total, self.both_var / total
        vx, vy = self.velocity_mm_s
        self.x_mm, self.y_mm = self.x_mm + place * across, self.y_mm + place * along
        self.velocity_mm_s = vx + velocity * across, vy + velocity * along
        self.velocity_var -= velocity * self.both_var
        self.place_var, self.both_var = place * self.noise_var, velocity * self.noise_var
        learned = min(apart / total, MOST_LEARNED)
        self.noise_var = max(LEAST_MM**2, self.noise_var * (1.0 + LEARNING * (learned - 1.0)))


Event = tuple[int, int, int]
"""What happened, the touch, and the other one or 0."""


class Tracker:
    """Numbers the touches of one frame after another.

    Args:
        grid: Of the skin.
    """

    __slots__ = ("_before", "_device_us", "_now", "_pixel_mm", "_tracks", "_used", "_width", "newest")

    def __init__(self, grid: Grid) -> None:
        self._pixel_mm, self._width = grid.pixel_mm, grid.shape[1] + 2
        size = (grid.shape[0] + 2) * self._width
        self._before = np.zeros(size, dtype=np.int64)
        """The number of the touch that each pixel belonged to; 0 for none."""
        self._used = np.zeros(0, dtype=np.intp)
        self._now = np.full(size, -1, dtype=np.int64)
        self._tracks: list[Track] = []
        self._device_us = 0
        """When the last frame was scanned."""
        self.newest = 0
        """The number given last."""

    @property
    def idle(self) -> bool:
        """Whether no touch is known."""
        return not self._tracks

    def reset(self) -> None:
        """Know no touch any more; numbers go on."""
        self._before[self._used] = 0
        self._used = self._used[:0]
        self._tracks.clear()

    @property
    def moves(self) -> bool:
        """Whether a touch moves, or may have begun to."""
        return any(track.moves for track in self._tracks)

    def step(self, found: Found, device_us: int, fused: int = 1) -> tuple[list[Track | None], list[Event]]:
        """Return the track of each touch of a frame, and what happened; None for one that does not rise to ``BIRTH``.

        Args:
            found: The frame's touches.
            device_us: When it was scanned.
            fused: Frames that it is the mean of.
        """
        passed_s = 1e-6 * (device_us - self._device_us)
        for track in self._tracks:
            if 0.0 < passed_s <= LONGEST_S:
                track.expect(passed_s)
            else:
                track.place_var = GATE_MM**2
        if device_us < self._device_us:  # a restarted device counts from 0; ages continue
            for track in self._tracks:
                track.born_us += device_us - self._device_us
        self._device_us = device_us
        xs, ys, peaks = ([row[column] for row in found.rows] for column in (0, 1, 6))
        count = len(xs)
        now, before = self._now, self._before
        now[found.pixels] = found.touch  # with those right around it; its own pixels belong to it alone
        lies_in = [int(now[self._pixel(track.x_mm, track.y_mm)]) for track in self._tracks]
        lay_in = [int(before[self._pixel(x, y)]) for x, y in zip(xs, ys, strict=True)]
        now[found.pixels] = -1
        result, taken = self._paired(xs, ys, lies_in, lay_in)
        for known, x, y in zip(result, xs, ys, strict=True):
            if known is not None:
                known.follow(x, y, fused)
        events: list[Event] = []
        goes_on = {track.id for track in result if track is not None}
        for touch in range(count):
            if result[touch] is None and peaks[touch] >= BIRTH:
                parent = lay_in[touch] if lay_in[touch] in goes_on else 0
                self.newest = self.newest % MAX_ID + 1
                result[touch] = Track(self.newest, parent, device_us, xs[touch], ys[touch], fused=fused)
                events.append((SPLIT if parent else BORN, self.newest, parent))
        left: list[Track] = []
        for index, track in enumerate(self._tracks):
            if index in taken:
                continue
            other = result[lies_in[index]] if lies_in[index] >= 0 else None
            track.unseen += 1
            if track.unseen == 1 and other is not None:
                events.append((MERGED, track.id, other.id))
            elif track.unseen > HOLD_FRAMES or len(left) == MOST_TOUCHES:
                events.append((DIED, track.id, 0))
            else:
                left.append(track)
        self._tracks = left + [track for track in result if track is not None]
        before[self._used] = 0
        self._used = found.pixels
        if count:
            ids = np.array([0 if track is None else track.id for track in result])
            before[found.pixels] = ids[found.touch]
        return result, events

    def _paired(
        self, xs: list[float], ys: list[float], lies_in: list[int], lay_in: list[int]
    ) -> tuple[list[Track | None], set[int]]:
        """Return the known track of each touch, and which tracks these are."""
        pairs = []
        for index, track in enumerate(self._tracks):
            for touch, x in enumerate(xs):
                across, along = x - track.x_mm, ys[touch] - track.y_mm
                distance = across * across + along * along
                if distance <= GATE_MM * GATE_MM or lies_in[index] == touch or lay_in[touch] == track.id:
                    pairs.append((distance, track.id, index, touch))
        pairs.sort()
        result: list[Track | None] = [None] * len(xs)
        taken: set[int] = set()
        for _, _, index, touch in pairs:
            if index not in taken and result[touch] is None:
                taken.add(index)
                result[touch] = self._tracks[index]
        return result, taken

    def _pixel(self, x_mm: float, y_mm: float) -> int:
        """Return the pixel of a place, by its number in the map with its border."""
        column, row = int(x_mm / self._pixel_mm[0]) + 1, int(y_mm / self._pixel_mm[1]) + 1
        return min(max(row, 0), len(self._now) // self._width - 1) * self._width + min(max(column, 0), self._width - 1)
