"""A serial port made of a pseudo-terminal: a stable name, raw bytes, and a plug that can be pulled.

The device holds the master side, the host opens the other one by a name that outlives re-plugging::

    device process                         host
    master fd  <--- kernel,18 KiB --->  /dev/pts/7  <--- symbolic link: <folder>/ttySKIN0

The device keeps the host's side open as well. Without that, a host that closes its port would turn every read of the
master into EIO, as if the device itself had gone. Bytes that nobody reads stay in the kernel (18 KiB were measured);
once that is full the packet is dropped and counted, as a real converter's buffer overruns.
"""

import contextlib
import os
import select
import shutil
import tempfile
import termios
import tty
from pathlib import Path
from types import TracebackType
from typing import Self

PORT_NAME = "ttySKIN0"
"""Name of the link that the host opens."""


class PtyPort:
    """A pseudo-terminal in raw mode with a stable name; owns both descriptors and the folder of the link."""

    overruns: int
    """Packets dropped, whole or in part, because the host did not read."""

    def __init__(self, folder: Path | None = None) -> None:
        """Create the port and plug it in.

        Args:
            folder: Where the link goes; by default a private temporary folder, removed by :meth:`close`.
        """
        self._own_folder = folder is None
        self._folder = Path(tempfile.mkdtemp(prefix="eitskin-")) if folder is None else folder
        self.path = self._folder / PORT_NAME
        self.overruns = 0
        self._master = self._host_side = -1
        self.plug()

    @property
    def plugged(self) -> bool:
        """Whether the host can open the port."""
        return self._master >= 0

    def fileno(self) -> int:
        """Return the descriptor to wait on; -1 while unplugged."""
        return self._master

    def plug(self) -> None:
        """Make the port appear; nothing happens if it is there."""
        if self.plugged:
            return
        self._master, self._host_side = os.openpty()
        tty.setraw(self._host_side, termios.TCSANOW)
        os.set_blocking(self._master, False)
        fresh = self.path.with_suffix(".new")
        fresh.unlink(missing_ok=True)
        fresh.symlink_to(os.ttyname(self._host_side))
        fresh.replace(self.path)

    def unplug(self) -> None:
        """Make the port vanish: the host's reads and writes fail from now on."""
        if not self.plugged:
            return
        self.path.unlink(missing_ok=True)
        master, host_side = self._master, self._host_side
        self._master = self._host_side = -1
        os.close(host_side)
        os.close(master)

    def read(self) -> bytes:
        """Return what the host has written, without waiting; empty when there is nothing."""
        if not self.plugged:
            return b""
        try:
            return os.read(self._master, 65536)
        except BlockingIOError:
            return b""

    def write(self, data: bytes) -> bool:
        """Send bytes to the host in one system call.

        Returns:
            False if the kernel's buffer could not take all of them (counted in :attr:`overruns`).
        """
        if not self.plugged:
            return False
        try:
            complete = os.write(self._master, data) == len(data)
        except BlockingIOError:
            complete = False
        self.overruns += not complete
        return complete

    def write_all(self, data: bytes, timeout_s: float) -> bool:
        """Send bytes that may not be dropped (answers), waiting for room.

        Returns:
            False if the host made no room in time.
        """
        view = memoryview(data)
        while view and self.plugged:
            if not select.select([], [self._master], [], timeout_s)[1]:
                return False
            with contextlib.suppress(BlockingIOError):
                view = view[os.write(self._master, view) :]
        return not view

    def close(self) -> None:
        """Unplug for good and remove the link."""
        self.unplug()
        if self._own_folder:
            shutil.rmtree(self._folder, ignore_errors=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
