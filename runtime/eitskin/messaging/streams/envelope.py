r"""The envelope of a stream's message: its stream, its number, and a body that may come in parts.

A MessagePack map of six keys, the stream's name first, so that a subscriber selects a stream by a constant prefix::

    86 | a4 "wire" | number | "v" 3 | "run" | "part" | "parts" | "body" bin

    b"\x86"                      all streams
    b"\x86\xa4wire"              the wire's frames; likewise cloud, conditions and state

A reader of frames ignores it, because its version is not 1. No message exceeds the limit of a frame, because a
subscriber would end the connection: a long body is cut into parts.
"""

import struct
from dataclasses import dataclass
from typing import Final

import msgpack  # type: ignore[import-untyped]

from eitskin.errors import FrameError
from eitskin.messaging.unpacking import unpacked
from eitskin_proto.fields import Fields

WIRE, CLOUD, CONDITIONS, STATE = NAMES = ("wire", "cloud", "conditions", "state")
"""The streams."""

VERSION: Final = 3
"""Of a stream's message; a frame has 1, a touch message 2."""

FIRST_BYTE: Final = b"\x86"
"""A stream's message begins with it: a MessagePack map of six keys."""

TOPICS: Final = {name: FIRST_BYTE + bytes(msgpack.packb(name)) for name in NAMES}
"""The topic of each stream."""

PIECE: Final = 65_535
"""Bytes of a body in one message."""

MOST_PARTS: Final = 32
"""Of a body: two megabytes; a reference has one at most."""

MAX_RUN: Final = 64

_NUMBER: Final = struct.Struct(">BQ")
_LENGTH: Final = struct.Struct(">BH")
_VERSION: Final = bytes(msgpack.packb("v") + msgpack.packb(VERSION) + msgpack.packb("run"))
_PART: Final = bytes(msgpack.packb("part"))
_PARTS: Final = bytes(msgpack.packb("parts"))
_BODY: Final = bytes(msgpack.packb("body"))
_WHOLE: Final = _PART + b"\x00" + _PARTS + b"\x01" + _BODY


def asked_for(name: str, topic: bytes) -> bool:
    """Return whether a topic asks for a stream; the empty topic gets streams but does not ask for them."""
    prefix = TOPICS[name]
    return topic[:1] == FIRST_BYTE and (prefix.startswith(topic) or topic.startswith(prefix))


def packed(name: str, number: int, run: str, body: bytes) -> list[bytes]:
    """Return the messages of one body, mostly one.

    Args:
        name: Of the stream.
        number: Counts the bodies of this stream.
        run: Differs after each start of the runtime.
        body: A MessagePack map.
    """
    head = b"".join((TOPICS[name], _NUMBER.pack(0xCF, number), _VERSION, msgpack.packb(run)))
    if len(body) <= PIECE:
        return [b"".join((head, _WHOLE, _LENGTH.pack(0xC5, len(body)), body))]
    pieces = [body[at : at + PIECE] for at in range(0, len(body), PIECE)]
    parts = _PARTS + bytes([len(pieces)])
    return [
        b"".join((head, _PART, bytes([part]), parts, _BODY, _LENGTH.pack(0xC5, len(piece)), piece))
        for part, piece in enumerate(pieces)
    ]


@dataclass(frozen=True, slots=True)
class Envelope:
    """One message, opened."""

    name: str
    number: int
    run: str
    part: int
    parts: int
    body: bytes


def opened(message: bytes) -> Envelope:
    """Return a message's envelope.

    Args:
        message: Of any origin.

    Raises:
        FrameError: It is no message of a stream, or one of another version.
    """
    fields = unpacked(message, "of a stream", longest_text=256, longest_list=0, longest_map=6)
    name = next(iter(fields), None)
    if name not in NAMES:
        raise FrameError(f"a message is not of a stream: found {str(name)[:20]!r}, expected one of {', '.join(NAMES)}")
    if fields.get("v") != VERSION:
        found = fields.get("v")
        raise FrameError(f"stream version: found {str(found)[:20]}, expected {VERSION}; use the runtime's release")
    checked = Fields(fields, f"stream {name}", error=FrameError, joint=", ")
    parts = checked.whole("parts", low=1, high=MOST_PARTS)
    return Envelope(
        name,
        number=checked.whole(name),
        run=checked.text("run", least=0, longest=MAX_RUN),
        part=checked.whole("part", high=parts - 1),
        parts=parts,
        body=checked.raw("body", most=PIECE),
    )


class BodyJoiner:
    """Puts bodies together whose parts come one after the other."""

    __slots__ = ("_pieces", "_which", "broken")

    def __init__(self) -> None:
        self._pieces: dict[str, list[bytes]] = {}
        self._which: dict[str, tuple[str, int, int]] = {}
        self.broken = 0
        """Bodies of which a part did not come."""

    def add(self, found: Envelope) -> bytes | None:
        """Return a body that is whole now, else None."""
        if found.parts == 1:
            return found.body
        which = found.run, found.number, found.parts
        pieces = self._pieces.get(found.name, [])
        if self._which.get(found.name) != which or len(pieces) != found.part:
            self.broken += bool(pieces) or found.part != 0
            pieces = []
            self._pieces[found.name], self._which[found.name] = pieces, which
            if found.part:
                return None
        pieces.append(found.body)
        if len(pieces) < found.parts:
            return None
        del self._pieces[found.name], self._which[found.name]
        return b"".join(pieces)
