"""A file that is written to its end although the disk is full: a reserve is kept for that, and given up when needed.

The reserve is a second file without a name: whatever ends this process frees it. When the disk is full it is closed,
and what was being written is finished in the room that it leaves. One reserve serves all files of a series.

A file gets its name when its head is in it, so that nobody ever finds one that does not say what it is, whenever this
process is killed.
"""

import errno
import os
import tempfile
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import IO, Final

from eitskin_proto.files.writing import check_target
from eitskin_tools.recording.layout import RecordingError

RESERVE_BYTES: Final = 8 << 20
"""Room for the last chunk, and for the summary of a file of a day."""

FULL: Final = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""What the system says when there is no room."""

NEW: Final = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC | os.O_NOFOLLOW
NAMELESS: Final = os.O_WRONLY | os.O_TMPFILE | os.O_CLOEXEC


class Reserve:
    """Room that is held until somebody needs it.

    Args:
        folder: On the disk in question.
        size: Bytes.

    Raises:
        RecordingError: There is not so much.
        OSError: It cannot be held.
    """

    def __init__(self, folder: Path, size: int = RESERVE_BYTES) -> None:
        self._file: IO[bytes] | None = tempfile.TemporaryFile(dir=folder, buffering=0)  # noqa: SIM115 -- kept open
        try:
            os.posix_fallocate(self._file.fileno(), 0, size)
        except OSError as error:
            self.give_up()
            if error.errno in FULL:
                raise RecordingError(
                    f"{folder} has less than {size >> 20} MB left; free some, or name another place"
                ) from error
            raise

    @property
    def held(self) -> bool:
        """Whether it has not been given up yet."""
        return self._file is not None

    def give_up(self) -> None:
        """Free it; twice is fine."""
        found, self._file = self._file, None
        if found is not None:
            found.close()


class Sink:
    """A new file, written without a buffer of its own; has what :class:`mcap.writer.Writer` needs of a stream.

    What is written before ``begin`` waits for it.

    Args:
        path: Of the file, which must not be there.

    Raises:
        RecordingError: It is there.
        FileError: It is no file.
    """

    def __init__(self, path: Path) -> None:
        self.path = check_target(path)
        self.full = False
        """The reserve is being used: end the file now."""
        self.bytes = 0
        """Written so far."""
        self._reserve: Reserve | None = None
        self._head, self._begun = bytearray(), False
        self._handle = -1
        self._asked, self._closing = threading.Event(), False
        self._failed: OSError | None = None
        self._thread = threading.Thread(target=self._sync, name="recording-sync", daemon=True)
        if os.path.lexists(self.path):
            raise self._is_there()

    def begin(self, reserve: Reserve | None = None) -> None:
        """Make the file, with what was written so far.

        Args:
            reserve: See above; whoever made it gives it up in the end.

        Raises:
            RecordingError: It is there.
            OSError: It cannot be made.
        """
        self._reserve, self._begun = reserve, True
        try:
            self._with_room(self._make)
        except FileExistsError:
            raise self._is_there() from None
        self._thread.start()

    def _make(self) -> None:
        """Make the file and name it when the head is in it; where every file has a name, name it before."""
        try:
            self._handle = self._headed(os.open(self.path.parent, NAMELESS, 0o666))
        except OSError as error:
            if error.errno in (*FULL, errno.EEXIST):
                raise
            self._handle = self._headed(os.open(self.path, NEW, 0o666), named=True)

    def _headed(self, handle: int, *, named: bool = False) -> int:
        """Write the head into a file that was opened, name it, and return it; of one that cannot be, leave nothing."""
        try:
            rest = memoryview(self._head)
            while rest:
                rest = rest[os.write(handle, rest) :]
            if not named:  # a folder is stated, since os.link follows no link without one
                os.link(f"/proc/self/fd/{handle}", self.path.absolute(), src_dir_fd=0, follow_symlinks=True)
        except OSError:
            os.close(handle)
            if named:
                self.path.unlink()
            raise
        return handle

    def _is_there(self) -> RecordingError:
        return RecordingError(f"{self.path} exists already; name another file, or move it away")

    def _with_room(self, write: Callable[[], int | None]) -> int:
        """Write, if need be into the room of the reserve, and return how much it was."""
        while True:
            try:
                return write() or 0
            except OSError as error:
                if error.errno not in FULL or self._reserve is None or not self._reserve.held:
                    raise
            self.full = True
            self._reserve.give_up()

    def write(self, data: bytes) -> int:
        """Write all of ``data``, if need be into the room of the reserve.

        Raises:
            OSError: It cannot be written, or even the reserve is used up.
        """
        if not self._begun:
            self._head += data
            self.bytes += len(data)
            return len(data)
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

    def sync_soon(self) -> None:
        """Have everything written forced onto the disk, by a thread of its own: a busy disk takes a second for that.

        Raises:
            OSError: It could not be, the last time.
        """
        failed, self._failed = self._failed, None
        if failed is not None:
            raise failed
        self._asked.set()

    def _sync(self) -> None:
        """Force the head onto the disk, then the name, content whenever asked; at the end all, and close the file."""
        with suppress(OSError):
            os.fsync(self._handle)
            _sync_folder(self.path.parent)
        while not self._closing:
            self._asked.wait()
            self._asked.clear()
            if not self._closing:
                try:
                    os.fdatasync(self._handle)
                except OSError as error:
                    self._failed = error
        try:
            os.fsync(self._handle)
        except OSError as error:
            self._failed = error
        os.close(self._handle)

    def close(self, *, wait: bool = True) -> None:
        """End the file, which takes no more; closing twice is fine.

        Args:
            wait: Until it is on the disk; else that is done behind, and closing again waits.

        Raises:
            OSError: It could not be forced onto the disk.
        """
        if self._handle < 0:
            return
        self._closing = True
        self._asked.set()
        if wait:
            self._thread.join()
            self._handle = -1
            if self._failed is not None:
                raise self._failed


def _sync_folder(folder: Path) -> None:
    """Force the names in a folder onto the disk."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
