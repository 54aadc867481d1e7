"""A serial port made of a pseudo-terminal: a stable name, raw bytes, and a plug that can be pulled.

The device holds the master side, the host opens the other one by a name that outlives re-plugging::

    device process                         host
    master fd  <--- kernel,18 KiB --->  /dev/pts/7  <--- symbolic link: <folder>/ttySKIN0

The device keeps the host's side open as well. Without that, a host that closes its port would turn every read of the
master into EIO, as if the device itself had gone. Unread bytes stay in the kernel (18 KiB were measured); once that is
full, packets are dropped whole and counted, as the firmware does. A packet that the kernel took in part is finished
before anything else is sent.
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
    """Packets dropped because the host did not read."""

    restart_s = 0.0
    """How long the device is gone from the line when it restarts: a converter chip keeps this port."""

    def __init__(self) -> None:
        """Create the port in a private folder and plug it in."""
        self._folder = Path(tempfile.mkdtemp(prefix="eitskin-"))
        self.path = self._folder / PORT_NAME
        self.overruns = 0
        self._rest = b""
        self._master = self._host_side = -1
        self.plug()

    @property
    def plugged(self) -> bool:
        """Whether the host can open the port."""
        return self._master >= 0

    @property
    def unsent(self) -> bool:
        """Whether the rest of a packet waits for room."""
        return bool(self._rest)

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
        self._rest = b""
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

    def flush(self) -> None:
        """Send what is left of a packet, as far as there is room."""
        if self._rest and self.plugged:
            with contextlib.suppress(BlockingIOError):
                self._rest = self._rest[os.write(self._master, self._rest) :]

    def queue(self, data: bytes) -> None:
        """Send bytes as far as there is room, and keep the others for :meth:`flush`; watch :attr:`unsent`."""
        self._rest += data
        self.flush()

    def write(self, data: bytes) -> bool:
        """Send one packet, whole or not at all: in one system call, or with its rest to follow.

        Returns:
            False if the kernel's buffer is full (counted in :attr:`overruns`), or the plug is out.
        """
        if not self.plugged:
            return False
        self.flush()
        sent = 0
        if not self._rest:
            with contextlib.suppress(BlockingIOError):
                sent = os.write(self._master, data)
        if sent == 0:
            self.overruns += 1
            return False
        self._rest = data[sent:]
        return True

    def write_all(self, data: bytes, timeout_s: float) -> bool:
        """Send bytes that may not be dropped (answers), waiting for room.

        Returns:
            False if the host made no room in time, or the plug is out.
        """
        if not self.plugged:
            return False
        begun, whole = len(self._rest), self._rest + data
        self._rest = b""
        sent = 0
        while sent < len(whole):
            if not select.select([], [self._master], [], timeout_s)[1]:
                # A packet that has begun must be finished; the others are dropped.
                inside = sent < begun or (sent > 0 and whole[sent - 1] != 0)
                self._rest = whole[sent : whole.find(b"\0", sent) + 1] if inside else b""
                return False
            with contextlib.suppress(BlockingIOError):
                sent += os.write(self._master, whole[sent:])
        return True

    def close(self) -> None:
        """Unplug for good and remove the link."""
        self.unplug()
        shutil.rmtree(self._folder, ignore_errors=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
