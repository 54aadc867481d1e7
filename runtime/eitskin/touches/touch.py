"""A touch as a subscriber gets it, and its bytes in a message (firmware_proto/SPEC.md, "Touches").

All numbers little-endian: one touch is ``LAYOUT``, one event ``EVENT_LAYOUT``.
"""

import math
import struct
from dataclasses import dataclass
from typing import Final

from eitskin.errors import FrameError

LAYOUT: Final = struct.Struct("<II24f")
"""id, parent, age, then x, y, major, minor, angle, area, peak, strength, confidence, place, normal, surface area; error
along x and y, amplitude, log likelihood ratio; sign; velocity along x and y."""

SHORTEST: Final = struct.calcsize("<II17f")
"""A touch of the first runtimes, which had no error and nothing after it."""

UNKNOWN: Final = LAYOUT.pack(0, 0, *[math.nan] * 24)
"""Completes the touches of earlier runtimes."""

HEAD: Final = struct.Struct("<IIf")
"""The first three of them, which change while the map does not."""

EVENT_LAYOUT: Final = struct.Struct("<III")
"""Kind, touch, other touch."""

BORN, DIED, MERGED, SPLIT = 1, 2, 3, 4
KINDS: Final = {BORN: "born", DIED: "died", MERGED: "merged", SPLIT: "split"}
"""Of events."""

MOST_READ: Final = 4096
"""Bytes of touches, and of events, that are still looked at."""

NAMES: Final = ("touches", "touch_bytes", "touch_events", "touches_more")
KEYS: Final = len(NAMES)
"""Of a message."""


@dataclass(frozen=True, slots=True)
class Touch:
    """One touch of a frame.

    Attributes:
        id: A number from 1 on. It stays while the touch moves, and is used once in a run.
        parent: Id of the touch that this one split from; 0 for none.
        age_s: Seconds since the first frame with this touch, by the device's clock.
        centre_mm: x and y on the flat sheet.
        axes_mm: Longer and shorter axis of the ellipse with the same second moments: 10 and 10 for a 10 mm disc.
        angle_rad: Angle from x to the longer axis, towards y; from 0 to below pi.
        area_mm2: Area on the flat sheet.
        peak: Highest value of the map within the touch.
        strength: Change of the sheet's conductance; None, because maps do not give it (verified touches do).
        confidence: Probability that the touch is real; None, because it is not calibrated.
        place_mm: x, y and z of the centre on the bent surface, in the frame in which the cloud was sent.
        normal: Unit vector in which the surface faces there; zeros where it has no direction.
        surface_mm2: Area on the bent surface.
        error_mm: Standard errors of the centre along x and y; None unless touches were learned from presses.
        amplitude: How strong it is beside the presses that were learned from, which have 1; None likewise.
        log_likelihood_ratio: How much better the frame is explained with it than without; None likewise.
        sign: 1 if it raises the sheet's conductance, -1 if it lowers it; None from a network that knows touches of both
            signs and shows them alike (verified touches have a contrast).
        velocity_mm_s: Velocity of the centre along x and y on the flat sheet, 0 while it rests; None from older
            runtimes.
    """

    id: int
    parent: int
    age_s: float
    centre_mm: tuple[float, float]
    axes_mm: tuple[float, float]
    angle_rad: float
    area_mm2: float
    peak: float
    strength: float | None
    confidence: float | None
    place_mm: tuple[float, float, float]
    normal: tuple[float, float, float]
    surface_mm2: float
    error_mm: tuple[float, float] | None = None
    amplitude: float | None = None
    log_likelihood_ratio: float | None = None
    sign: int | None = None
    velocity_mm_s: tuple[float, float] | None = None

    def __str__(self) -> str:
        """Return one line: where it is, how large, which way the surface faces, how old."""
        x, y, z = self.place_mm
        return (
            f"touch {self.id} at x {self.centre_mm[0]:.1f}, y {self.centre_mm[1]:.1f} mm, in space "
            f"{x:.1f} {y:.1f} {z:.1f} mm facing {self.normal[0]:.2f} {self.normal[1]:.2f} {self.normal[2]:.2f}, "
            f"{self.area_mm2:.0f} mm2, peak {self.peak:.2f}, {self.age_s:.2f} s"
        )


@dataclass(frozen=True, slots=True)
class TouchEvent:
    """An event of a touch in a frame.

    Attributes:
        kind: ``born``, ``died``, ``merged`` into another one, or ``split`` from another one.
        id: Id of the touch.
        other: Id of the other touch for ``merged`` and ``split``; 0 for none.
    """

    kind: str
    id: int
    other: int


@dataclass(frozen=True, slots=True)
class TouchList:
    """The touches of a frame.

    Attributes:
        touches: The touches, in the order of their ids.
        events: Events since the previous frame.
        more: Number of further touches that are not listed; 0 unless the map is crowded.
    """

    touches: tuple[Touch, ...]
    events: tuple[TouchEvent, ...]
    more: int


def unpack_touches(raw: object, size: object, raw_events: object, more: object) -> TouchList:
    """Return the touches of a message's values, whatever they are.

    Args:
        raw: Of ``touches``.
        size: Of ``touch_bytes``.
        raw_events: Of ``touch_events``.
        more: Of ``touches_more``.

    Raises:
        FrameError: One of them is malformed.
    """
    if type(size) is not int or not SHORTEST <= size <= MOST_READ:
        raise FrameError(f"frame touch_bytes: found {str(size)[:40]}, expected at least {SHORTEST}")
    if not isinstance(raw, bytes) or len(raw) % size or len(raw) > MOST_READ:
        raise FrameError(f"frame touches: expected {size} bytes for each touch, and at most {MOST_READ}")
    if not isinstance(raw_events, bytes) or len(raw_events) % EVENT_LAYOUT.size or len(raw_events) > MOST_READ:
        raise FrameError(f"frame touch_events: expected {EVENT_LAYOUT.size} bytes for each, and at most {MOST_READ}")
    if type(more) is not int or more < 0:
        raise FrameError(f"frame touches_more: found {str(more)[:40]}, expected a count")
    events = tuple(
        TouchEvent(KINDS.get(kind, str(kind)), touch, other)
        for kind, touch, other in EVENT_LAYOUT.iter_unpack(raw_events)
    )
    return TouchList(tuple(_touch(raw[at : at + size]) for at in range(0, len(raw), size)), events, more)


def _touch(raw: bytes) -> Touch:
    number, parent, *values = LAYOUT.unpack((raw + UNKNOWN[len(raw) :])[: LAYOUT.size])
    age, x, y, major, minor, angle, area, peak, strength, confidence, *space = values[:17]
    x_error, y_error, amplitude, ratio, sign, vx, vy = map(_known, values[17:])
    if not all(map(math.isfinite, (age, x, y, major, minor, angle, area, peak, *space))):
        raise FrameError(f"frame touches: touch {number} has values that are not finite")
    return Touch(
        number, parent, age, (x, y), (major, minor), angle, area, peak, _known(strength), _known(confidence),
        (space[0], space[1], space[2]), (space[3], space[4], space[5]), space[6],
        None if x_error is None or y_error is None else (x_error, y_error), amplitude, ratio,
        None if sign is None else int(sign), None if vx is None or vy is None else (vx, vy),
    )  # fmt: skip


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None
