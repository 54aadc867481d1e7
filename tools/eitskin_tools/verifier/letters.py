"""The messages between the runtime and its verifier: packets of MessagePack over one socket, in order.

::

    runtime  -> Setup | FrameLetter | BaselineLetter
    verifier -> STATE, state, setup, why, setup_ms | VERDICT, message, flagged, spent_ms
                | SHAPE, setup, cloud_mm, predicted_V, predicted_flat_V

A frame is sent only while the verifier has none, so the newest is verified and nothing queues up.
"""

from dataclasses import dataclass, fields
from typing import Any, Final

import msgpack  # type: ignore[import-untyped]
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Values = npt.NDArray[np.float32]
Rows = npt.NDArray[np.bool_]

STATE, VERDICT, SHAPE = range(3)
"""Kinds of answers: the first item of each."""

BUDGET_S: Final = 0.5
"""What a frame may take by default."""

LARGEST_PACKET: Final = 1 << 18
"""Bytes: a setup with a cloud of the largest map has 173 kB, a frame with such a map 58 kB."""


@dataclass(frozen=True, slots=True, eq=False)
class Setup:
    """All that verifying needs of one shape of the sheet under one reference."""

    number: int
    labels: str
    """Of the bundle: "units" or "area"."""
    touches: str
    """"raise", "lower" or "both": which way they change conductance."""
    skin: str
    """Its description, in TOML."""
    cloud_mm: Values
    """(3, rows, columns)"""
    reference_V: Array
    """(104,) flat and untouched."""
    spread_V: Array
    """(104,) standard deviation of a single frame."""
    shared_V: Array
    """(104, k) the part of the spread that rows share."""
    budget_s: float
    """What a frame may take."""
    is_guess: bool = False
    """Whether nothing measured the cloud."""
    is_certain: bool = False
    """Whether frames never show another shape."""


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
    fused: int
    """Frames that it is the mean of."""
    missing: Rows
    """(104,) rows that are filled in from the others."""
    change: Values
    """(104,) dV, as the solver had it."""
    map: Values
    """(pixels,) what the solver made of it."""


@dataclass(frozen=True, slots=True, eq=False)
class BaselineLetter:
    """What the sheet reads while nothing touches it."""

    setup: int
    """Number of the setup that it belongs to."""
    frames: int
    """That it is the mean of."""
    change: Array
    """(104,) dV."""


Shape = tuple[Array, Array, Array]
"""(3, rows, columns) mm of a surface, and (104,) V_pred of it and of the flat sheet."""

Letter = Setup | FrameLetter | BaselineLetter

LETTERS: Final = (Setup, FrameLetter, BaselineLetter)


def packed(letter: Letter) -> bytes:
    """Return the packet of a letter."""
    return _pack(LETTERS.index(type(letter)), {one.name: getattr(letter, one.name) for one in fields(letter)})


def letter_of(packet: bytes) -> Letter:
    """Return the letter of a packet."""
    kind, items = unpack(packet)
    return LETTERS[kind](**items)


def unpack(packet: bytes) -> list[Any]:
    """Return the items of a packet: its kind first."""
    found: list[Any] = msgpack.unpackb(packet, ext_hook=_array)
    return found


def _pack(*items: Any) -> bytes:
    found: bytes = msgpack.packb(items, default=_packed_array)
    return found


def _packed_array(values: npt.NDArray[Any]) -> msgpack.ExtType:
    return msgpack.ExtType(0, msgpack.packb((values.dtype.str, values.shape, values.tobytes())))


def _array(code: int, data: bytes) -> npt.NDArray[Any]:
    kind, shape, values = msgpack.unpackb(data)
    return np.frombuffer(values, dtype=kind).reshape(shape)


def state_answer(state: str, setup: int, why: str = "", setup_ms: float = 0.0) -> bytes:
    """Return what a verifier says of itself: its state, and of which setup."""
    return _pack(STATE, state, setup, why, setup_ms)


def verdict_answer(message: bytes, flagged: bool | None, spent_ms: float) -> bytes:
    """Return what a verifier says of the frame that it has.

    Args:
        message: The verifier's part of the message (:mod:`eitskin.messaging.streams.verified`).
        flagged: None where there is no verdict.
        spent_ms: What it took.
    """
    return _pack(VERDICT, message, flagged, spent_ms)


def shape_answer(setup: int, shape: Shape) -> bytes:
    """Return the shape that a verifier found in frames."""
    return _pack(SHAPE, setup, *shape)
