"""Devices at the end of a line, asked one request at a time: the C core, the virtual skin, the emulated board."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from tests.emulator.board import Board
from tests.emulator.device_core import HostDevice

from eitskin.acquisition.serial_port import SerialPort
from eitskin_proto.wire import config_toml, framing
from eitskin_proto.wire import messages as m
from eitskin_proto.wire.codes import Code, EventCode
from eitskin_proto.wire.config import Configuration
from eitskin_proto.wire.frames import Frame
from eitskin_tools.virtual_skin.device import Identity, VirtualDevice
from eitskin_tools.virtual_skin.server import SkinServer

SILENCE_S = 60.0
"""A board that says nothing for so long is gone; a busy machine may starve it for seconds."""

BEHIND = 251
"""Tag of the question that is sent behind others; no test uses it."""

PAPER = config_toml.named("paper")
FAST = config_toml.named("fast")
FULL = config_toml.named("full208")


def begin(configuration=FAST, token=9, **changes):
    fields = {"size": 64, "digest": configuration.digest, "hardware_id": configuration.hardware_id,
              "revision": configuration.revision, "name": configuration.name, "format": 1}  # fmt: skip
    return m.ConfigBegin(**{"tag": 3, "token": token, **fields, **changes})


class Asked:
    """A device at the end of a line, asked one request at a time."""

    def __init__(self) -> None:
        self.deframer = framing.Deframer()
        self.heard: list[m.Message] = []

    def raw(self, data: bytes, wait_s: float = 0.005) -> list[m.Message]:
        """Send bytes, wait, and return every message that came, events included."""
        self.send(data)
        return self.listen(wait_s)

    def listen(self, wait_s: float) -> list[m.Message]:
        return [m.unpack(payload) for payload in self.deframer.feed(self.wait(wait_s))]

    def ask(self, request: m.Message) -> Any:
        """Return the one answer to a request."""
        answers = [
            found
            for found in self.raw(b"\0" + framing.encode(request.pack()))
            if not isinstance(found, m.Event | Frame)
        ]
        assert len(answers) == 1, answers
        assert answers[0].tag == request.tag
        return answers[0]

    def flash(self, configuration: Configuration, token: int = 9) -> m.Ack:
        """Begin, write and commit; return the answer to the first step that failed, or the last one."""
        blob = configuration.to_blob()
        answer = self.ask(begin(configuration, token))
        for at in range(0, len(blob), m.CHUNK_BYTES):
            if answer.code == Code.OK:
                answer = self.ask(m.ConfigWrite(token, at, blob[at : at + m.CHUNK_BYTES]))
        return self.ask(m.ConfigCommit(token, configuration.digest)) if answer.code == Code.OK else answer

    def restart(self, token: int) -> m.Hello:
        """Restart it and return what it says then."""
        answers = [found for found in self.until_restarted(m.Restart(token)) if isinstance(found, m.Ack)]
        assert [found.code for found in answers] == [Code.OK]
        return self.ask(m.HelloRequest())

    def until_restarted(self, request: m.Restart) -> list[m.Message]:
        """Send a request and return every message that came until it ran again."""
        return self.raw(b"\0" + framing.encode(request.pack()), self.restart_s)

    restart_s = 0.05

    def send(self, data: bytes) -> None:
        raise NotImplementedError

    def wait(self, seconds: float) -> bytes:
        raise NotImplementedError


class CoreAsked(Asked):
    """The C core in memory; its clock is moved by hand."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.device = HostDevice()
        self.wait(0.001)

    def send(self, data: bytes) -> None:
        self.device.write(data)

    def wait(self, seconds: float) -> bytes:
        said = b""
        for _ in range(max(1, round(seconds / 0.1))):
            self.device.run(round(min(seconds, 0.1) * 1e6), step_us=50 if seconds < 1 else 1000)
            said += self.device.take()
        return said

    def power_cycle(self) -> None:
        self.device.boot()

    def close(self) -> None:
        pass


class Memory:
    """A line without a kernel, as the virtual skin's server sees one."""

    restart_s, plugged, unsent = 0.0, True, False

    def __init__(self) -> None:
        self.to_device, self.to_host = bytearray(), bytearray()

    def read(self) -> bytes:
        data = bytes(self.to_device)
        self.to_device.clear()
        return data

    def write(self, data: bytes) -> bool:
        self.to_host += data
        return True

    def write_all(self, data: bytes, timeout_s: float) -> bool:
        return self.write(data)


class Ramp:
    """Voltages that differ from row to row."""

    def voltages(self, time_s: float) -> np.ndarray:
        return np.linspace(-0.1, -0.001, 104)


class VirtualAsked(Asked):
    """The virtual skin behind its own server; the clock jumps from one thing that is due to the next."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.now_ns = 1_000_000_000
        self.device = VirtualDevice(Ramp(), PAPER, self.now_ns, Identity())
        self.port = Memory()
        self.server = SkinServer(self.device, self.port, clock=lambda: self.now_ns)
        self.wait(0.001)

    def send(self, data: bytes) -> None:
        self.port.to_device += data

    def wait(self, seconds: float) -> bytes:
        end_ns = self.now_ns + round(seconds * 1e9)
        while True:
            self.server.turn(self.now_ns)
            due_ns = self.server.next_ns()
            if not due_ns or due_ns > end_ns:
                break
            self.now_ns = max(due_ns, self.now_ns)
        self.now_ns = end_ns
        said = bytes(self.port.to_host)
        self.port.to_host.clear()
        return said

    def power_cycle(self) -> None:
        self.device.boot(self.now_ns)

    def close(self) -> None:
        pass


class BoardAsked(Asked):
    """The firmware under QEMU: real time, so only questions that need none of it.

    Nothing here waits for a time that a starved board could miss: it waits for what the board will say, and gives up
    when the board has said nothing for a minute.
    """

    restart_s = 0.4

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self._pending: list[m.Message] = []
        self.storage = folder / "storage.bin"
        self._switch_on()

    def _switch_on(self) -> None:
        self.board = Board(self.storage)
        self.port = SerialPort(self.board.port)
        self.ask(m.HelloRequest())

    def send(self, data: bytes) -> None:
        self.port.write(data)

    def ask(self, request: m.Message) -> Any:
        self.send(b"\0" + framing.encode(request.pack()))
        found = self._until(lambda found: not isinstance(found, m.Event | Frame))[-1]
        assert getattr(found, "tag", None) == request.tag
        return found

    def raw(self, data: bytes, wait_s: float = 0.0) -> list[m.Message]:
        """Send bytes and return what came until the board answered a question that was sent behind them."""
        self.send(data + b"\0" + framing.encode(m.TimeRequest(tag=BEHIND).pack()))
        return self._until(lambda found: isinstance(found, m.Time) and found.tag == BEHIND)[:-1]

    def until_restarted(self, request: m.Restart) -> list[m.Message]:
        """The same: what runs then is the last of its messages; what it still says of its last start is left out."""
        self.send(b"\0" + framing.encode(request.pack()))
        answer = self._until(lambda found: isinstance(found, m.Ack))[-1]
        events = self._until(lambda found: isinstance(found, m.Event) and found.code == EventCode.RESTARTING)
        return [answer, *events, *self._until(lambda found: isinstance(found, m.Event))]

    def _until(self, last: Callable[[m.Message], bool]) -> list[m.Message]:
        """Return what the board says up to the message that is asked for."""
        said: list[m.Message] = []
        while not said or not last(said[-1]):
            if not self._pending:
                data = self.port.read(SILENCE_S)
                assert data, f"the board said nothing for {SILENCE_S:g} s; before: {said}"
                self._pending = [m.unpack(payload) for payload in self.deframer.feed(data)]
                continue
            said.append(self._pending.pop(0))
        return said

    def listen(self, wait_s: float) -> list[m.Message]:
        before, self._pending = self._pending, []
        return before + super().listen(wait_s)

    def wait(self, seconds: float) -> bytes:
        said, deadline_s = b"", time.perf_counter() + seconds
        while (left_s := deadline_s - time.perf_counter()) > 0:
            said += self.port.read(left_s)
        return said

    def power_cycle(self) -> None:
        self.close()
        self.deframer.reset()
        self._pending.clear()
        self._switch_on()

    def close(self) -> None:
        self.port.close()
        self.board.kill()


DEVICES = {"core": (CoreAsked, "host"), "virtual": (VirtualAsked, ""), "board": (BoardAsked, "qemu")}
