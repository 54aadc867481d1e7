"""Reads a recording: a whole one, one that was cut off anywhere, one of which a part is damaged.

The file is read from its beginning to its end, a chunk at a time; its summary is not needed. What ends before its time
ends the reading (``cut``); a chunk whose checksum is wrong is left out and counted (``damaged``). Sizes are bounded
before anything is unpacked, and nothing is executed.
"""

import struct
import zlib
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, Final

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Footer, McapRecord, Message, Metadata
from mcap.stream_reader import StreamReader

from eitskin_proto.files.plain import stated
from eitskin_proto.files.reading import opened
from eitskin_tools.recording.layout import FORMAT, HEAD, REFERENCE, TOPICS, VERSION, RecordingError

MAGIC: Final = b"\x89MCAP0\r\n"

LARGEST_RECORDING: Final = 1 << 40
LARGEST_RECORD: Final = 64 << 20
LARGEST_CHUNK: Final = 8 << 20
"""Bounds in bytes on what is read; a chunk of ours has about a megabyte."""

LATEST_NS: Final = (1 << 63) - 1
"""The year 2262: what arrays of times can hold."""

MOST_ATTACHED: Final = 1000
"""References that are kept."""

UNREADABLE: Final = (McapError, struct.error, ValueError, IndexError, OverflowError, zstandard.ZstdError, RuntimeError)
"""What the parts of the library raise at bytes that make no sense."""


@dataclass(frozen=True, slots=True)
class Entry:
    """One message of a recording."""

    topic: str
    log_ns: int
    """Wall clock."""
    sequence: int
    """Whatever the channel counts, modulo 2^32."""
    data: bytes


class _Bounded(BytesIO):
    """Hands on what is read, unless a length within a record says more than a record may have."""

    def __init__(self, stream: BinaryIO) -> None:
        super().__init__()
        self._from = stream

    def read(self, size: int | None = -1, /) -> bytes:
        """Return so many bytes, fewer at the end.

        Raises:
            ValueError: It is less than none, or more than :data:`LARGEST_RECORD`.
        """
        if size is None or not 0 <= size <= LARGEST_RECORD:
            raise ValueError(f"{size} bytes within a record")
        return self._from.read(size)


class Recording:
    """A recording that was looked at: head and attachments are known, messages are read anew each time.

    Args:
        path: Of the file.

    Raises:
        RecordingError: It is empty, no MCAP file, of another program, of a newer version, or ends before its head.
        FileError: It is no regular file.
        OSError: It cannot be read.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.head: dict[str, str] = {}
        """Metadata ``eitskin``."""
        self.attached: dict[str, bytes] = {}
        """Attachments met so far, by name; all of them behind a reading to the end."""
        self.cut = False
        """The last reading ended before the file's own end."""
        self.damaged = 0
        """Chunks that the last reading left out."""
        for _ in self._records():
            if self.head:
                break
        if not self.head:
            raise RecordingError(
                f"{path} holds no recording of a skin: expected a file made by 'eitskin record'"
                + ("; this one ends before it says what it is" if self.cut else "; this is another program's MCAP file")
            )
        self._check_version()

    def _check_version(self) -> None:
        found, version = self.head.get("format"), self.head.get("version", "")
        if found != FORMAT:
            raise RecordingError(f"{self.path}: format is {stated(found)}, expected {FORMAT}")
        if not version.isdecimal() or not 1 <= int(version[:9]) <= VERSION:
            raise RecordingError(
                f"{self.path} is a recording of version {stated(version)}, this release reads up to {VERSION}; install "
                "the release that made it"
            )

    @property
    def wall_minus_host_ns(self) -> int:
        """What is taken from ``log_ns`` to come to the host's own clock.

        Raises:
            RecordingError: The head does not say.
        """
        try:
            return int(self.head["wall_minus_host_ns"])
        except (KeyError, ValueError):
            raise RecordingError(f"{self.path} does not say how its clocks compare; record anew") from None

    def entries(
        self, topics: Collection[str] | None = None, from_ns: int | None = None, to_ns: int | None = None
    ) -> Iterator[Entry]:
        """Yield messages in the order in which they came.

        Args:
            topics: Of these channels only; None for all.
            from_ns: Leave chunks out that end before this, on the wall clock.
            to_ns: Leave chunks out that begin after this.

        Raises:
            OSError: The file cannot be read.
        """
        names = dict(TOPICS)
        for record in self._records():
            if isinstance(record, Chunk):
                outside = (from_ns is not None and record.message_end_time < from_ns) or (
                    to_ns is not None and record.message_start_time > to_ns
                )
                for inner in self._unpacked(record, channels_only=outside):
                    if isinstance(inner, Channel):
                        names[inner.id] = inner.topic
                    else:
                        yield from entry_of(inner, names, topics)
            elif isinstance(record, Channel):
                names[record.id] = record.topic
            elif isinstance(record, Message):
                yield from entry_of(record, names, topics)

    def _records(self) -> Iterator[McapRecord]:
        """Yield what the file is made of, chunks as they are; keeps head and attachments."""
        self.cut, self.damaged = True, 0
        with opened(self.path, LARGEST_RECORDING) as stream:
            check_magic(stream, self.path)
            records = StreamReader(
                _Bounded(stream), skip_magic=True, emit_chunks=True, record_size_limit=LARGEST_RECORD
            ).records
            while True:
                try:
                    record = next(records, None)
                except UNREADABLE:
                    return
                if record is None:
                    return
                if isinstance(record, Metadata):
                    if record.name == HEAD and not self.head:
                        self.head = record.metadata
                elif isinstance(record, Attachment) and record.name.startswith(REFERENCE):
                    if len(self.attached) < MOST_ATTACHED:
                        self.attached[record.name] = record.data
                elif isinstance(record, Footer):
                    self.cut = False  # its magic follows, and whoever comes so far has everything
                    yield record
                    return
                yield record

    def _unpacked(self, chunk: Chunk, *, channels_only: bool) -> Iterator[Channel | Message]:
        """Yield channels and messages of a chunk, all or none: of a damaged one nothing is believed."""
        try:
            found = unpacked(chunk, channels_only=channels_only)
        except UNREADABLE:
            self.damaged += 1
            return
        yield from found


def unpacked(chunk: Chunk, *, channels_only: bool = False) -> list[Channel | Message]:
    """Return channels and messages of a chunk.

    Args:
        chunk: As it stands in the file.
        channels_only: Leave messages out.

    Raises:
        Exception: One of ``UNREADABLE``: it is damaged, or too large.
    """
    return list(_inner(_bytes_of(chunk), channels_only=channels_only))


def check_magic(stream: BinaryIO, path: Path) -> None:
    """Read how every MCAP file begins.

    Raises:
        RecordingError: It is empty, or begins otherwise.
    """
    found = stream.read(len(MAGIC))
    if not found:
        raise RecordingError(f"{path} is empty, expected a recording; whatever made it wrote nothing")
    if found != MAGIC[: len(found)]:
        raise RecordingError(
            f"{path} is no MCAP file: it begins with {stated(found)}, expected a file made by 'eitskin record'"
        )


def entry_of(message: Message, names: Mapping[int, str], topics: Collection[str] | None) -> Iterator[Entry]:
    """Yield a message, if it is of a channel that is known and asked for, and its time is one of this era."""
    topic = names.get(message.channel_id)
    if topic is not None and (topics is None or topic in topics) and message.log_time <= LATEST_NS:
        yield Entry(topic, message.log_time, message.sequence, message.data)


def _bytes_of(chunk: Chunk) -> bytes:
    """Return what a chunk holds, unpacked and held against its checksum.

    Raises:
        ValueError: It is too large, packed in another way, or damaged.
    """
    size = chunk.uncompressed_size
    if size > LARGEST_CHUNK:
        raise ValueError(f"a chunk of {size} bytes")
    if chunk.compression == "zstd":
        if zstandard.frame_content_size(chunk.data) > size:
            raise ValueError("a chunk that says two sizes")
        data = zstandard.ZstdDecompressor().decompress(chunk.data, max_output_size=size)
    elif chunk.compression == "lz4":
        from lz4.frame import LZ4FrameDecompressor

        data = LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
    elif not chunk.compression:
        data = chunk.data
    else:
        raise ValueError(f"compression {chunk.compression!r}")
    if len(data) != size or (chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc):
        raise ValueError("a damaged chunk")
    return data


def _inner(data: bytes, *, channels_only: bool) -> Iterator[Channel | Message]:
    stream = ReadDataStream(BytesIO(data))
    while stream.count < len(data):
        opcode, length = stream.read1(), stream.read8()
        end = stream.count + length
        if end > len(data):
            raise ValueError("a record beyond its chunk")
        if opcode == Opcode.CHANNEL:
            yield Channel.read(stream)
        elif opcode == Opcode.MESSAGE:
            if not channels_only:
                yield Message.read(stream, length)
        elif opcode != Opcode.SCHEMA:  # a kilobyte can unpack to millions of what means nothing
            raise ValueError(f"a record of kind {opcode} within a chunk")
        stream.read(end - stream.count)
