"""Reads a recording, also one that was cut off anywhere or is damaged in part.

The reader reads the heads of the file's records once. A chunk's head has the times of its first and last messages, and
the index behind it has its channels. So it keeps 60 bytes for each quarter of a second, and finds any part without the
file's summary. A file that was cut off is read to its end (``cut``); a chunk whose checksum is wrong is left out and
counted (``damaged``). Nothing is executed.

Time and memory are in proportion to the size of the file: the reader bounds what a chunk unpacks to and how many
records it has before it looks at them.
"""

import struct
import zlib
from collections.abc import Collection, Iterator
from contextlib import suppress
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, Final

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Metadata

from eitskin_proto.files.plain import stated
from eitskin_proto.files.reading import opened
from eitskin_tools.recording.layout import FORMAT, HEAD, REFERENCE, TOPICS, VERSION, RecordingError

MAGIC: Final = b"\x89MCAP0\r\n"

LARGEST_RECORDING: Final = 1 << 40
LARGEST_CHUNK: Final = 8 << 20
LARGEST_TEXT: Final = 1 << 20
"""Bounds in bytes on what is read: a chunk, packed or not, has about a megabyte; a reference has 10 kB."""

MOST_PACKED: Final = 500
"""Times that a chunk may be larger than packed; those of a skin are 3 to 5 times larger, and 160 times if they consist
of pictures of an untouched sheet."""

MOST_RECORDS: Final = 20_000
"""Records in a chunk; a quarter of a second has a thousand."""

MOST_NAMED: Final = 1000
"""Of these, schemas and channels; a file has eight of each."""

LATEST_NS: Final = (1 << 63) - 1
"""The year 2262: what arrays of times can hold."""

MAX_ATTACHED: Final = 1000
"""References that are kept."""

RECORD_HEAD: Final = struct.Struct("<BQ")
"""Opcode and length, before each record."""

CHUNK_TIMES: Final = struct.Struct("<QQ")
"""How a chunk begins: log times of its first and its last message."""

INDEX_HEAD: Final = struct.Struct("<HI")
"""How an index begins: its channel, and the bytes of its entries."""

MESSAGE_HEAD: Final = struct.Struct("<HIQQ")
"""How a message begins: channel, sequence, log time, publish time."""

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


@dataclass(frozen=True, slots=True)
class ChunkPlace:
    """One chunk."""

    at: int
    """Where its content begins in the file."""
    length: int
    start_ns: int
    end_ns: int
    """Wall clock of its first and its last message."""


class Recording:
    """A recording of which head, attachments and the places of its chunks are known; messages are read each time.

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
        """References by name."""
        self.chunks: list[ChunkPlace] = []
        """In their order."""
        self.cut = True
        """The file ends before its own end."""
        self._damaged: set[int] = set()
        self._having: dict[int, list[int]] = {}
        self._names = dict(TOPICS)
        with opened(self.path, LARGEST_RECORDING) as stream:
            check_magic(stream, self.path)
            size = stream.seek(0, 2)
            stream.seek(len(MAGIC))
            self._scan(stream, size)
        if not self.head:
            raise RecordingError(
                f"{path} holds no recording of a skin: expected a file made by 'eitskin record'"
                + ("; this one ends within its header" if self.cut else "; this is another program's MCAP file")
            )
        self._check_version()

    def _scan(self, stream: BinaryIO, size: int) -> None:
        """Read the heads of the file's records: a file of hours is known in a fraction of a second."""
        while len(head := stream.read(RECORD_HEAD.size)) == RECORD_HEAD.size:
            opcode, length = RECORD_HEAD.unpack(head)
            at = stream.tell()
            if at + length > size:
                return
            if opcode == Opcode.FOOTER:
                self.cut = False
                return
            if opcode == Opcode.CHUNK and length >= CHUNK_TIMES.size:
                self.chunks.append(ChunkPlace(at, length, *CHUNK_TIMES.unpack(stream.read(CHUNK_TIMES.size))))
            elif opcode == Opcode.MESSAGE_INDEX and length >= INDEX_HEAD.size and self.chunks:
                channel, entries = INDEX_HEAD.unpack(stream.read(INDEX_HEAD.size))
                if entries:
                    self._having.setdefault(channel, []).append(len(self.chunks) - 1)
            elif opcode in (Opcode.METADATA, Opcode.ATTACHMENT, Opcode.CHANNEL) and length <= LARGEST_TEXT:
                with suppress(*UNREADABLE):
                    self._read_metadata(opcode, ReadDataStream(BytesIO(stream.read(length))))
            stream.seek(at + length)

    def _read_metadata(self, opcode: int, record: ReadDataStream) -> None:
        """Keep the head, a reference, or the name of a channel."""
        if opcode == Opcode.METADATA:
            metadata = Metadata.read(record)
            if metadata.name == HEAD and not self.head:
                self.head = metadata.metadata
        elif opcode == Opcode.ATTACHMENT:
            attachment = Attachment.read(record)
            if attachment.name.startswith(REFERENCE) and len(self.attached) < MAX_ATTACHED:
                self.attached[attachment.name] = attachment.data
        else:
            channel = Channel.read(record)
            self._names[channel.id] = channel.topic

    @property
    def damaged(self) -> int:
        """Chunks that were left out so far."""
        return len(self._damaged)

    def _check_version(self) -> None:
        found, version = self.head.get("format"), self.head.get("version", "")
        if found != FORMAT:
            raise RecordingError(f"{self.path}: format is {stated(found)}, expected {FORMAT}")
        if not version.isdecimal() or not 1 <= int(version[:9]) <= VERSION:
            raise RecordingError(
                f"{self.path} is a recording of version {stated(version)}, this release reads up to {VERSION}; install "
                "the release that made it"
            )

    def entries(self, topics: Collection[str] | None = None, to_ns: int = LATEST_NS) -> Iterator[Entry]:
        """Yield messages in the order in which they came.

        Args:
            topics: Of these channels only; None for all.
            to_ns: Leave chunks out that begin after this, on the wall clock.

        Raises:
            OSError: The file cannot be read.
        """
        for number in self.between(0, to_ns):
            yield from (entry for entry in self.read(number) if topics is None or entry.topic in topics)

    def between(self, begin_ns: int, end_ns: int) -> list[int]:
        """Return the numbers of the chunks that may hold messages of a span, on the wall clock."""
        return [k for k, one in enumerate(self.chunks) if one.end_ns >= begin_ns and one.start_ns <= end_ns]

    def having(self, topic: str) -> list[int]:
        """Return the numbers of the chunks with messages of a channel; all, where the file has no index."""
        if not self._having:
            return list(range(len(self.chunks)))
        channels = [number for number, name in self._names.items() if name == topic]
        return sorted({chunk for number in channels for chunk in self._having.get(number, [])})

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
            data = stream.read(min(place.length, LARGEST_CHUNK))
        try:
            return list(self._entries(unpacked(Chunk.read(ReadDataStream(BytesIO(data))))))
        except UNREADABLE:
            self._damaged.add(number)
            return []

    def _entries(self, data: bytes) -> Iterator[Entry]:
        """Yield the messages of a chunk's content.

        Raises:
            Exception: One of ``UNREADABLE``: a record makes no sense, or there are more than any recorder writes.
        """
        at = records = named = 0
        while at < len(data):
            opcode, length = RECORD_HEAD.unpack_from(data, at)
            begin, at, records = at + RECORD_HEAD.size, at + RECORD_HEAD.size + length, records + 1
            named += opcode != Opcode.MESSAGE
            if at > len(data) or records > MOST_RECORDS or named > MOST_NAMED:
                raise ValueError("a record beyond its chunk, or too many of them")
            if opcode == Opcode.MESSAGE:
                content = begin + MESSAGE_HEAD.size
                if content > at:
                    raise ValueError("a message without a head")
                channel_id, sequence, log_ns, _ = MESSAGE_HEAD.unpack_from(data, begin)
                if (topic := self._names.get(channel_id)) is not None and log_ns <= LATEST_NS:
                    yield Entry(topic, log_ns, sequence, data[content:at])
            elif opcode == Opcode.CHANNEL:
                channel = Channel.read(ReadDataStream(BytesIO(data[begin:at])))
                self._names[channel.id] = channel.topic
            elif opcode != Opcode.SCHEMA:
                raise ValueError(f"a record of kind {opcode} within a chunk")


def check_magic(stream: BinaryIO, path: Path) -> None:
    """Read how every MCAP file begins.

    Raises:
        RecordingError: It is empty, or begins otherwise.
    """
    found = stream.read(len(MAGIC))
    if not found:
        raise RecordingError(f"{path} is empty, expected a recording")
    if found != MAGIC[: len(found)]:
        raise RecordingError(
            f"{path} is not an MCAP file: it begins with {stated(found)}, expected a file made by 'eitskin record'"
        )


def unpacked(chunk: Chunk) -> bytes:
    """Return the content of a chunk, checked against its checksum.

    Raises:
        Exception: One of ``UNREADABLE``: it is too large, packed in another way, or damaged.
    """
    size = chunk.uncompressed_size
    if size > min(LARGEST_CHUNK, MOST_PACKED * max(len(chunk.data), 100)):
        raise ValueError(f"a chunk that unpacks from {len(chunk.data)} to {size} bytes")
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
