"""Writes recordings to disk, one file or a series, complete even if the disk is full.

A chunk is written at least every ``FLUSH_S`` and forced onto the disk at once; a summary follows at the end. A file
that a kill or a power cut ends has everything up to its last chunk (:mod:`eitskin_tools.recording.reader`).

:class:`Series` goes on in a new file when one is large or old enough; each can be read by itself. A new file begins
with a frame of the wire, and none is ended before it has one. A file that exists is never overwritten: the next one
takes the next free number.

:class:`Reserve` is a second file without a name, so that the end of this process frees it. When the disk is full the
reserve is closed, and its space takes the last chunk and the summary.
"""

import errno
import os
import tempfile
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO, Final

from mcap.writer import Writer

from eitskin_proto.files.writing import check_target
from eitskin_tools.recording.layout import CHANNELS, FORMAT, HEAD, VERSION, WIRE, Channel, RecordingError

RESERVE_BYTES: Final = 8 << 20
"""Room for the last chunk, and for the summary of a file of a day."""

DISK_FULL_ERRNOS: Final = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""What the system says when there is no room."""

CREATE_FLAGS: Final = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC | os.O_NOFOLLOW


class Reserve:
    """Disk space that is reserved until it is needed.

    Args:
        folder: On the disk in question.

    Raises:
        RecordingError: The disk has less space.
        OSError: The space cannot be reserved.
    """

    def __init__(self, folder: Path) -> None:
        self._file: IO[bytes] | None = tempfile.TemporaryFile(dir=folder, buffering=0)  # noqa: SIM115 -- kept open
        try:
            os.posix_fallocate(self._file.fileno(), 0, RESERVE_BYTES)
        except OSError as error:
            self.release()
            if error.errno == errno.EFBIG:
                raise RecordingError(
                    f"this user may not write files of {RESERVE_BYTES >> 20} MB; allow larger ones with 'ulimit -f'"
                ) from error
            if error.errno in DISK_FULL_ERRNOS:
                raise RecordingError(
                    f"{folder} has less than {RESERVE_BYTES >> 20} MB left; free some, or name another place"
                ) from error
            raise

    @property
    def held(self) -> bool:
        """Whether it has not been given up yet."""
        return self._file is not None

    def release(self) -> None:
        """Free it; twice is fine."""
        found, self._file = self._file, None
        if found is not None:
            found.close()


FLUSH_S: Final = 0.25
"""Data of so long waits in memory, and is lost with the process."""

CHUNK_BYTES: Final = 1 << 20
"""A chunk may be smaller, for ``FLUSH_S``; more is written at once."""


class RecordingFile:
    """A new file, and the stream without a buffer that :class:`mcap.writer.Writer` writes into; end it with ``close``.

    Args:
        path: Of the file, which must not be there.
        head: Of the metadata: ids, host, clock offset.
        reserve: See :mod:`eitskin_tools.recording.writer`; its maker removes it.
        now_s: The clock of ``FLUSH_S``.

    Raises:
        RecordingError: It is there.
        FileError: It is no file.
        OSError: It cannot be made.
    """

    def __init__(self, path: Path, head: Mapping[str, str], reserve: Reserve, now_s: Callable[[], float]) -> None:
        self.path = check_target(path)
        self.full = False
        """The reserve is being used: end the file now."""
        self.bytes = 0
        """Written so far."""
        self._reserve, self._now_s = reserve, now_s
        try:
            self._handle = self._with_room(lambda: os.open(self.path, CREATE_FLAGS, 0o666))
        except FileExistsError:
            raise RecordingError(f"{self.path} already exists: name another file, or move it away") from None
        _sync_folder(self.path.parent)
        self._writer = Writer(self, chunk_size=CHUNK_BYTES, enable_data_crcs=False)  # type: ignore[arg-type]
        try:
            self._writer.start(profile="", library="eitskin")
            self._writer.add_metadata(HEAD, {"format": FORMAT, "version": str(VERSION), **head})
        except OSError:
            os.close(self._handle)
            self.path.unlink()
            raise
        self._ids = {channel.topic: self._register(channel) for channel in CHANNELS}
        self._begun_s = self._flushed_s = now_s()

    @property
    def age_s(self) -> float:
        """Since it was made."""
        return self._now_s() - self._begun_s

    @property
    def due_s(self) -> float:
        """How long what is in memory may stay there yet; 0 where it is late."""
        return max(self._flushed_s + FLUSH_S - self._now_s(), 0.0)

    def _with_room(self, write: Callable[[], int]) -> int:
        """Write, if need be into the room of the reserve, and return what came of it."""
        while True:
            try:
                return write()
            except OSError as error:
                if error.errno not in DISK_FULL_ERRNOS or not self._reserve.held:
                    raise
            self.full = True
            self._reserve.release()

    def write(self, data: bytes) -> int:
        """Write all of ``data``, if need be into the room of the reserve.

        Raises:
            OSError: It cannot be written, or even the reserve is used up.
        """
        rest = memoryview(data)
        while rest:
            written = self._with_room(lambda: os.write(self._handle, rest))  # noqa: B023 -- called at once
            self.bytes += written
            rest = rest[written:]
        return len(data)

    def tell(self) -> int:
        """Return how much was written."""
        return self.bytes

    def flush(self) -> None:
        """Do nothing: nothing is held back."""

    def _register(self, channel: Channel) -> int:
        encoding = "jsonschema" if channel.schema else ""  # an empty schema is one: Rerun wants one of each channel
        schema = self._writer.register_schema(channel.schema_name, encoding, channel.schema.encode())
        return self._writer.register_channel(channel.topic, channel.encoding, schema)

    def attach(self, name: str, media_type: str, content: bytes, log_ns: int) -> None:
        """Write a file within the file."""
        self._writer.flush()  # type: ignore[no-untyped-call]  # what came before it stays before it
        self._writer.add_attachment(log_ns, log_ns, name, media_type, content)

    def add(self, channel: Channel, data: bytes, log_ns: int, sequence: int = 0) -> None:
        """Write a message.

        Args:
            channel: Its channel.
            data: In the channel's encoding.
            log_ns: Wall clock in ns.
            sequence: Whatever counts; kept modulo 2^32.

        Raises:
            OSError: It cannot be written, for another reason than a full disk.
        """
        self._writer.add_message(self._ids[channel.topic], log_ns, data, log_ns, sequence & 0xFFFFFFFF)
        if self.due_s == 0.0:
            self.sync()

    def sync(self) -> None:
        """End the chunk, and force it onto the disk.

        Raises:
            OSError: It cannot be written, for another reason than a full disk.
        """
        self._writer.flush()  # type: ignore[no-untyped-call]
        os.fdatasync(self._handle)
        self._flushed_s = self._now_s()

    def close(self) -> None:
        """Write the summary and end the file, once it is on the disk; closing twice is fine.

        Raises:
            OSError: It cannot be written, or not forced onto the disk; what came before can be read all the same.
        """
        if self._handle < 0:
            return
        try:
            self._writer.finish()  # type: ignore[no-untyped-call]
            os.fsync(self._handle)
        finally:
            handle, self._handle = self._handle, -1
            os.close(handle)


def _sync_folder(folder: Path) -> None:
    """Force the names in a folder onto the disk, where the system can."""
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def path_of(first: Path, number: int) -> Path:
    """Return the path of a file of a series: FILE.mcap, FILE.0002.mcap, FILE.0003.mcap, ..."""
    return first if number == 1 else first.with_name(f"{first.stem}.{number:04d}{first.suffix}")


class Series:
    """Writes one file after another.

    Args:
        first: Path of the first.
        head: Metadata of each.
        most_bytes: A file that has more is followed by another; None for no bound.
        most_s: The same for its age.
        now_s: The clock of ``FLUSH_S`` and of ``most_s``.

    Raises:
        RecordingError: The first file is there, or there is no room.
        OSError: It cannot be made.
    """

    def __init__(
        self,
        first: Path,
        head: Mapping[str, str],
        *,
        most_bytes: int | None = None,
        most_s: float | None = None,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._first, self._head = first, head
        self._most_bytes, self._most_s, self._now_s = most_bytes, most_s, now_s
        self._lasting: dict[str, tuple[Channel, bytes, int]] = {}
        self._attached: tuple[str, str, bytes] | None = None
        self.files: list[Path] = []
        """Made so far."""
        self._before = 0
        self._holds_frames = False
        """Whether there is one of the wire in the file in hand."""
        self._number = 1
        self._reserve = Reserve(first.parent)
        try:
            self._file = self._begin(first)
        except BaseException:
            self._reserve.release()
            raise

    @property
    def size(self) -> int:
        """Of all files."""
        return self._before + self._file.bytes

    @property
    def full(self) -> bool:
        """Whether the disk is full."""
        return self._file.full

    @property
    def due_s(self) -> float:
        """How long what is in memory may stay there yet; 0 where it is late."""
        return self._file.due_s

    @property
    def path(self) -> Path:
        """Of the file in hand."""
        return self._file.path

    def _begin_next(self) -> RecordingFile:
        while True:
            self._number += 1
            path = path_of(self._first, self._number)
            if os.path.lexists(path):
                continue
            try:
                return self._begin(path)
            except RecordingError:
                if not os.path.lexists(path):  # else another process made it just now
                    raise

    def _begin(self, path: Path) -> RecordingFile:
        head = {**self._head, "file": str(len(self.files) + 1)}
        file = RecordingFile(path, head, self._reserve, self._now_s)
        self.files.append(path)
        self._holds_frames = False
        return file

    def attach(self, name: str, media_type: str, content: bytes, log_ns: int) -> None:
        """Write a file within the file; the last one is in each file that follows."""
        self._attached = name, media_type, content
        self._file.attach(name, media_type, content, log_ns)

    def add(self, channel: Channel, data: bytes, log_ns: int, sequence: int = 0) -> None:
        """Write a message, a frame of the wire into a new file if it is time for one; nothing more on a full disk.

        Raises:
            OSError: It cannot be written, for another reason than a full disk.
        """
        if self.full:
            return
        if channel.lasts:
            self._lasting[channel.topic] = channel, data, sequence
        elif channel.topic == WIRE.topic:
            if self._holds_frames and self._is_time() and not self._next(log_ns):
                return
            self._holds_frames = True
        self._file.add(channel, data, log_ns, sequence)

    def begin_anew(self, head: Mapping[str, str]) -> None:
        """Continue in a new file with another head, of a restarted runtime, without the earlier state."""
        self._head, self._attached = head, None
        self._lasting.clear()
        self._next(0)

    def _is_time(self) -> bool:
        file = self._file
        if self._most_bytes is not None and file.bytes >= self._most_bytes:
            return True
        return self._most_s is not None and file.age_s >= self._most_s

    def _next(self, log_ns: int) -> bool:
        """End the file in hand and begin the next with whatever still holds.

        Returns:
            Whether there is a next one: not where the disk was full before.
        """
        before = self._file
        before.close()
        if before.full:
            return False
        self._before += before.bytes
        self._file = self._begin_next()
        if self._attached is not None:
            self._file.attach(*self._attached, log_ns)
        for channel, data, sequence in self._lasting.values():
            self._file.add(channel, data, log_ns, sequence)
        return True

    def sync(self) -> None:
        """Force everything onto the disk."""
        self._file.sync()

    def close(self) -> None:
        """End the file in hand; closing twice is fine.

        Raises:
            OSError: It could not be written, or not forced onto the disk.
        """
        try:
            self._file.close()
        finally:
            self._reserve.release()
