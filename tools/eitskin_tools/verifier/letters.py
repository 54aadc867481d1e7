"""The messages between the runtime and its verifier: packets of MessagePack over one socket, in order.

::

    runtime  -> SETUP, number, fields | FRAME, fields | BASELINE, fields
    verifier -> STATE, state, setup, why, setup_ms | VERDICT, message, flagged, spent_ms

A frame is sent only while the verifier has none, so the newest is verified and nothing queues up.
"""

from dataclasses import dataclass, fields
from typing import Any, Final, Self

import msgpack  # type: ignore[import-untyped]
import numpy as np
import numpy.typing as npt

from eitskin_proto.errors import MismatchError
from eitskin_proto.skin.skin import Skin
from eitskin_proto.skin.toml import parse

Array = npt.NDArray[np.float64]
Values = npt.NDArray[np.float32]
Rows = npt.NDArray[np.bool_]

SETUP, FRAME, BASELINE, STATE, VERDICT = range(5)
"""Kinds of packets: the first item of each."""

BUDGET_S: Final = 0.2
"""What a frame may take by default."""

LARGEST_PACKET: Final = 1 << 18
"""Bytes: a setup with a cloud of the largest map has 173 kB, a frame with such a map 58 kB."""


@dataclass(frozen=True, slots=True)
class Setup:
    """All that verifying needs of one shape of the sheet under one reference."""

    bundle: str
    """Id of the bundle."""
    labels: str
    """Of the bundle: "units" or "area"."""
    touches: str
    """"raise", "lower" or "both": which way they change conductance."""
    skin: str
    """Its description, in TOML."""
    skin_digest: str
    """That of the skin in use."""
    cloud: int
    """Revision."""
    cloud_mm: bytes
    """(3, rows, columns) float32."""
    reference_V: bytes
    """(104,) float64: flat and untouched."""
    spread_V: bytes
    """(104,) float64: standard deviation of a single frame."""
    budget_s: float
    """What a frame may take."""
    shared_V: bytes = b""
    """(104, k) float64: the part of the spread that rows share; empty for none."""

    def packed(self, number: int) -> bytes:
        """Return its packet."""
        return pack(SETUP, number, {one.name: getattr(self, one.name) for one in fields(self)})

    def described(self) -> Skin:
        """Return the skin.

        Raises:
            MismatchError: The description is not that of the skin in use.
        """
        skin = parse(self.skin)
        if skin.digest != self.skin_digest:
            hint = "start the runtime and its verifier from one release"
            raise MismatchError("verifier: skin", found=skin.digest, expected=self.skin_digest, hint=hint)
        return skin


@dataclass(frozen=True, slots=True, eq=False)
class FrameLetter:
    """One frame to verify."""

    setup: int
    """Number of the setup that it belongs to."""
    seq: int
    device_us: int
    read_ns: int
    publish_ns: int
    cloud: int
    missing: Rows
    """(104,) rows that are filled in from the others."""
    change: Values
    """(104,) dV, as the solver had it."""
    map: Values
    """(pixels,) what the solver made of it."""

    def packed(self) -> bytes:
        """Return its packet."""
        numbers = [self.setup, self.seq, self.device_us, self.read_ns, self.publish_ns, self.cloud]
        return pack(FRAME, numbers, self.missing.tobytes(), self.change.tobytes(), self.map.tobytes())

    @classmethod
    def of(cls, numbers: list[int], missing: bytes, change: bytes, values: bytes) -> Self:
        """Return the frame of a packet's items."""
        rows = np.frombuffer(missing, dtype=np.bool_)
        setup, seq, device_us, read_ns, publish_ns, cloud = numbers
        shown = np.frombuffer(values, dtype="<f4")
        return cls(setup, seq, device_us, read_ns, publish_ns, cloud, rows, np.frombuffer(change, dtype="<f4"), shown)


@dataclass(frozen=True, slots=True, eq=False)
class BaselineLetter:
    """What the sheet reads while nothing touches it."""

    setup: int
    """Number of the setup that it belongs to."""
    frames: int
    """That it is the mean of."""
    change: Array
    """(104,) dV."""

    def packed(self) -> bytes:
        """Return its packet."""
        return pack(BASELINE, self.setup, self.frames, self.change.astype("<f8").tobytes())

    @classmethod
    def of(cls, setup: int, frames: int, change: bytes) -> Self:
        """Return what a packet's items say."""
        return cls(setup, frames, np.frombuffer(change, dtype="<f8"))


def pack(*items: Any) -> bytes:
    """Return a packet: its kind first."""
    found: bytes = msgpack.packb(items)
    return found


def unpack(packet: bytes) -> list[Any]:
    """Return the items of a packet: its kind first."""
    found: list[Any] = msgpack.unpackb(packet)
    return found


def state_answer(state: str, setup: int, why: str = "", setup_ms: float = 0.0) -> bytes:
    """Return what a verifier says of itself: its state, and of which setup."""
    return pack(STATE, state, setup, why, setup_ms)


def verdict_answer(message: bytes, flagged: bool | None, spent_ms: float) -> bytes:
    """Return what a verifier says of the frame that it has.

    Args:
        message: The verifier's part of the message (:mod:`eitskin.messaging.streams.verified`).
        flagged: None where there is no verdict.
        spent_ms: What it took.
    """
    return pack(VERDICT, message, flagged, spent_ms)
