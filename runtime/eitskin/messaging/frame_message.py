"""From a frame's record to its message: numbered, the map copied only when it is another one, stamped at the very end.

Packing has two halves, since between them the frame is held against its latency budget::

    begin     number, map                           stamp: pack
    finish    texts, all numbers, the age           stamp: publish
"""

import os
import time
from typing import Final, NamedTuple

from eitskin.messaging.frame import TOUCHED
from eitskin.messaging.frame_packer import FramePacker
from eitskin.messaging.frame_record import PACK, PUBLISH, FrameRecord

MAP_UNCHANGED: Final = ("map:unchanged",)
"""What is skipped in a message without its map."""

ZERO: Final = "zero"
"""Instead of a map's key: nothing was computed."""


class FrameMessages:
    """Makes the message of one frame after another, in the memory of one.

    Args:
        configuration: Name and digest of the device's configuration.
        bundle: Id.
        serial_number: Of the device.
        shape: Rows and columns of the map.
    """

    __slots__ = ("_packed_map", "_packer", "_sent_map", "_short", "published", "run")

    def __init__(self, configuration: str, bundle: str, serial_number: str, shape: tuple[int, int]) -> None:
        self.run = os.urandom(4).hex()
        """Differs after each start."""
        self._packer = FramePacker(
            configuration=configuration, bundle=bundle, serial_number=serial_number, run=self.run, shape=shape
        )
        self.published = 0
        """Frames packed so far."""
        self._sent_map: tuple[int, int] | None = None
        """The key of the map that went out last; None where none did."""
        self._packed_map: tuple[int, int] | str | None = None
        """The key of the map that the packer holds, or :data:`ZERO`."""
        self._short = False

    def begin(self, record: FrameRecord, *, short: bool, frames: bool = True) -> None:
        """Give a frame its number and copy its map.

        Args:
            record: The frame.
            short: Leave the map out if it is that of the frame before, which every subscriber has.
            frames: Whether somebody takes frames; else only the touch message will be asked for, and no map is copied.
        """
        self.published += 1
        if not frames:
            self._short, self._sent_map = False, None
            record.stamps[PACK] = time.perf_counter_ns()
            return
        key = record.map_key
        self._short = short and key == self._sent_map
        self._sent_map = key
        if self._short:
            record.skipped += MAP_UNCHANGED
        else:
            packed = ZERO if record.map_is_zero else key
            if packed != self._packed_map:
                self._packer.put_map(record.map)
                self._packed_map = packed
        record.stamps[PACK] = time.perf_counter_ns()

    def finish(self, record: FrameRecord) -> memoryview:
        """Return the message of the frame, with publishing stamped as now; the next frame overwrites it."""
        packer, stamps = self._packer, record.stamps
        packer.put_texts(record.solver, record.skipped, record.events, record.electrodes)
        packer.put_touches(record.touches)
        stamps[PUBLISH] = time.perf_counter_ns()
        age_us = max(0, (stamps[PUBLISH] - record.scanned_ns) // 1000)
        packer.put_numbers(
            (self.published, record.sequence, record.device_us, age_us, TOUCHED[record.touched], record.gate_logit,
             record.cloud, record.weak_rows, record.map_sequence, *record.drift, *stamps, record.lost,
             record.corrupt, record.withheld, record.overrun)
        )  # fmt: skip
        return packer.short_message() if self._short else packer.message()

    def touch_message(self) -> bytes:
        """Return the message, of the frame that was finished last, of those that take touches without maps."""
        return self._packer.touch_message()


class Asked(NamedTuple):
    """What takers of messages ask for besides."""

    frames: bool = True
    """Somebody takes frames, with their maps."""
    touches: bool = False
    """Somebody needs touches."""
    alone: bool = False
    """Somebody takes touches without maps."""


class LastMessage:
    """Takes every message, whole, in this process.

    Args:
        touches: Whether the messages have the touches.
    """

    __slots__ = ("asked", "message")
    wanted, short = True, False

    def __init__(self, *, touches: bool = False) -> None:
        self.asked = Asked(touches=touches)
        self.message = b""
        """A copy of the last one."""

    def send(self, message: memoryview) -> None:
        """Keep a copy."""
        self.message = bytes(message)
