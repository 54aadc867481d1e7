"""The two devices that sequences are played on: the C core in this process, and the firmware on the emulated board.

A line is a device with a power switch. ``ask`` returns the payloads that answer a packet (none once the power is cut),
``await_restart`` lets a device that answered RESTART come back, ``wait`` lets seconds pass, ``boot`` switches off and
on, ``cut`` cuts the power at a change of storage from now (0: never), and ``outcomes`` returns what would have booted
if the power had failed at any change since the last call, where that is known. ``timely`` is False once the machine was
too busy to keep the device's own limits of time.
"""

import ctypes
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Final

from tests.emulator.board import Board, new_storage
from tests.emulator.device_core import HostDevice, Outcome
from tests.emulator.patience import UntilStopped
from tests.faults.requests.specification import LOCK_S

from eitskin.acquisition.serial_port import SerialPort
from eitskin.errors import PortLost
from eitskin_proto.errors import SkinError
from eitskin_proto.wire import framing
from eitskin_proto.wire.codes import EventCode, MessageType

SILENCE_S: Final = 60.0
"""A board that says nothing for so long is gone; a busy machine may starve it for seconds."""

UNASKED: Final = (MessageType.FRAME, MessageType.EVENT)


class CoreLine:
    """The C core in memory, whose clock is turned by hand.

    Args:
        seed: Of the words that are torn to see what would boot.
        core: Its library; by default the one built from the sources.
    """

    timely = True

    def __init__(self, seed: int = 1, core: ctypes.CDLL | None = None) -> None:
        self.device = HostDevice(core)
        self.device.watch(seed | 1)
        self._deframer = framing.Deframer()
        self._pass(0, 50)
        self.cut = self.device.cut_power_at
        self.outcomes = self.device.outcomes

    def _pass(self, duration_us: int, step_us: int) -> bytes:
        self.device.run(duration_us, step_us=step_us)
        return self.device.take()

    def ask(self, packet: bytes, answers: bool = True) -> list[bytes]:
        self.device.write(b"\0" + packet)
        data = self._pass(1000, 1000)
        if self.device.dead:
            return []
        return [found for found in self._deframer.feed(data) if found[0] not in UNASKED]

    def await_restart(self) -> None:
        self._pass(25_000, 5000)

    def wait(self, seconds: int) -> None:
        self._pass(seconds * 1_000_000, 1_000_000)

    def boot(self) -> None:
        self.device.boot()
        self._pass(0, 50)

    @property
    def dead(self) -> bool:
        return self.device.dead

    @property
    def images(self) -> int:
        """States of storage that were booted for ``outcomes``."""
        return self.device.images

    def close(self) -> None:
        """Nothing to give back."""


class BoardLine:
    """The firmware under QEMU; killing it is the power cut. Its clock cannot be turned on.

    Args:
        storage: Its storage file, which is made anew.
    """

    images = 0

    def __init__(self, storage: Path) -> None:
        new_storage(storage)
        self._storage = storage
        self._cut = (0, 0)
        self.timely = True
        self._switch_on()

    def _switch_on(self) -> None:
        self._board = Board(self._storage, *self._cut)
        self._port = SerialPort(self._board.port)
        self._line = UntilStopped(self._port, lambda: self._board.stopped)
        self._deframer = framing.Deframer()
        self._booted_s = time.monotonic()

    def close(self) -> None:
        self._port.close()
        self._board.kill()

    def ask(self, packet: bytes, answers: bool = True) -> list[bytes]:
        clock = framing.encode(bytes([MessageType.TIME_REQUEST, 255]))
        self._port.write(b"\0" + packet + (b"" if answers else clock))
        return [found for found in self._until(_is_answer) if found[0] not in (*UNASKED, MessageType.TIME)]

    def await_restart(self) -> None:
        self._until(_follows_a_boot)

    def _until(self, last: Callable[[bytes], bool]) -> list[bytes]:
        """Return what the board says up to a payload; less if it stops before."""
        said: list[bytes] = []
        with suppress(PortLost):
            while not any(map(last, said)):
                data = self._line.read(SILENCE_S)
                if not data:
                    raise SkinError(f"the emulated board said nothing for {SILENCE_S:g} s")
                said += self._deframer.feed(data)
        # A starved board may lose a lock or a trial that a sequence did not mean to lose.
        self.timely &= time.monotonic() - self._booted_s < LOCK_S - 1
        return [] if self.dead else said

    def wait(self, seconds: int) -> None:
        raise SkinError("the clock of an emulated board cannot be turned on")

    def boot(self) -> None:
        change, seed = self._cut
        self._cut = (max(0, change - self._board.changes), seed)
        self.close()
        self._switch_on()

    def cut(self, change: int, seed: int) -> None:
        self._cut = (change + self._board.changes if change else 0, seed)
        self._board.cut_power_at(change, seed)

    def outcomes(self) -> list[Outcome]:
        """Return nothing: only the core in memory looks at every change."""
        return []

    @property
    def dead(self) -> bool:
        return self._board.stopped


def _is_answer(payload: bytes) -> bool:
    return payload[0] not in UNASKED


def _follows_a_boot(payload: bytes) -> bool:
    return payload[0] == MessageType.EVENT and payload[1] in (EventCode.CONFIGURATION_CHANGED, EventCode.ROLLED_BACK)
