"""The two devices that sequences are played on: the C core in this process, and the firmware on the emulated board."""

import ctypes
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Final, Protocol

from eitskin.acquisition.serial_port import SerialPort
from eitskin.errors import PortLost
from eitskin_proto.errors import SkinError
from eitskin_proto.wire import framing
from eitskin_proto.wire.codes import EventCode, MessageType
from eitskin_tools.emulator.board import Board, new_storage
from eitskin_tools.emulator.device_core import HostDevice
from eitskin_tools.emulator.outcome import Outcome
from eitskin_tools.emulator.patience import UntilStopped
from eitskin_tools.fault_injection.request_sequences.state import LOCK_S

SILENCE_S: Final = 60.0
"""A board that says nothing for so long is gone; a busy machine may starve it for seconds."""

UNASKED: Final = (MessageType.FRAME, MessageType.EVENT)


class Line(Protocol):
    """A device with a power switch."""

    def ask(self, packet: bytes, answers: bool = True) -> list[bytes]:
        """Return the payloads that answer a packet; none if the power is cut or no answer is to be waited for."""

    def await_restart(self) -> None:
        """Return once the device that answered RESTART runs again, or is dead."""

    def wait(self, seconds: int) -> None:
        """Let time pass."""

    def boot(self) -> None:
        """Switch off and on."""

    def cut(self, change: int, seed: int) -> None:
        """Cut the power at a change of storage from now, half done by this seed; 0 for never."""

    def outcomes(self) -> list[Outcome]:
        """Return what would have booted if power had failed at any change since the last call, if that is known."""

    @property
    def dead(self) -> bool:
        """Whether the power is cut."""

    @property
    def timely(self) -> bool:
        """Whether no limit of time was near that a sequence did not ask for."""

    @property
    def images(self) -> int:
        """States of storage that were booted for ``outcomes``."""

    def close(self) -> None:
        """Switch off for good."""


class CoreLine:
    """The C core in memory.

    Args:
        seed: Of the words that are torn to see what would boot.
        core: Its library; by default the one built from the sources.
    """

    def __init__(self, seed: int = 1, core: ctypes.CDLL | None = None) -> None:
        self.device = HostDevice(core)
        self.device.watch(seed | 1)
        self._deframer = framing.Deframer()
        self.device.run(0)
        self.device.take()

    def ask(self, packet: bytes, answers: bool = True) -> list[bytes]:
        """Return the payloads that answer a packet."""
        self.device.write(b"\0" + packet)
        self.device.run(1000, step_us=1000)
        if self.device.dead:
            self.device.take()
            return []
        return [found for found in self._deframer.feed(self.device.take()) if found[0] not in UNASKED]

    def await_restart(self) -> None:
        """Let the device restart."""
        self.device.run(25_000, step_us=5000)
        self.device.take()

    def wait(self, seconds: int) -> None:
        """Turn the clock on."""
        self.device.run(seconds * 1_000_000, step_us=1_000_000)
        self.device.take()

    def boot(self) -> None:
        """Switch off and on."""
        self.device.boot()
        self.device.run(0)
        self.device.take()

    def cut(self, change: int, seed: int) -> None:
        """Cut the power at a change of storage from now."""
        self.device.cut_power_at(change, seed)

    def outcomes(self) -> list[Outcome]:
        """Return what would have booted."""
        return self.device.outcomes()

    @property
    def dead(self) -> bool:
        """Whether the power is cut."""
        return self.device.dead

    @property
    def timely(self) -> bool:
        """Always: its clock is turned by hand."""
        return True

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

    def __init__(self, storage: Path) -> None:
        new_storage(storage)
        self._storage = storage
        self._cut = (0, 0)
        self._timely = True
        self._switch_on()

    def _switch_on(self) -> None:
        self._board = Board(self._storage, *self._cut)
        self._port = SerialPort(self._board.port)
        self._line = UntilStopped(self._port, lambda: self._board.stopped)
        self._deframer = framing.Deframer()
        self._booted_s = time.monotonic()

    def close(self) -> None:
        """Switch off for good."""
        self._port.close()
        self._board.kill()

    def ask(self, packet: bytes, answers: bool = True) -> list[bytes]:
        """Return the payloads that answer a packet."""
        clock = framing.encode(bytes([MessageType.TIME_REQUEST, 255]))
        self._port.write(b"\0" + packet + (b"" if answers else clock))
        return [found for found in self._until(_is_answer) if found[0] not in (*UNASKED, MessageType.TIME)]

    def await_restart(self) -> None:
        """Wait for the event that follows a boot."""
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
        self._timely &= time.monotonic() - self._booted_s < LOCK_S - 1
        return [] if self.dead else said

    def wait(self, seconds: int) -> None:
        """Refuse.

        Raises:
            SkinError: Always: the clock of an emulated board cannot be turned on.
        """
        raise SkinError("the clock of an emulated board cannot be turned on")

    def boot(self) -> None:
        """Kill it and start it anew."""
        change, seed = self._cut
        self._cut = (max(0, change - self._board.changes), seed)
        self.close()
        self._switch_on()

    def cut(self, change: int, seed: int) -> None:
        """Cut the power at a change of storage from now."""
        self._cut = (change + self._board.changes if change else 0, seed)
        self._board.cut_power_at(change, seed)

    def outcomes(self) -> list[Outcome]:
        """Return nothing: only the core in memory looks at every change."""
        return []

    @property
    def dead(self) -> bool:
        """Whether the power is cut."""
        return self._board.stopped

    @property
    def timely(self) -> bool:
        """Whether nothing took as long after a boot as a lock or a trial lasts; a starved board may lose either."""
        return self._timely

    @property
    def images(self) -> int:
        """None."""
        return 0


def _is_answer(payload: bytes) -> bool:
    return payload[0] not in UNASKED


def _follows_a_boot(payload: bytes) -> bool:
    return payload[0] == MessageType.EVENT and payload[1] in (EventCode.CONFIGURATION_CHANGED, EventCode.ROLLED_BACK)
