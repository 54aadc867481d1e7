"""The layout of a message: named fields of fixed width, little-endian, without padding, and at most one free tail.

A :class:`Layout` is the only description of a message. Packing, strict unpacking, the tables of SPEC.md and the offsets
in the generated C header all come from it. ::

    kind      bytes   Python
    u8 u16 u32  1 2 4   int, range-checked
    f64           8     float, finite
    id            8     16 hex digits
    version       3     (major, minor, patch)
    magic         4     not a field of the dataclass: written and checked
    text16       16     ASCII, padded with zeros
    tail        0..n    bytes, the rest of the payload
"""

import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar, Final, Self

from eitskin_proto.errors import ProtocolError
from eitskin_proto.wire.codes import MAGIC, MessageType

WIDTH: Final[dict[str, int]] = {
    "u8": 1, "u16": 2, "u32": 4, "f64": 8, "id": 8, "version": 3, "magic": 4, "text16": 16, "tail": 0,
}  # fmt: skip
"""Bytes of each kind of field."""


def _encode(kind: str, name: str, value: Any) -> bytes:
    if kind in ("u8", "u16", "u32"):
        largest = (1 << (8 * WIDTH[kind])) - 1
        if not 0 <= int(value) <= largest:
            raise ValueError(f"{name} is {value}, but the wire carries 0 to {largest}")
        return int(value).to_bytes(WIDTH[kind], "little")
    if kind == "f64":
        if not math.isfinite(value):
            raise ValueError(f"{name} is {value}, expected a finite number")
        return struct.pack("<d", value)
    if kind == "id":
        if len(value) != 16:
            raise ValueError(f"{name} is {value!r}, expected 16 hex digits")
        return bytes.fromhex(value)
    if kind == "version":
        if len(value) != 3 or not all(0 <= part <= 255 for part in value):
            raise ValueError(f"{name} is {value}, expected three numbers from 0 to 255")
        return bytes(value)
    if kind == "text16":
        if len(value) > 16 or not value.isascii() or not value.isprintable():
            raise ValueError(f"{name} is {value!r}, expected at most 16 printable ASCII characters")
        return str(value).encode("ascii").ljust(16, b"\0")
    return bytes(value)  # tail


def _decode(kind: str, name: str, raw: bytes) -> Any:
    if kind in ("u8", "u16", "u32"):
        return int.from_bytes(raw, "little")
    if kind == "f64":
        number = struct.unpack("<d", raw)[0]
        if not math.isfinite(number):
            raise ProtocolError(f"{name} is {number}, expected a finite number")
        return number
    if kind == "id":
        return raw.hex()
    if kind == "version":
        return tuple(raw)
    if kind == "text16":
        text = raw.rstrip(b"\0")
        if not all(0x20 <= byte < 0x7F for byte in text):
            raise ProtocolError(f"{name} is {raw!r}, expected printable ASCII padded with zeros")
        return text.decode("ascii")
    return raw  # tail


@dataclass(frozen=True, slots=True)
class Layout:
    """The fields of one message after its type byte."""

    type: MessageType
    """First byte of the payload."""
    fields: tuple[tuple[str, str], ...]
    """(name, kind) in the order of the wire."""
    max_tail: int = 0
    """Most bytes that the tail may have."""

    @property
    def size(self) -> int:
        """Bytes of the payload without its tail."""
        return 1 + sum(WIDTH[kind] for _, kind in self.fields)

    def offsets(self) -> Iterator[tuple[int, str, str]]:
        """Yield (offset, name, kind) of every field; the type byte is at 0."""
        at = 1
        for name, kind in self.fields:
            yield at, name, kind
            at += WIDTH[kind]

    def pack(self, message: object) -> bytes:
        """Return the payload of a message.

        Raises:
            ValueError: A field does not fit; the text gives value and bound.
        """
        parts = [bytes([self.type])]
        for name, kind in self.fields:
            if kind == "magic":
                parts.append(MAGIC)
                continue
            parts.append(_encode(kind, name, getattr(message, name)))
            if kind == "tail" and len(parts[-1]) > self.max_tail:
                raise ValueError(f"{name} has {len(parts[-1])} bytes, but the message carries at most {self.max_tail}")
        return b"".join(parts)

    def unpack(self, payload: bytes, *, allow_more: bool = False) -> dict[str, Any]:
        """Return the fields of a payload.

        Args:
            payload: The whole payload, with its type byte.
            allow_more: Accept and ignore bytes at the end (HELLO of a later minor version).

        Raises:
            ProtocolError: The length, the magic or a field is wrong.
        """
        name = self.type.name
        if not self.size <= len(payload) <= self.size + self.max_tail and not (allow_more and len(payload) > self.size):
            expected = f"{self.size}" if not self.max_tail else f"{self.size} to {self.size + self.max_tail}"
            raise ProtocolError(f"{name} has {len(payload)} bytes, expected {expected}")
        values: dict[str, Any] = {}
        for at, field, kind in self.offsets():
            end = len(payload) if kind == "tail" else at + WIDTH[kind]
            raw = payload[at:end]
            if kind == "magic":
                if raw != MAGIC:
                    raise ProtocolError(f"{name} carries the magic {raw!r}, expected {MAGIC!r}: not an eitskin device")
                continue
            values[field] = _decode(kind, f"{name}.{field}", raw)
        return values


class Packed:
    """The base of messages: they pack and unpack themselves by their layout."""

    __slots__ = ()
    LAYOUT: ClassVar[Layout]

    def pack(self) -> bytes:
        """Return the payload, type byte first.

        Raises:
            ValueError: A field does not fit the wire.
        """
        return self.LAYOUT.pack(self)

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        """Return the message of a payload.

        Raises:
            ProtocolError: The payload is not exactly this message.
        """
        return cls(**cls.LAYOUT.unpack(payload))
