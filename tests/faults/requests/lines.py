"""The device that sequences are played on: the C core in this process, with a power switch.

``ask`` returns the payloads that answer a packet (none once the power is cut), ``await_restart`` lets a device that
answered RESTART come back, ``wait`` lets seconds pass, ``boot`` switches off and on, ``cut`` cuts the power at a change
of storage from now (0: never), and ``outcomes`` returns what would have booted if the power had failed at any change
since the last call.
"""

import ctypes
from typing import Final

from tests.emulator.device_core import HostDevice

from eitskin_proto.wire import framing
from eitskin_proto.wire.codes import MessageType

UNASKED: Final = (MessageType.FRAME, MessageType.EVENT)


class CoreLine:
    """The C core in memory, whose clock is turned by hand.

    Args:
        seed: Of the words that are torn to see what would boot.
        core: Its library; by default the one built from the sources.
    """

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

    def ask(self, packet: bytes) -> list[bytes]:
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
