"""A file that is written to its end although the disk is full: a reserve is kept for that, and given up when needed.

The reserve is a second file without a name: whatever ends this process frees it. When the disk is full it is closed,
and what was being written is finished in the room that it leaves.
"""

import errno
import os
import tempfile
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

    def sync(self) -> None:
        """Return when everything written is on disk."""
        os.fdatasync(self._handle)

    def _give_up_reserve(self) -> None:
        reserve, self._reserve = self._reserve, None
        if reserve is not None:
            reserve.close()

    def close(self) -> None:
        """Close the file; closing twice is fine."""
        self._give_up_reserve()
        handle, self._handle = self._handle, -1
        if handle >= 0:
            with suppress(OSError):
                os.fsync(handle)
            os.close(handle)
