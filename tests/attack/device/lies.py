"""Intact frames and greetings that say what is not so: numbers, clocks, rates, rows, flags, generations, HELLO."""

import time
from typing import TYPE_CHECKING, Any, Final

from . import codec
from .device import Options
from .hostile import Attack

if TYPE_CHECKING:
    from .process import Machine

JUMPS: Final = (1, 2, 100, 65_600, 10**6, 2**31 - 1000)
"""How far sequence numbers jump ahead; nowhere to where the same pattern has just been."""


class Repeat(Attack):
    """Every frame several times: published once."""

    def send(self, payload: bytes) -> bool:
        if payload[0] == codec.FRAME:
            for _ in range(self.random.choice((1, 1, 2, 10))):
                self.machine.put(codec.packet(payload))
        return False


class Ahead(Attack):
    """Sequence numbers that jump ahead every few scans: what is skipped is lost, the rest is published."""

    def send(self, payload: bytes) -> bool:
        if payload[0] == codec.FRAME and self.random.random() < 0.1:
            self.machine.device.sequence += self.random.choice(JUMPS)
        return False


class Back(Attack):
    """Sequence numbers that go back, without a restart."""

    def send(self, payload: bytes) -> bool:
        if payload[0] == codec.FRAME and self.random.random() < 0.1:
            back = self.random.choice((1, 3, 20))
            self.machine.device.sequence = max(0, self.machine.device.sequence - back)
        return False


class BackFar(Attack):
    """Once, a step back by half of all numbers, which a restart could be as well."""

    def __init__(self, machine: "Machine", order: dict[str, Any]) -> None:
        super().__init__(machine, order)
        machine.device.sequence = (machine.device.sequence + order["by"]) % 2**32


class Clock(Attack):
    """A device clock that jumps, stands or runs backwards; the frames are what they were."""

    def __init__(self, machine: "Machine", order: dict[str, Any]) -> None:
        super().__init__(machine, order)
        machine.device.clock_rate = order.get("rate", 1.0)
        self._jump_us = order.get("jump_us", 0)

    def send(self, payload: bytes) -> bool:
        if payload[0] == codec.FRAME and self._jump_us and self.random.random() < 0.1:
            self.machine.device.clock_step_us += self.random.randrange(-self._jump_us, self._jump_us + 1)
        return False

    def end(self) -> None:
        self.machine.device.clock_rate = 1.0
        super().end()


class Pace(Attack):
    """Scans so many times too fast or too slow, whatever HELLO says."""

    def __init__(self, machine: "Machine", order: dict[str, Any]) -> None:
        super().__init__(machine, order)
        machine.device.pace = order["times"]

    def end(self) -> None:
        self.machine.device.pace = 1.0
        self.machine.device.next_s = time.monotonic()
        super().end()


class Rows(Attack):
    """Frames that are whole and say nonsense of the sheet: ``kind`` says which."""

    def send(self, payload: bytes) -> bool:
        if payload[0] != codec.FRAME:
            return False
        frame = codec.frame_of(payload)
        largest = 2 ** (8 * frame.sample_bytes - 1) - 1
        rows = range(len(frame.counts))
        match self.order["kind"]:
            case "saturated":
                frame.counts, frame.saturated = [largest] * len(rows), list(rows)
            case "lowest":
                frame.counts = [-largest - 1] * len(rows)
            case "zero":
                frame.counts = [0] * len(rows)
            case "one":
                frame.counts = [1] * len(rows)
            case "turned":
                frame.counts = [-count for count in frame.counts]
            case "frozen":
                frame.counts = codec.frame_of(self.machine.frozen or payload).counts
                self.machine.frozen = self.machine.frozen or payload
            case "garbage":
                frame.counts = [self.random.randrange(-largest - 1, largest + 1) for _ in rows]
            case "bits":
                frame.saturated = [row for row in rows if self.random.random() < 0.3]
            case kind:
                raise ValueError(kind)
        self.machine.put(codec.packet(frame.payload()))
        return True


class Heads(Attack):
    """Frames with another head: ``field`` and the values that it takes in turn; a tenth of them."""

    def send(self, payload: bytes) -> bool:
        if payload[0] != codec.FRAME or self.random.random() > self.order.get("share", 0.1):
            return False
        frame = codec.frame_of(payload)
        name, value = self.order["field"], self.random.choice(self.order["values"])
        setattr(frame, name, getattr(frame, name) ^ value if self.order.get("xor") else value)
        changed = frame.payload()
        if self.order.get("right"):  # as good as what it was
            self.machine.scans[frame.sequence % 2**32] = changed
        self.machine.put(codec.packet(changed))
        return True


class Greeting(Attack):
    """A HELLO in the middle of the stream that nobody asked for, with other values, every few frames; any tag."""

    def send(self, payload: bytes) -> bool:
        if payload[0] == codec.FRAME and self.random.random() < 0.2:
            device = self.machine.device
            name, value = self.random.choice(sorted(lies_of_hello(self.random.getrandbits(32)).items()))
            before, device.options.hello = device.options.hello, {name: value}
            self.machine.put(codec.packet(device.hello(self.random.randrange(256))))
            device.options.hello = before
        return False


class Changed(Attack):
    """A restart after which HELLO says something else for as long as it lasts."""

    def __init__(self, machine: "Machine", order: dict[str, Any]) -> None:
        super().__init__(machine, order)
        machine.device.options.hello = Options(hello=order["hello"]).hello
        machine.restart()

    def end(self) -> None:
        self.machine.device.options.hello = {}
        self.machine.restart()
        super().end()


def lies_of_hello(number: int) -> dict[str, Any]:
    """Return one wrong value of each field of HELLO that a host must look at; ``number`` chooses among some."""
    pick: Any = lambda *values: values[number % len(values)]  # noqa: E731
    return {
        "magic": pick(b"EITC", bytes(4), b"eits"),
        "protocol_major": pick(0, 2, 255),
        "protocol_id": pick(bytes(8), b"\xff" * 8),
        "grid_id": pick(bytes(8), b"\xff" * 8),
        "serial_number": pick(b"\x1b]0;owned\x07\x1b[2J", b"\xff\xfe\x80" * 5, b"a\0b", b"\n\r\n"),
        "configuration_name": pick(b"\x1b[31mred\x1b[0m", b"\xc3\xa9t\xc3\xa9", b"x\0\0y", b"/../../x"),
        "configuration_digest": pick(0, 2**32 - 1),
        "generation": pick(0, 77, 2**32 - 1),
        "rate_mHz": pick(0, 1, 2**32 - 1),
        "rows": pick(0, 1, 103, 208, 255),
        "sample_bytes": pick(0, 1, 5, 255),
        "drives": pick(0, 1, 0x3FFE),
        "volts_per_count": pick(float("nan"), float("inf"), 0.0, -6e-8, -0.0, 1e300, 5e-324, 1e-30),
    }


KNOWN: Final[dict[str, type[Attack]]] = {
    "repeat": Repeat,
    "ahead": Ahead,
    "back": Back,
    "back_far": BackFar,
    "clock": Clock,
    "pace": Pace,
    "rows": Rows,
    "heads": Heads,
    "greeting": Greeting,
    "changed": Changed,
}
