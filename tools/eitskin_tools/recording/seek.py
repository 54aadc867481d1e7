"""Reads any part of a recording without reading what comes before it.

:class:`ChunkIndex` reads the heads of the file's records alone. A chunk's head says when its first and its last message
came, and the index behind it which channels it has. So a file of hours is known in a fraction of a second, even without
a summary: 60 bytes for each quarter of a second are kept.

:class:`SeekableRecording` returns a part: its frames, what was published of them, and what held at its beginning. It
keeps the clouds and conditions that were read last, so its memory does not grow with the file.
"""

import struct
from collections import OrderedDict
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from hashlib import sha256
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, Final

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk

from eitskin.errors import FrameError
from eitskin.messaging.streams.measured import CloudInUse, Conditions, WireFrame
from eitskin_proto.files.reading import opened
from eitskin_tools.recording.codec import unpack_json
from eitskin_tools.recording.layout import CLOUD, CONDITIONS, FRAME, REFERENCE, TOPICS, WIRE, RecordingError
from eitskin_tools.recording.reader import (
    LARGEST_RECORD,
    LARGEST_RECORDING,
    MOST_ATTACHED,
    UNREADABLE,
    Entry,
    Recording,
    check_magic,
    entry_of,
    unpacked,
)
from eitskin_tools.recording.script import RecordedHead, Step, step_of

RECORD: Final = struct.Struct("<BQ")
"""Opcode and length, before each record."""

SPAN: Final = struct.Struct("<QQ")
"""How a chunk begins: log times of its first and its last message."""

INDEX: Final = struct.Struct("<HI")
"""How an index begins: its channel, and the bytes of its entries."""


@dataclass(frozen=True, slots=True)
class ChunkPlace:
    """One chunk."""

    at: int
    """Where its content begins in the file."""
    length: int
    start_ns: int
    end_ns: int
    """Wall clock of its first and its last message."""


class ChunkIndex:
    """All chunks of a recording, in their order.

    Args:
        path: Of the file.

    Raises:
        RecordingError: It is no MCAP file.
        OSError: It cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.chunks: list[ChunkPlace] = []
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
                self.chunks.append(ChunkPlace(at, length, *SPAN.unpack(stream.read(SPAN.size))))
            elif opcode == Opcode.MESSAGE_INDEX and length >= INDEX.size and self.chunks:
                channel, entries = INDEX.unpack(stream.read(INDEX.size))
                if entries:
                    self._having.setdefault(channel, []).append(len(self.chunks) - 1)
            elif opcode == Opcode.ATTACHMENT and len(self.attached) < MOST_ATTACHED:
                with suppress(*UNREADABLE):
                    found = Attachment.read(ReadDataStream(BytesIO(stream.read(length))))
                    if found.name.startswith(REFERENCE):
                        self.attached[found.name] = found.data
            elif opcode == Opcode.CHANNEL:
                with suppress(*UNREADABLE):
                    named = Channel.read(ReadDataStream(BytesIO(stream.read(length))))
                    self._names[named.id] = named.topic
            stream.seek(at + length)

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


MOST_KEPT: Final = 256
"""Clouds, and conditions, that are kept: some megabytes."""

FARTHEST: Final = 16
"""Chunks that are looked at for what held; the one before the frame has it, unless it is damaged."""


@dataclass(frozen=True, slots=True)
class Span:
    """Some of a recording."""

    steps: tuple[Step, ...]
    """The frames of the wire; the first of which it is known has all that held then."""
    notes: dict[int, dict[str, Any]]
    """What was published, by the number of the published frame; as far as it was recorded."""


class SeekableRecording(RecordedHead):
    """A recording that is looked at here and there.

    Args:
        path: Of the file.

    Raises:
        RecordingError: It cannot be used, or holds no frame.
        MismatchError: It is of another protocol.
        OSError: It cannot be read.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(Recording(path))
        self._places = ChunkIndex(path)
        self._references = {sha256(data).hexdigest(): data for data in self._places.attached.values()}
        self._clouds = _ByRevision(CloudInUse.of)
        self._conditions = _ByRevision(Conditions.of)
        first, last = self._end(1), self._end(-1)
        if first is None or last is None:
            raise RecordingError(f"{path} holds no frame of the wire{self.ending}")
        self.first_ns, self.last_ns = first, last
        """Wall clock of the first and the last frame."""

    @property
    def ending(self) -> str:
        """What is wrong with the file's end or middle, as a clause; "" if nothing is."""
        found = "; it was cut off, what is there ends before its time" if self._places.cut else ""
        return found + ("; damaged chunks are left out" if self._places.damaged else "")

    @property
    def seconds(self) -> float:
        """From the first frame to the last."""
        return max(self.last_ns - self.first_ns, 0) * 1e-9

    def _end(self, way: int) -> int | None:
        for number in self._places.having(WIRE.topic)[::way]:
            if found := [entry.log_ns for entry in self._read(number) if entry.topic == WIRE.topic]:
                return found[0] if way > 0 else found[-1]
        return None

    def reference(self) -> bytes:
        """Return what the first frame is held against of which that is known, as in :class:`RecordedHead`."""
        for number in self._places.having(WIRE.topic):
            for entry in self._read(number):
                if entry.topic == WIRE.topic and (found := self._reference_of(entry, number)) is not None:
                    return found
        raise RecordingError(f"{self.path} lacks its reference{self.ending}; record a runtime that has one")

    def span(self, from_s: float, to_s: float) -> Span:
        """Return a part.

        Args:
            from_s: Its beginning, after the first frame.
            to_s: Its end, which belongs to the next part.

        Raises:
            OSError: The file cannot be read any more.
        """
        begin_ns, end_ns = self.first_ns + round(from_s * 1e9), self.first_ns + round(to_s * 1e9)
        steps: list[Step] = []
        notes: dict[int, dict[str, Any]] = {}
        before: Conditions | None = None
        for number in self._places.between(begin_ns, end_ns):
            for entry in self._read(number):
                if entry.topic not in (WIRE.topic, FRAME.topic) or not begin_ns <= entry.log_ns < end_ns:
                    continue
                try:
                    if entry.topic == FRAME.topic:
                        note = unpack_json(entry.data)
                        notes[int(note["number"])] = note
                        continue
                    frame = WireFrame.of(entry.data, n=entry.sequence)
                except (FrameError, RecordingError, KeyError, TypeError, ValueError, OverflowError):
                    continue
                now = self._held(self._conditions, CONDITIONS.topic, frame.conditions, number)
                steps.append(self._step(frame, entry.log_ns, now, before, number))
                before = now if steps[-1].known else before
        return Span(tuple(steps), notes)

    def _reference_of(self, entry: Entry, number: int) -> bytes | None:
        """Return what a frame is held against; None where the recording lacks some of what it met."""
        try:
            frame = WireFrame.of(entry.data, n=entry.sequence)
        except FrameError:
            return None
        now = self._held(self._conditions, CONDITIONS.topic, frame.conditions, number)
        return self._step(frame, entry.log_ns, now, None, number).reference

    def _step(
        self, frame: WireFrame, log_ns: int, now: Conditions | None, before: Conditions | None, number: int
    ) -> Step:
        def cloud_of(revision: int) -> CloudInUse | None:
            found: CloudInUse | None = self._held(self._clouds, CLOUD.topic, revision, number)
            return found

        return step_of(frame, log_ns, now, before, cloud_of, self._references.get)

    def _held(self, kept: "_ByRevision", topic: str, revision: int, number: int) -> Any:
        """Return what had a revision when a chunk was written; None where it is not there any more."""
        if (found := kept.get(revision)) is not None:
            return found
        having = [one for one in self._places.having(topic) if one <= number]
        for one in having[: -FARTHEST - 1 : -1]:
            self._read(one)
            if (found := kept.get(revision)) is not None:
                return found
        return None

    def _read(self, number: int) -> list[Entry]:
        """Return the messages of a chunk, having kept what lasts."""
        entries = self._places.read(number)
        for entry in entries:
            if entry.topic == CLOUD.topic:
                self._clouds.take(entry.data)
            elif entry.topic == CONDITIONS.topic:
                self._conditions.take(entry.data)
        return entries


class _ByRevision:
    """What has a revision, the newest of it."""

    def __init__(self, made: Callable[[bytes], Any]) -> None:
        self._made, self._found = made, OrderedDict[int, Any]()

    def take(self, data: bytes) -> None:
        try:
            found = self._made(data)
        except FrameError:
            return
        if found.revision not in self._found:  # the same one stays the same object, which says that nothing changed
            self._found[found.revision] = found
        self._found.move_to_end(found.revision)
        while len(self._found) > MOST_KEPT:
            self._found.popitem(last=False)

    def get(self, revision: int) -> Any:
        return self._found.get(revision)
