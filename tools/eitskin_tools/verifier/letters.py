"""What stands in the letters to a verifier, and in its answers."""

import struct
from dataclasses import dataclass, fields
from typing import Any, Final, Self

import msgpack  # type: ignore[import-untyped]
import numpy as np
import numpy.typing as npt

from eitskin_proto.errors import MismatchError
from eitskin_proto.sensor.table import N_ROWS
from eitskin_proto.skin.skin import Skin
from eitskin_proto.skin.toml import parse

Array = npt.NDArray[np.float64]
Values = npt.NDArray[np.float32]
Rows = npt.NDArray[np.bool_]

VERDICT, STATE = 0, 1
"""Kinds of answers."""

LARGEST_ANSWER: Final = 1 << 16
"""Bytes."""

_FRAME: Final = struct.Struct("<6Q")
_REST: Final = struct.Struct("<2Q")


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
    """What a frame may take; 0 for the usual."""

    def packed(self) -> bytes:
        """Return its letter."""
        found: bytes = msgpack.packb({one.name: getattr(self, one.name) for one in fields(self)})
        return found

    @classmethod
    def of(cls, letter: bytes) -> Self:
        """Return the setup of a letter."""
        return cls(**msgpack.unpackb(letter))

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
    """Number of the setup letter that it belongs to."""
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

    @classmethod
    def of(cls, letter: bytes) -> Self:
        """Return the frame of a letter."""
        rest = letter[_FRAME.size :]
        missing = np.frombuffer(rest, dtype=np.bool_, count=N_ROWS)
        change = np.frombuffer(rest, dtype="<f4", count=N_ROWS, offset=N_ROWS)
        setup, seq, device_us, read_ns, publish_ns, cloud = _FRAME.unpack_from(letter)
        values = np.frombuffer(rest, dtype="<f4", offset=5 * N_ROWS)
        return cls(setup, seq, device_us, read_ns, publish_ns, cloud, missing, change, values)


@dataclass(frozen=True, slots=True, eq=False)
class RestLetter:
    """What the sheet reads while nothing touches it."""

    setup: int
    """Number of the setup letter that it belongs to."""
    frames: int
    """That it is the mean of."""
    change: Array
    """(104,) dV."""

    @classmethod
    def of(cls, letter: bytes) -> Self:
        """Return what is in a letter."""
        setup, frames = _REST.unpack_from(letter)
        return cls(setup, frames, np.frombuffer(letter, dtype="<f8", offset=_REST.size))


def rest_letter(setup: int, frames: int, change: Array) -> bytes:
    """Return the letter of a sheet at rest; arguments as in :class:`RestLetter`."""
    return _REST.pack(setup, frames) + change.astype("<f8").tobytes()


def frame_letter(
    setup: int, seq: int, device_us: int, read_ns: int, publish_ns: int, cloud: int, missing: Rows, change: Values,
    values: Values,
) -> bytes:  # fmt: skip
    """Return the letter of a frame; arguments as in :class:`FrameLetter`."""
    head = _FRAME.pack(setup, seq, device_us, read_ns, publish_ns, cloud)
    return b"".join((head, missing.tobytes(), change.tobytes(), values.tobytes()))


def state_answer(state: str, setup: int, why: str = "", setup_ms: float = 0.0) -> bytes:
    """Return what a verifier says of itself: its state, and of which setup."""
    found: bytes = msgpack.packb([STATE, state, setup, why, setup_ms])
    return found


def verdict_answer(letter: int, rest: bytes, flagged: bool | None, spent_ms: float) -> bytes:
    """Return what a verifier says of a frame.

    Args:
        letter: Number of the frame's letter.
        rest: The verifier's part of the message (:mod:`eitskin.messaging.verified.message`).
        flagged: None where there is no verdict.
        spent_ms: What it took.
    """
    found: bytes = msgpack.packb([VERDICT, letter, rest, flagged, spent_ms])
    return found


def answered(answer: bytes) -> list[Any]:
    """Return the items of an answer: its kind first."""
    found: list[Any] = msgpack.unpackb(answer)
    return found
