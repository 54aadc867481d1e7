"""Verified touches from frame to frame: where earlier verdicts expect a touch that moves is the prior of the next one.

Each touch has the Kalman filter of the network's touches (:mod:`eitskin.touches.tracking`), with the standard errors
that physics states for each frame. Chi-squared, p and errors stay those of the frame alone: what is wrong with the
sheet's model is wrong in all frames.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

from eitskin.touches.tracking import GATE_MM, Track
from eitskin_sim.verification.shape_verdict import ShapeTouch


class FollowedTouches:
    """The touches of one verdict after another."""

    def __init__(self) -> None:
        self._tracks: list[Track] = []
        self._device_us = 0

    def follow(self, touches: Sequence[ShapeTouch], device_us: int, fused: int = 1) -> list[ShapeTouch]:
        """Return a verdict's touches, each where earlier verdicts and this one together have it.

        Args:
            touches: That explain the frame.
            device_us: When it was scanned.
            fused: Frames that it is the mean of; if several, the touch rests, and is where they show it.
        """
        passed_s = 1e-6 * (device_us - self._device_us)
        known = self._tracks if passed_s > 0.0 else []
        for track in known:
            track.expect(passed_s)
        self._tracks, self._device_us = [], device_us
        return [self._followed(touch, known, fused) for touch in touches]

    def _followed(self, touch: ShapeTouch, known: list[Track], fused: int) -> ShapeTouch:
        x_mm, y_mm = touch.centre_mm
        x_error_mm, y_error_mm = touch.centre_error_mm
        variance = (x_error_mm**2 + y_error_mm**2) / 2.0

        def apart_mm(track: Track) -> float:
            return math.hypot(x_mm - track.x_mm, y_mm - track.y_mm)

        track = min(known, key=apart_mm, default=None)
        if track is None or apart_mm(track) > GATE_MM:
            track = Track(0, 0, 0, x_mm, y_mm, place_var=variance)
        else:
            known.remove(track)
            track.noise_var = variance
            track.follow(x_mm, y_mm, fused)
        self._tracks.append(track)
        return replace(touch, centre_mm=(track.x_mm, track.y_mm))
