"""Where the chunks of a recording lie, and what each holds: the heads of its records alone are read.

A chunk's head says when its first and its last message came, and the index behind it which channels it has. So a file
of hours is known in a fraction of a second, also one that was cut off and has no summary: 60 bytes for each quarter of
a second of it are kept.
"""

import struct
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, Final

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk

from eitskin_proto.files.reading import opened
from eitskin_tools.recording.channels import TOPICS
from eitskin_tools.recording.layout import REFERENCE
from eitskin_tools.recording.reader import (
    LARGEST_RECORD,
    LARGEST_RECORDING,
    MOST_ATTACHED,
    UNREADABLE,
    Entry,
    check_magic,
    entry_of,
    unpacked,
)

RECORD: Final = struct.Struct("<BQ")
"""Opcode and length, before each record."""

SPAN: Final = struct.Struct("<QQ")
"""How a chunk begins: log times of its first and its last message."""

INDEX: Final = struct.Struct("<HI")
"""How an index begins: its channel, and the bytes of its entries."""


@dataclass(frozen=True, slots=True)
class Place:
    """One chunk."""

    at: int
    """Where its content begins in the file."""
    length: int
    start_ns: int
    end_ns: int
    """Wall clock of its first and its last message."""


class Places:
    """All chunks of a recording, in their order.

    Args:
        path: Of the file.

    Raises:
        RecordingError: It is no MCAP file.
        OSError: It cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.chunks: list[Place] = []
        self.attached: dict[str, bytes] = {}
        """References by name."""
        self.cut = True
        """The file ends before its own end."""
        self.damaged = 0
        """Readings of chunks that cannot be read."""
        self._having: dict[int, list[int]] = {}
        self._names = dict(TOPICS)
        with opened(path, LARGEST_RECORDING) as stream:
            check_magic(stream, path)
            size = stream.seek(0, 2)
            stream.seek(8)
            self._scan(stream, size)

    def _scan(self, stream: BinaryIO, size: int) -> None:
        while len(head := stream.read(RECORD.size)) == RECORD.size:
            opcode, length = RECORD.unpack(head)
            at = stream.tell()
            if length > LARGEST_RECORD or at + length > size:
                return
            if opcode in (Opcode.DATA_END, Opcode.FOOTER):
                self.cut = False
                return
            if opcode == Opcode.CHUNK and length >= SPAN.size:
                self.chunks.append(Place(at, length, *SPAN.unpack(stream.read(SPAN.size))))
            elif opcode == Opcode.MESSAGE_INDEX and length >= INDEX.size and self.chunks:
                channel, entries = INDEX.unpack(stream.read(INDEX.size))
                if entries:
                    self._having.setdefault(channel, []).append(len(self.chunks) - 1)
            elif opcode == Opcode.ATTACHMENT and len(self.attached) < MOST_ATTACHED:
                self._attach(stream.read(length))
            elif opcode == Opcode.CHANNEL:
                self._name(stream.read(length))
            stream.seek(at + length)

    def _attach(self, data: bytes) -> None:
        try:
            found = Attachment.read(ReadDataStream(BytesIO(data)))
        except UNREADABLE:
            return
        if found.name.startswith(REFERENCE):
            self.attached[found.name] = found.data

    def _name(self, data: bytes) -> None:
        try:
            found = Channel.read(ReadDataStream(BytesIO(data)))
        except UNREADABLE:
            return
        self._names[found.id] = found.topic

    def having(self, topic: str) -> list[int]:
        """Return the numbers of the chunks with messages of a channel; all, where the file has no index."""
        if not self._having:
            return list(range(len(self.chunks)))
        channels = [number for number, name in self._names.items() if name == topic]
        found = [self._having.get(number, []) for number in channels]
        return found[0] if len(found) == 1 else sorted({chunk for some in found for chunk in some})

    def between(self, begin_ns: int, end_ns: int) -> list[int]:
        """Return the numbers of the chunks that may hold messages of a span, on the wall clock."""
        return [k for k, one in enumerate(self.chunks) if one.end_ns >= begin_ns and one.start_ns <= end_ns]

    def read(self, number: int) -> list[Entry]:
        """Return the messages of a chunk; none of one that is damaged.

        Args:
            number: Of the chunk.

        Raises:
            OSError: The file cannot be read any more.
        """
        place = self.chunks[number]
        with opened(self.path, LARGEST_RECORDING) as stream:
            stream.seek(place.at)
            data = stream.read(place.length)
        try:
            found = unpacked(Chunk.read(ReadDataStream(BytesIO(data))))
        except UNREADABLE:
            self.damaged += 1
            return []
        entries: list[Entry] = []
        for one in found:
            if isinstance(one, Channel):
                self._names[one.id] = one.topic
            else:
                entries.extend(entry_of(one, self._names, None))
        return entries
