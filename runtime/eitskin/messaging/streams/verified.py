r"""The verifier's verdict on a published frame: its bytes, and what a subscriber gets.

One MessagePack map of 15 keys, its name first, so that constant first bytes select it (firmware_proto/SPEC.md has the
fields)::

    8f | a8 "verified" | number | "v" 4 | "run" | "counts" |  "seq" ... what the verifier said

The runtime packs the head, with its counts and the verifier's state; the verifier packs the rest. In a message without
a verdict ``state`` and ``why`` describe the verifier; in a flagged one ``why`` is the reason. A subscriber checks both
halves.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any, Final, Self

import msgpack  # type: ignore[import-untyped]

from eitskin.errors import FrameError
from eitskin.messaging.frame import Frame
from eitskin.messaging.unpacking import fields_of, require
from eitskin_proto.fields import Fields

VERSION: Final = 4
"""Of the message; a frame has 1, a touch message 2, a stream 3."""

FIRST_BYTE: Final = b"\x8f"
"""A verified message begins with it: a MessagePack map of 15 keys."""

NAME: Final = "verified"
TOPIC: Final = FIRST_BYTE + bytes(msgpack.packb(NAME))
"""The topic of verified messages."""

STARTING, PREPARING, READY, WAITING, FAILED = STATES = ("starting", "preparing", "ready", "waiting", "failed")
"""Of a verifier: its process begins; it makes the model of the cloud in use; it verifies; it ended and will be started
again; it will not verify, until the cloud or the reference changes or for good."""

UNEXPLAINED, CONTESTED, TIME, DENTED = FLAGS = ("unexplained", "contested", "time", "dented")
"""Why a frame is flagged: p is below 0.01; the network plainly shows a touch that is not among these, or one of these
is smaller than touches of the skin are; time ended the search before it had explained the frame or confirmed its
touches."""

FITTED: Final = "fitted"
"""Said of a verdict that is not flagged: its shape was fitted to frames, because no cloud came or it did not explain
them. Places and normals are then not those of the true surface."""

COUNTS: Final = ("checked", "flagged", "skipped")
"""Totals of the run: frames that were verified; those of them that are flagged; changed frames that were not."""

STAMPS: Final = ("read", "publish", "begin", "end")
"""Times: the frame's last byte was in hand, it was published, its verifying began and ended; 0 where there is none."""

MOST_TOUCHES: Final = 128
MOST_WHY: Final = 256
"""Characters."""


SHAPES: Final = ("unit", "rectangle", "ellipse")
"""Of touches."""

PAIRS: Final = ("centre_mm", "centre_error_mm", "size_mm", "size_error_mm", "area_range_mm2", "contrast_range")
THREES: Final = ("place_mm", "normal")
NUMBERS: Final = (
    "angle_rad", "area_mm2", "area_error_mm2", "contrast", "strength_mm2", "strength_error_mm2", "border_mm",
    "angle_error_rad", "size_contrast_correlation",
)  # fmt: skip
ADDED: Final = ("angle_error_rad", "area_range_mm2", "contrast_range", "size_contrast_correlation")
"""Absent from a message where they are unknown, and in older releases."""

UNKNOWABLE: Final = ("centre_error_mm", "size_error_mm", "area_error_mm2", "strength_error_mm2", *ADDED)
"""None where a verifier does not tell them."""


@dataclass(frozen=True, slots=True)
class VerifiedTouch:
    """One touch of a verified frame.

    Attributes:
        shape: ``rectangle``, ``ellipse``, or ``unit``: a touch unit of the sheet (bundle ``units``).
        unit: Number of the unit, row by row; None for other shapes.
        centre_mm: x and y on the flat sheet.
        centre_error_mm: Standard errors of the centre; None for a unit, whose place is fixed.
        size_mm: Length and width.
        size_error_mm: Standard errors of length and width; None for a unit.
        angle_rad: Angle from x to the length, towards y; from 0 to below pi.
        area_mm2: Area on the flat sheet.
        area_error_mm2: Standard error of the area; None for a unit.
        contrast: Conductivity over the untouched sheet's.
        strength_mm2: Logarithm of the contrast times the area; below 0 if a press lowers conductance.
        strength_error_mm2: Standard error of the strength; None for a unit, whose area and usual contrast are given.
        border_mm: Width of the graded border; 0 is sharp.
        place_mm: x, y and z of the centre on the bent surface, in the frame in which the cloud was sent.
        normal: Unit vector in which the surface faces there; zeros where it has no direction.
        angle_error_rad: Standard error of the angle; None for a unit, and if the angle was not fitted.
        area_range_mm2: Range of areas that explain the frame, with matching contrasts; None for a unit. A small touch
            of high contrast and a larger one of lower contrast give nearly the same readings.
        contrast_range: Range of contrasts that explain the frame, with matching areas; None for a unit.
        size_contrast_correlation: Correlation of log area and log contrast, from -1 to 1. Near -1 only their product,
            the strength, is known. None for a unit.
    """

    shape: str
    unit: int | None
    centre_mm: tuple[float, float]
    centre_error_mm: tuple[float, float] | None
    size_mm: tuple[float, float]
    size_error_mm: tuple[float, float] | None
    angle_rad: float
    area_mm2: float
    area_error_mm2: float | None
    contrast: float
    strength_mm2: float
    strength_error_mm2: float | None
    border_mm: float
    place_mm: tuple[float, float, float]
    normal: tuple[float, float, float]
    angle_error_rad: float | None = None
    area_range_mm2: tuple[float, float] | None = None
    contrast_range: tuple[float, float] | None = None
    size_contrast_correlation: float | None = None

    def fields(self) -> dict[str, Any]:
        """Return the touch as a message's map."""
        return {name: value for name, value in asdict(self).items() if value is not None or name not in ADDED}

    def __str__(self) -> str:
        """Return it in a line, for people."""
        x, y = self.centre_mm
        which = self.shape if self.unit is None else f"unit {self.unit}"
        off = "" if self.centre_error_mm is None else f" +- {max(self.centre_error_mm):.2f}"
        length, width = self.size_mm
        area = "" if self.area_range_mm2 is None else "area {:.0f} to {:.0f} mm2, ".format(*self.area_range_mm2)
        error = "" if self.strength_error_mm2 is None else f" +- {self.strength_error_mm2:.0f}"
        return (
            f"{which} at x {x:.1f}, y {y:.1f}{off} mm, {length:.1f} x {width:.1f} mm, {area}"
            f"contrast {self.contrast:.3g}, strength {self.strength_mm2:.0f}{error} mm2"
        )

    @classmethod
    def of(cls, fields: Fields) -> Self:
        """Return the touch of a message's map.

        Raises:
            FrameError: It is malformed.
        """
        found: dict[str, Any] = {"unit": None if _unknown(fields, "unit") else fields.whole("unit")}
        for names, read in ((PAIRS, partial(fields.numbers, count=2)), (THREES, partial(fields.numbers, count=3)),
                            (NUMBERS, fields.number)):  # fmt: skip
            found |= {name: None if name in UNKNOWABLE and _unknown(fields, name) else read(name) for name in names}
        return cls(shape=fields.choice("shape", SHAPES), **found)


def _unknown(fields: Fields, name: str) -> bool:
    return name not in fields or fields.is_nil(name)


def asked_for(topic: bytes) -> bool:
    """Return whether a topic asks for verified messages; the empty topic gets them but does not ask for them."""
    return topic[:1] == FIRST_BYTE and (TOPIC.startswith(topic) or topic.startswith(TOPIC))


def pack_head(number: int, run: str, counts: Mapping[str, int]) -> bytes:
    """Return the runtime's part of a message.

    Args:
        number: Counts the verified messages of a run, from 1 on.
        run: Differs after each start of the runtime.
        counts: ``COUNTS``.
    """
    pack = msgpack.packb
    return b"".join((TOPIC, pack(number), pack("v"), pack(VERSION), pack("run"), pack(run), pack("counts"),
                     pack({name: counts[name] for name in COUNTS})))  # fmt: skip


def pack_verdict(
    seq: int,
    device_us: int,
    cloud: int,
    state: str,
    why: str,
    host_ns: tuple[int, int, int, int],
    verdict: tuple[float, int, float, bool] | None = None,
    touches: tuple[VerifiedTouch, ...] = (),
) -> bytes:
    """Return the other part of a message.

    Args:
        seq: Of the frame.
        device_us: Of the frame.
        cloud: Revision of the cloud that it was verified on.
        state: One of ``STATES``.
        why: The problem, for people; for a flagged verdict one of ``FLAGS``, for another ``FITTED`` or nothing.
        host_ns: In the order of ``STAMPS``.
        verdict: chi-squared, degrees of freedom, p-value, flagged; None where the frame was not verified.
        touches: That explain the frame best.
    """
    chi_squared, degrees, p_value, flagged = (None, None, None, None) if verdict is None else verdict
    fields: dict[str, object] = {
        "seq": seq, "device_us": device_us, "cloud": cloud, "state": state, "why": why[:MOST_WHY],
        "host_ns": dict(zip(STAMPS, host_ns, strict=True)), "chi_squared": chi_squared, "degrees_of_freedom": degrees,
        "p_value": p_value, "flagged": flagged,
        "touches": None if verdict is None else [touch.fields() for touch in touches[:MOST_TOUCHES]],
    }  # fmt: skip
    return b"".join(msgpack.packb(name) + msgpack.packb(value) for name, value in fields.items())


@dataclass(frozen=True, slots=True, eq=False)
class VerifiedFrame:
    """The verifier's verdict on one frame or, without a verdict, the verifier's state.

    Attributes:
        sequence: ``sequence`` of the frame; without a verdict, of the newest frame.
        state: ``ready`` while frames are verified; else ``starting``, ``preparing``, ``waiting`` or ``failed``.
        why: The problem; empty if there is none. For a flagged verdict ``unexplained``, ``dented`` or ``time``; for one
            that is not flagged ``fitted`` if its shape was fitted to frames.
        touches: The touches that explain the frame best; None without a verdict.
        chi_squared: The remaining misfit of these touches; None without a verdict.
        degrees_of_freedom: The average ``chi_squared`` of correct touches; None without a verdict.
        p_value: Probability that correct touches give at least this ``chi_squared``; None without a verdict.
        flagged: Whether not to trust these touches, for the reason in ``why``; None without a verdict.
        cloud: Revision of the cloud that the verifier used.
        counts: Totals of the run: ``checked``, ``flagged``, ``skipped``.
        host_ns: ``perf_counter_ns`` of the runtime's machine at ``read``, ``publish``, ``begin``, ``end``.
        device_us: Device clock at the end of the frame's scan.
        number: Counts these messages in a run; a gap means that this side missed messages.
        run: Id of this run of the runtime; it differs after each start.
        received_ns: ``perf_counter_ns`` of this machine when it took the message from the socket.
        frame: The published frame; None if it was not received or not requested.
    """

    sequence: int
    state: str
    why: str
    touches: tuple[VerifiedTouch, ...] | None
    chi_squared: float | None
    degrees_of_freedom: int | None
    p_value: float | None
    flagged: bool | None
    cloud: int
    counts: Mapping[str, int]
    host_ns: Mapping[str, int]
    device_us: int
    number: int
    run: str
    received_ns: int = 0
    frame: Frame | None = None

    @property
    def verified(self) -> bool:
        """Whether there is a verdict."""
        return self.p_value is not None

    @property
    def trusted(self) -> bool:
        """Whether there is a verdict and it is not flagged."""
        return self.flagged is False

    @property
    def spent_s(self) -> float:
        """Seconds that the verification took; 0 without a verdict."""
        return (self.host_ns["end"] - self.host_ns["begin"]) * 1e-9

    def of_frame(self, frame: Frame | None) -> "VerifiedFrame":
        """Return this verdict with its frame."""
        return replace(self, frame=frame)


def unpack_verified(message: bytes, received_ns: int = 0) -> VerifiedFrame:
    """Return the content of a message.

    Args:
        message: Of any origin.
        received_ns: When it was taken from the socket.

    Raises:
        FrameError: It is no verified message, or one of another version.
    """
    fields = fields_of(message, NAME)
    if (found := fields.value("v")) != VERSION:
        raise FrameError(f"verified version: found {str(found)[:20]}, expected {VERSION}; use the runtime's release")
    state = fields.choice("state", STATES)
    verdict: dict[str, Any] = dict.fromkeys(("touches", "chi_squared", "degrees_of_freedom", "p_value", "flagged"))
    if not fields.is_nil("p_value"):
        require(fields, "touches")
        touches = fields.entries("touches", most=MOST_TOUCHES, of="touches")
        verdict = {
            "touches": tuple(VerifiedTouch.of(_touch(touches, place)) for place in touches),
            "chi_squared": fields.number("chi_squared"), "p_value": fields.number("p_value", low=0.0, high=1.0),
            "degrees_of_freedom": fields.whole("degrees_of_freedom"), "flagged": fields.truth("flagged"),
        }  # fmt: skip
    return VerifiedFrame(
        sequence=fields.whole("seq"),
        state=state,
        why=fields.text("why", least=0),
        cloud=fields.whole("cloud"),
        counts=_counts(fields, "counts", COUNTS),
        host_ns=_counts(fields, "host_ns", STAMPS),
        device_us=fields.whole("device_us"),
        number=fields.whole(NAME),
        run=fields.text("run"),
        received_ns=received_ns,
        **verdict,
    )


def _touch(touches: Fields, place: int) -> Fields:
    return Fields(touches.value(place), f"verified touch {place}", error=FrameError, joint=", ")


def _counts(fields: Fields, name: str, keys: tuple[str, ...]) -> dict[str, int]:
    found = fields.table(name)
    return {key: found.whole(key) for key in keys}
