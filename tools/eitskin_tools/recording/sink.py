"""A file that is written to its end although the disk is full: a reserve is kept for that, and given up when needed.

The reserve is a second file without a name: whatever ends this process frees it. When the disk is full it is closed,
and what was being written is finished in the room that it leaves.
"""

import errno
import os
import tempfile
import threading
from contextlib import suppress
from pathlib import Path
from typing import IO, Final

from eitskin_proto.files.writing import check_target
from eitskin_tools.recording.layout import RecordingError

RESERVE_BYTES: Final = 8 << 20
"""Room for the last chunk, and for the summary of a file of a day."""

FULL: Final = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""What the system says when there is no room."""


class Sink:
    """A new file, written without a buffer of its own; has what :class:`mcap.writer.Writer` needs of a stream.

    Args:
        path: Of the file, which must not be there.
        reserve_bytes: See above.

    Raises:
        RecordingError: It is there, or there is not even room for the reserve.
        OSError: It cannot be made.
    """

    def __init__(self, path: Path, reserve_bytes: int = RESERVE_BYTES) -> None:
        self.path = check_target(path)
        self.full = False
        """The reserve is being used: end the file now."""
        self.bytes = 0
        """Written so far."""
        self._reserve: IO[bytes] | None = None
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC | os.O_NOFOLLOW
        try:
            self._handle = os.open(self.path, flags, 0o666)
        except FileExistsError:
            raise RecordingError(f"{path} exists already; name another file, or move it away") from None
        try:
            self._keep(reserve_bytes)
        except OSError as error:
            self._give_up_reserve()
            os.close(self._handle)
            self.path.unlink()
            if error.errno in FULL:
                raise RecordingError(
                    f"{path.parent} has less than {reserve_bytes >> 20} MB left; free some, or name another place"
                ) from error
            raise
        folder = os.open(self.path.parent, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            os.fsync(folder)  # the name is on disk before anything is in it
        finally:
            os.close(folder)
        self._asked, self._closing = threading.Event(), False
        self._failed: OSError | None = None
        self._thread = threading.Thread(target=self._sync, name="recording-sync", daemon=True)
        self._thread.start()

    def _keep(self, size: int) -> None:
        self._reserve = tempfile.TemporaryFile(dir=self.path.parent, buffering=0)  # noqa: SIM115 -- kept open
        os.posix_fallocate(self._reserve.fileno(), 0, size)

    def write(self, data: bytes) -> int:
        """Write all of ``data``, if need be into the room of the reserve.

        Raises:
            OSError: It cannot be written, or even the reserve is used up.
        """
        rest = memoryview(data)
        while rest:
            try:
                written = os.write(self._handle, rest)
            except OSError as error:
                if error.errno not in FULL or self._reserve is None:
                    raise
                self.full = True
                self._give_up_reserve()
                continue
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
        while True:
            self._asked.wait()
            self._asked.clear()
            if self._closing:
                return
            try:
                os.fdatasync(self._handle)
            except OSError as error:
                self._failed = error

    def _give_up_reserve(self) -> None:
        reserve, self._reserve = self._reserve, None
        if reserve is not None:
            reserve.close()

    def close(self) -> None:
        """Close the file; closing twice is fine."""
        self._give_up_reserve()
        if self._handle >= 0:
            self._closing = True
            self._asked.set()
            self._thread.join()
        handle, self._handle = self._handle, -1
        if handle >= 0:
            with suppress(OSError):
                os.fsync(handle)
            os.close(handle)
