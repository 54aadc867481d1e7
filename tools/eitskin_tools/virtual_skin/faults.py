"""Faults of a line, a cable and a device, at the times that a test requests.

A fault is written ``KIND[@START][/EVERY][:AMOUNT]``, times in seconds since the first START::

    flip@2:3        three bits of the packet after 2 s          garbage@2:500   500 random bytes before a packet
    drop@2/0.1:10   ten bytes lost, every 0.1 s from 2 s on     stall@2:0.5     no scan for 0.5 s
    unplug@2:0.5    the cable is out for 0.5 s                  reset@2         reboots in the middle of a packet
    saturate@2:5    five rows at full scale for one scan        twice@2:1       every answer comes twice for 1 s
    frozen@2:5      the same samples again for 5 s              failing@2:5     FRONT_END_FAILED instead of scans, 5 s
    stuck@2:5       every row at one count for 5 s
    foreign         HELLO names another protocol_id             mute@0:1  late@0:0.5   no answer for 1 s; late ones

Everything random comes from a seed, so that a run can be repeated.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

AMOUNTS: Final[dict[str, float]] = {
    "flip": 1, "drop": 1, "garbage": 64, "stall": 0.5, "unplug": 0.5, "reset": 0,
    "saturate": 1, "foreign": 0, "mute": 1.0, "late": 0.2, "twice": 1.0, "frozen": 1.0,
    "stuck": 1.0, "failing": 1.0,
}  # fmt: skip
"""Every kind with the amount it has when none is given: bits, bytes, rows or seconds."""

FRONT_END: Final = ("frozen", "stuck", "failing")
"""Kinds of faults before the wire, which last."""

FOREIGN_ID: Final = "00000000f0e1d2c3"
"""The protocol_id of a device that measures something else."""

_PATTERN: Final = re.compile(r"(?P<kind>[a-z]+)(@(?P<start>[0-9.]+))?(/(?P<every>[0-9.]+))?(:(?P<amount>[0-9.]+))?")


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault, once or again and again."""

    kind: str
    start_s: float = 0.0
    every_s: float = 0.0
    """0 if it happens once."""
    amount: float = 0.0

    def due(self, after_s: float, until_s: float) -> bool:
        """Return whether it happens in the time after the first and up to the second."""
        if not self.every_s:
            return after_s < self.start_s <= until_s
        if until_s < self.start_s:
            return False
        latest = self.start_s + self.every_s * int((until_s - self.start_s) / self.every_s)
        return latest > after_s

    def lasts_until(self, time_s: float) -> bool:
        """Return whether a fault with a duration is going on."""
        return self.start_s <= time_s < self.start_s + self.amount


def parse(text: str) -> Fault:
    """Return the fault that a text names.

    Raises:
        ValueError: The kind is unknown, or the text has another form.
    """
    match = _PATTERN.fullmatch(text)
    if match is None or match["kind"] not in AMOUNTS:
        raise ValueError(
            f"fault {text!r} is unknown; expected KIND[@START][/EVERY][:AMOUNT] with a kind of {', '.join(AMOUNTS)}"
        )
    try:
        start, every = float(match["start"] or 0.0), float(match["every"] or 0.0)
        amount = float(match["amount"]) if match["amount"] else AMOUNTS[match["kind"]]
    except ValueError as error:
        raise ValueError(f"fault {text!r} has something else in place of a number") from error
    return Fault(match["kind"], start, every, amount)


@dataclass(frozen=True, slots=True)
class Injected:
    """A fault that happened, for the log."""

    kind: str
    time_s: float
    detail: str


class FaultPlayer:
    """Applies faults to packets as their time comes.

    Args:
        faults: What to play.
        seed: Of every random choice.
    """

    def __init__(self, faults: Sequence[Fault] = (), seed: int = 0) -> None:
        self.faults = tuple(faults)
        self.injected: list[Injected] = []
        """What happened so far, oldest first."""
        self._rng = np.random.default_rng(seed)
        self._last_s = -1e-9

    @property
    def foreign(self) -> bool:
        """Whether the device plays one of another protocol."""
        return any(fault.kind == "foreign" for fault in self.faults)

    def due(self, time_s: float) -> list[Fault]:
        """Return the faults whose moment has come since the last call."""
        found = [fault for fault in self.faults if fault.due(self._last_s, time_s)] if self.faults else []
        self._last_s = max(time_s, self._last_s)
        return found

    def front_end(self, time_s: float) -> str:
        """Return which fault of the front end goes on, one of ``FRONT_END``; "" if none does."""
        for fault in self.faults:
            if fault.kind in FRONT_END and fault.lasts_until(time_s):
                return fault.kind
        return ""

    def note(self, fault: Fault, time_s: float, detail: str) -> None:
        """Remember that a fault happened."""
        self.injected.append(Injected(fault.kind, time_s, detail))

    def damage(self, packet: bytes, fault: Fault, time_s: float) -> bytes:
        """Return what a line makes of a packet: its bytes after a fault of kind flip, drop or garbage."""
        amount = max(int(fault.amount), 1)
        match fault.kind:
            case "flip":
                damaged, detail = self._flip(packet, amount)
            case "drop":
                start = int(self._rng.integers(0, max(len(packet) - amount, 1)))
                damaged, detail = packet[:start] + packet[start + amount :], f"bytes {start} to {start + amount - 1}"
            case "garbage":
                noise = self._rng.integers(0, 256, amount, dtype=np.uint8).tobytes()
                damaged, detail = noise + packet, f"{amount} bytes before"
            case _:
                return packet
        self.note(fault, time_s, detail)
        return damaged

    def answers(self, packets: list[bytes], time_s: float) -> tuple[list[bytes], float]:
        """Return the answers that are sent, and by how many seconds they are late."""
        late_s = 0.0
        for fault in self.faults:
            match fault.kind:
                case "mute" if packets and fault.lasts_until(time_s):
                    self.note(fault, time_s, f"{len(packets)} answers")
                    packets = []
                case "twice" if packets and fault.lasts_until(time_s):
                    self.note(fault, time_s, f"{len(packets)} answers")
                    packets = [packet for packet in packets for _ in range(2)]
                case "late" if packets and time_s >= fault.start_s:
                    self.note(fault, time_s, f"{fault.amount:g} s")
                    late_s = fault.amount
        return packets, late_s

    def _flip(self, packet: bytes, bits: int) -> tuple[bytes, str]:
        damaged = bytearray(packet)
        where = self._rng.choice(8 * len(packet), size=min(bits, 8 * len(packet)), replace=False)
        for bit in where:
            damaged[bit // 8] ^= 1 << (bit % 8)
        return bytes(damaged), f"bits {sorted(int(bit) for bit in where)}"
