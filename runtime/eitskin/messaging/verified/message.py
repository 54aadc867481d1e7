r"""What physics says of a frame that was published, byte by byte, and what a subscriber gets.

One MessagePack map of 15 keys, its name first, so that constant first bytes select it (firmware_proto/SPEC.md has the
fields)::

    8f | a8 "verified" | number | "v" 4 | "run" | "counts" |  "seq" ... what the verifier said

Its head is the runtime's, which counts and knows whether the verifier lives; the rest is the verifier's, packed there.
A message without a verdict says how the verifier is: ``state`` and ``why``; with one that is flagged, ``why`` is the
reason. A subscriber trusts neither.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import msgpack  # type: ignore[import-untyped]

from eitskin.errors import FrameError
from eitskin.messaging.frame import Frame
from eitskin.messaging.streams.fields import Fields
from eitskin.messaging.verified.touch import VerifiedTouch

VERSION: Final = 4
"""Of the message; a frame has 1, a touch message 2, a stream 3."""

FIRST_BYTE: Final = b"\x8f"
"""A verified message begins with it: a MessagePack map of 15 keys."""

NAME: Final = "verified"
TOPIC: Final = FIRST_BYTE + bytes(msgpack.packb(NAME))
"""What selects verified messages."""

STARTING, PREPARING, READY, WAITING, FAILED = STATES = ("starting", "preparing", "ready", "waiting", "failed")
"""Of a verifier: its process begins; it makes the model of the cloud in use; it verifies; it ended and will be started
again; it will not verify, until the cloud or the reference changes or for good."""

UNEXPLAINED, CONTESTED, TIME = FLAGS = ("unexplained", "contested", "time")
"""Why a frame is flagged: p is below 0.01; the network plainly shows a touch that is not among these, or one of these
is smaller than touches of the skin are; time ended the search before it had explained the frame or confirmed its
touches."""

COUNTS: Final = ("checked", "flagged", "skipped")
"""Totals of the run: frames that were verified; those of them that are flagged; changed frames that were not."""

STAMPS: Final = ("read", "publish", "begin", "end")
"""Times: the frame's last byte was in hand, it was published, its verifying began and ended; 0 where there is none."""

MOST_TOUCHES: Final = 128
MOST_WHY: Final = 256
"""Characters."""


def asked_for(topic: bytes) -> bool:
    """Return whether who subscribes to a topic is sent verified messages and means it; the empty topic means frames."""
    return topic[:1] == FIRST_BYTE and (TOPIC.startswith(topic) or topic.startswith(TOPIC))


def head(number: int, run: str, counts: Mapping[str, int]) -> bytes:
    """Return the runtime's part of a message.

    Args:
        number: Counts the verified messages of a run, from 1 on.
        run: Differs after each start of the runtime.
        counts: ``COUNTS``.
    """
    pack = msgpack.packb
    return b"".join((TOPIC, pack(number), pack("v"), pack(VERSION), pack("run"), pack(run), pack("counts"),
                     pack({name: counts[name] for name in COUNTS})))  # fmt: skip


def rest(
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
        why: What is wrong, for people; of a flagged verdict one of ``FLAGS``; empty where nothing is.
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
    """What physics says of one frame; or, without a verdict, how the verifier is.

    Attributes:
        sequence: ``sequence`` of the frame; of a message without a verdict, the newest frame's.
        state: ``ready`` while frames are verified; else ``starting``, ``preparing``, ``waiting`` or ``failed``.
        why: What is wrong; empty where nothing is. Of a flagged verdict the reason: ``unexplained``, ``contested`` or
            ``time``; empty from an older runtime.
        touches: That explain the frame best; None without a verdict.
        chi_squared: What they leave unexplained; None without a verdict.
        degrees_of_freedom: What right touches leave on the average; None without a verdict.
        p_value: Chance that right touches leave so much or more; None without a verdict.
        flagged: Whether these touches are not to be trusted: ``why`` says why; None without a verdict.
        cloud: Revision of the cloud that it was verified on.
        counts: Totals of the run: ``checked``, ``flagged``, ``skipped``.
        host_ns: ``perf_counter_ns`` of the runtime's machine at ``read``, ``publish``, ``begin``, ``end``.
        device_us: Device clock at the end of the frame's scan.
        number: Counts these messages in a run; a gap is one that this side missed.
        run: Differs after each start of the runtime.
        received_ns: ``perf_counter_ns`` of this machine when it was taken from the socket.
        frame: The published frame itself; None where it was not received, or not asked for.
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
        """Whether there is a verdict, physics explains the frame by its touches, and nothing contradicts them."""
        return self.flagged is False

    @property
    def spent_s(self) -> float:
        """Seconds that verifying took; 0 without a verdict."""
        return (self.host_ns["end"] - self.host_ns["begin"]) * 1e-9

    def of_frame(self, frame: Frame | None) -> "VerifiedFrame":
        """Return the same with its frame."""
        return replace(self, frame=frame)


def unpack_verified(message: bytes, received_ns: int = 0) -> VerifiedFrame:
    """Return what a message says.

    Args:
        message: Of any origin.
        received_ns: When it was taken from the socket.

    Raises:
        FrameError: It is no verified message, or one of another version.
    """
    fields = Fields(NAME, message)
    if (found := fields.count("v")) != VERSION:
        raise FrameError(f"verified version: found {found}, expected {VERSION}; use the runtime's release")
    state = fields.text("state")
    if state not in STATES:
        raise fields.wrong("state", f"one of {', '.join(STATES)}")
    verdict: dict[str, Any] = dict.fromkeys(("touches", "chi_squared", "degrees_of_freedom", "p_value", "flagged"))
    if not fields.is_nil("p_value"):
        touches = tuple(map(VerifiedTouch.of, fields.items("touches", MOST_TOUCHES)))
        p_value = fields.number("p_value")
        if not 0.0 <= p_value <= 1.0:
            raise fields.wrong("p_value", "0 to 1")
        verdict = {
            "touches": touches, "chi_squared": fields.number("chi_squared"), "p_value": p_value,
            "degrees_of_freedom": fields.count("degrees_of_freedom"), "flagged": fields.truth("flagged"),
        }  # fmt: skip
    return VerifiedFrame(
        sequence=fields.count("seq"),
        state=state,
        why=fields.text("why"),
        cloud=fields.count("cloud"),
        counts=_counts(fields, "counts", COUNTS),
        host_ns=_counts(fields, "host_ns", STAMPS),
        device_us=fields.count("device_us"),
        number=fields.count(NAME),
        run=fields.text("run"),
        received_ns=received_ns,
        **verdict,
    )


def _counts(fields: Fields, name: str, keys: tuple[str, ...]) -> dict[str, int]:
    found = fields.plain(name)
    if not all(type(found.get(key)) is int and found[key] >= 0 for key in keys):
        raise fields.wrong(name, f"counts of {', '.join(keys)}")
    return {key: found[key] for key in keys}
