"""A device, from SPEC.md alone: greets, streams patterns, answers; what goes on the line is a list of payloads.

What a scan reads follows from its sequence number alone (``pattern``), so that whoever has a published frame knows what
it must have been made of.
"""

import time
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from . import codec, sheet
from .codec import Frame
from .store import HARDWARE, Configuration, Store, blob

PROTOCOL_ID: Final = bytes.fromhex("0bff7f6e45fa7bc8")
GRID_ID: Final = bytes.fromhex("ef41b0aa6e17eb61")
NOISES: Final = 64
"""Different noises, over and over."""
TOUCHES: Final = (None, (40.0, 30.0), (75.0, 55.0), (110.0, 70.0))
PATTERNS: Final = NOISES * len(TOUCHES)
NOISE: Final = 1e-4
"""Of a row, relative."""
TRIAL_S: Final = 30.0


def pattern(sequence: int, quiet: int, first: int = 0) -> int:
    """Return which of the patterns a scan is of: one of the untouched for the ``quiet`` scans from ``first`` on.

    Neighbours differ in noise and mostly in touch, and none comes again within ``NOISES`` scans.
    """
    drawn = sequence * 77 % PATTERNS  # 77 is odd: each of them once in so many scans
    return drawn % NOISES if (sequence - first) % 2**32 < quiet else drawn


def touched(number: int) -> bool:
    """Return whether a pattern has a touch."""
    return number >= NOISES


@dataclass
class Options:
    """What a device is like."""

    rate_mHz: int = 200_000
    rows: int = 104
    sample_bytes: int = 3
    quiet: int = 300
    """Scans after boot that are untouched."""
    first: int = 0
    """Sequence number of the first scan after boot."""
    clock_us: int = 0
    """The device's clock when it starts."""
    full_scale_V: float = 0.5
    hello: dict[str, Any] = field(default_factory=dict)
    """Fields of HELLO that are not what they should be; a text stands for bytes in hex."""

    def __post_init__(self) -> None:
        self.hello = {
            name: bytes.fromhex(value) if isinstance(value, str) else value for name, value in self.hello.items()
        }


class Device:
    """The device's state; ``receive`` and ``due`` give the payloads to send."""

    def __init__(self, options: Options) -> None:
        self.options = options
        common = {"rows": options.rows, "sample_bytes": options.sample_bytes, "rate_mHz": options.rate_mHz}
        self.store = Store(blob(**common))
        self.clock_rate = self.pace = 1.0
        self.clock_step_us = options.clock_us
        self.began_s = time.monotonic()
        self._read = self._voltages()
        self.boot()

    def boot(self) -> list[bytes]:
        """Start anew and return what is said about it."""
        self.store.boot()
        found = self.configuration
        self._volts_per_count = self.options.full_scale_V / (2 ** (8 * found.sample_bytes - 1) - 1)
        self._counts = np.rint(self._read[found.rows == 208] / self._volts_per_count).astype(int).tolist()
        self.booted_s = time.monotonic()
        self.sequence = self.options.first
        self.streaming = self.idle = False
        self.started = False
        self.left: int | None = None
        self.dropped = 0
        self.next_s = 0.0
        self.restart = False
        code = codec.ROLLED_BACK if self.store.gave_up else codec.CONFIGURATION_CHANGED
        return [codec.pack(codec.EVENT, code, self.clock_us(), self.store.generation)]

    @property
    def configuration(self) -> Configuration:
        """What runs."""
        return Configuration.read(self.store.running)

    def clock_us(self) -> int:
        """Return the device's clock, modulo 2^32."""
        return int((time.monotonic() - self.began_s) * 1e6 * self.clock_rate + self.clock_step_us) % 2**32

    def period_s(self) -> float:
        """Return the time from scan to scan."""
        found = self.configuration
        return 1000.0 / (found.idle_rate_mHz if self.idle else found.rate_mHz) / self.pace

    def receive(self, payload: bytes) -> list[bytes]:
        """Take one intact packet's payload and return the answers to it."""
        kind, tag = payload[0], payload[1] if len(payload) > 1 else 0
        if kind >= 0x80 or kind not in codec.LAYOUTS:
            return [self._ack(tag, kind, codec.UNKNOWN_TYPE, len(payload))]
        try:
            fields = codec.unpack(payload)
        except ValueError:
            return [self._ack(tag, kind, codec.BAD_LENGTH, len(payload))]
        if kind == codec.HELLO_REQUEST:
            if fields[1] != codec.MAGIC:
                return [self._ack(tag, kind, codec.BAD_VALUE, len(payload))]
            return [self.hello(tag)]
        if kind == codec.TIME_REQUEST:
            return [codec.pack(codec.TIME, tag, self.clock_us())]
        if kind in (codec.START, codec.STOP, codec.SET_MODE):
            return [self._ack(tag, kind, *self._stream(kind, fields))]
        answer = self.store.answer(kind, fields, self.streaming)
        if isinstance(answer, bytes):
            return [answer]
        said = [self._ack(tag, kind, *answer)]
        if kind == codec.RESTART and answer[0] == codec.OK:
            said.append(codec.pack(codec.EVENT, codec.RESTARTING, self.clock_us(), self.store.generation))
            said += self.boot()
        return said

    def due(self) -> list[Frame]:
        """Return the scan that has ended, if one has; behind by more than a second it skips some."""
        now_s = time.monotonic()
        if self.store.trial and now_s - self.booted_s > TRIAL_S:
            self.boot()
        if not self.streaming or now_s < self.next_s:
            return []
        behind = int((now_s - self.next_s) / self.period_s())
        if behind * self.period_s() > 1.0:
            self.sequence += behind
            self.dropped += behind
            self.next_s += behind * self.period_s()
        self.next_s += self.period_s()
        return [self.scan()]

    def scan(self) -> Frame:
        """Make one scan, now."""
        found = self.configuration
        drives = found.idle_drives if self.idle else found.drives
        full = found.rows == 208
        counts = self._counts[pattern(self.sequence, self.options.quiet, self.options.first)]
        flags = full * 1 | self.idle * 2 | (not self.started) * 4 | self.store.trial * 8
        rows = sheet.rows_of(drives, full)
        made = Frame(
            self.sequence, self.clock_us(), [counts[row] for row in rows], drives, self.store.generation, flags
        )
        made.sample_bytes, made.dropped = found.sample_bytes, self.dropped
        self.started = True
        self.sequence += 1
        if self.left is not None:
            self.left -= 1
            self.streaming = self.left > 0
        return made

    def hello(self, tag: int) -> bytes:
        """Return who this is."""
        found = self.configuration
        full = found.rows == 208
        flags = full * 1 | self.store.trial * 2 | (self.store.active is None) * 4 | self.store.gave_up * 8
        values: dict[str, Any] = dict(
            magic=codec.MAGIC,
            protocol_major=1,
            protocol_minor=0,
            protocol_id=PROTOCOL_ID,
            grid_id=GRID_ID,
            firmware_version=bytes((0, 1, 0)),
            flags=flags | self.streaming * 16 | self.idle * 32,
            hardware_id=HARDWARE,
            serial_number=b"OWN-0001",
            configuration_digest=found.crc,
            generation=self.store.generation,
            configuration_name=found.name,
            rate_mHz=found.rate_mHz,
            rows=len(sheet.rows_of(found.drives, full)),
            sample_bytes=found.sample_bytes,
            drives=found.drives,
            idle_drives=found.idle_drives,
            max_payload=64,
            uptime_ms=int((time.monotonic() - self.booted_s) * 1000) % 2**32,
            line_bytes_per_s=1_000_000,
            volts_per_count=self._volts_per_count,
        )
        values |= self.options.hello  # in the order of HELLO, whatever is changed
        return codec.pack(codec.HELLO, tag, *values.values())

    def _stream(self, kind: int, fields: tuple[Any, ...]) -> tuple[int, int]:
        if kind == codec.SET_MODE:
            mode = fields[1]
            if mode > 1 or (mode and not self.configuration.idle_drives):
                return codec.BAD_VALUE, mode
            self.idle = bool(mode)
            self.next_s = time.monotonic() + self.period_s()
            return codec.OK, mode
        self.streaming = kind == codec.START
        if self.streaming:
            self.left = fields[1] or None
            self.started, self.dropped = False, 0
            self.next_s = time.monotonic() + self.period_s()
        return codec.OK, self.sequence % 2**32

    def _ack(self, tag: int, kind: int, code: int, detail: int) -> bytes:
        return codec.pack(codec.ACK, tag, kind, code, detail)

    def _voltages(self) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        noises = np.random.default_rng(15).normal(0, NOISE, (NOISES, 208))
        read = [sheet.voltages(place) for place in TOUCHES]
        full = np.array([volts * (1 + noise) for volts in read for noise in noises])  # (patterns, 208)
        every = sheet.table(full=True)
        return full[:, [every.index(row) for row in sheet.table()]], full
