"""From a payload to counts with a time, or the reason to withhold the frame.

A frame that is not fit to publish is withheld, with a reason and a count:

====================  ===============================================================
``malformed``         an intact packet that is no frame of this device
``duplicate``         the same sequence number again
``configuration``     made under another generation than HELLO named
``partial``           a scan of some drives only, without a gate for them
``implausible``       dV is not finite or beyond 1e6, or the map is not finite
``no_signal``         no row reaches a thousandth of its reference: no current flows
``stuck``             rows are alike as no sheet's are (:mod:`eitskin.reference.front_end`)
``frozen``            the samples of a frame before, bit by bit, though the reference's frames had noise
``stale``             over budget, and a newer frame was waiting
====================  ===============================================================

The next frame that is published says so in its events: ``withheld:implausible``.
"""

from collections import deque
from typing import Any, Final

import numpy.typing as npt

from eitskin.acquisition.device import DeviceClock
from eitskin.frame_record import READ, FrameRecord
from eitskin_proto.errors import ProtocolError
from eitskin_proto.sensor.table import N_FULL_ROWS
from eitskin_proto.wire.codes import FrameFlag
from eitskin_proto.wire.frames import Step, StreamCounter
from eitskin_proto.wire.messages import Hello
from eitskin_proto.wire.scan_rows import ALL_DRIVES
from eitskin_proto.wire.volts import DriverHello, samples_at, view_of

REASONS: Final = ("malformed", "duplicate", "configuration", "partial", "implausible", "no_signal", "stuck",
                  "frozen", "stale")  # fmt: skip
"""Why frames are withheld."""

WITHHELD: Final = {reason: f"withheld:{reason}" for reason in REASONS}
"""The event of the next published frame."""

REPEAT_FRAMES: Final = 8
"""Frames that a frame may repeat: a front end that hangs may have several buffers."""

_FIRST_BYTES: Final = 12
"""Of the samples, which are compared first: those of the strongest rows."""

_FULL: Final = int(FrameFlag.FULL)


class Intake:
    """Decodes frames, and withholds and counts those unfit to publish.

    Args:
        hello: Of the device.
        record: Where a frame's numbers go.
        idle_drives: Allowed drives of a partial scan; None without an idle gate.
    """

    __slots__ = (
        "_full",
        "_idle_drives",
        "_payloads",
        "_recent",
        "_record",
        "_repeated",
        "_samples",
        "_samples_end",
        "_since",
        "_view",
        "_width",
        "clock",
        "counter",
        "generation",
        "generation_differs",
        "heard_ns",
        "last_reason",
        "most_repeats",
        "withheld",
        "withheld_total",
    )  # fmt: skip

    def __init__(self, hello: Hello, record: FrameRecord, idle_drives: int | None) -> None:
        self._record = record
        self._idle_drives = idle_drives
        self._view = view_of(hello)
        self._samples = samples_at(hello)
        self._samples_end = self._samples + _FIRST_BYTES
        self.counter = StreamCounter()
        self.clock = DeviceClock()
        self._recent: deque[bytes] = deque(maxlen=REPEAT_FRAMES)
        self._payloads: deque[bytes] = deque(maxlen=REPEAT_FRAMES)
        self._repeated = 0
        self.most_repeats: tuple[int | None, int | None] = (None, None)
        """Repetitions in a row that are still chance, of whole scans and of idle ones; None where nothing can tell."""
        self.heard_ns = 0
        """When the last frame of this device's configuration was read, fit or not."""
        self.last_reason = ""
        """Why a frame was withheld last."""
        self._width, self._full = (
            hello.sample_bytes,
            0 if isinstance(hello, DriverHello) or hello.rows != N_FULL_ROWS else _FULL,
        )
        self.generation = hello.generation
        """Of the configuration that frames must carry."""
        self.generation_differs = False
        """A frame carried another one, so the device must be asked for HELLO."""
        self.withheld = dict.fromkeys(REASONS, 0)
        """Frames that were not fit to publish."""
        self.withheld_total = 0
        self._since: tuple[str, ...] = ()
        """Events of earlier frames for the next published one."""

    @property
    def counts(self) -> npt.NDArray[Any]:
        """Of the frame accepted last; of a driver's, volts."""
        return self._view.counts

    @property
    def saturation(self) -> int:
        """Bit r: row r of the frame accepted last was cut off."""
        return self._view.saturation

    def greet(self, hello: Hello) -> None:
        """Adopt the HELLO of a repeated handshake."""
        self.generation = hello.generation
        self.generation_differs = False

    def accept(self, payload: bytes, read_ns: int) -> bool:
        """Decode a frame and return whether it may go on.

        Args:
            payload: Of a FRAME, or VOLTS of a driver.
            read_ns: When its last byte was in hand.
        """
        view, record = self._view, self._record
        try:
            view.load(payload)
        except ProtocolError:
            return self.withhold("malformed")
        if view.sample_bytes != self._width or view.flags & _FULL != self._full:
            return self.withhold("malformed")
        step = self._counted()
        if step.duplicate:
            return self.withhold("duplicate")
        if view.generation != self.generation:
            self.generation_differs = True
            return self.withhold("configuration")
        idle = view.drives != ALL_DRIVES
        if idle and view.drives != self._idle_drives:
            return self.withhold("partial")
        self.heard_ns = read_ns
        first = payload[self._samples : self._samples_end]
        if first in self._recent and self._repeats(payload):
            self._repeated += 1
            most = self.most_repeats[idle]
            if most is not None and self._repeated >= most and view.counts.any():  # zeros are no signal
                return self.withhold("frozen")
        else:
            self._repeated = 0
            self._recent.append(first)
            self._payloads.append(payload)
        if idle != record.idle:
            record.idle = idle
            self.add_event("idle" if idle else "awake")
        record.events = ("saturated",) if view.saturation else ()
        record.sequence, record.device_us = step.sequence, step.device_us
        record.scanned_ns = self.clock.scanned_ns(step.device_us, read_ns)
        record.stamps[READ] = read_ns
        return True

    def load(self, payload: bytes) -> bool:
        """Decode a frame without judging or counting it, and return whether all drives were scanned.

        Raises:
            ProtocolError: It is not a scan of this device.
        """
        self._view.load(payload)
        return self._view.drives == ALL_DRIVES

    def _counted(self) -> Step:
        """Count the current frame, and add its events, a reset or lost frames, to the next published one."""
        step = self.counter.step(self._view.sequence, self._view.device_us)
        if step.reset:
            self.clock.restart()
            self.add_event("device_reset")
        elif step.lost:
            self.add_event("lost")
        return step

    def _repeats(self, payload: bytes) -> bool:
        """Return whether all samples of a frame are those of one that is remembered."""
        at = self._samples
        return any(payload[at:] == before[at:] for before in self._payloads)

    def discard(self, payload: bytes) -> None:
        """Take note of a frame that is left out because a newer one waits; it is not counted as lost."""
        try:
            self._view.load(payload)
        except ProtocolError:
            self.withhold("malformed")
            return
        self._counted()
        self.withhold("stale")

    def withhold(self, reason: str) -> bool:
        """Count a frame that is not published, and return False."""
        self.withheld[reason] += 1
        self.withheld_total += 1
        self.last_reason = reason
        self.add_event(WITHHELD[reason])
        return False

    def add_event(self, event: str, most: int | None = None) -> None:
        """Add an event to the next published frame; in the frame loop's thread.

        Args:
            event: The event.
            most: Omit it if there are this many events already; None for an event that is never omitted.
        """
        if event not in self._since and (most is None or len(self._since) < most):
            self._since += (event,)

    def give_up(self, reason: str) -> bool:
        """Withhold the frame in hand, which was accepted, and return False; the next one says what it would have said.

        That rows were cut off is of that frame alone.
        """
        for event in self._record.events:
            if event != "saturated":
                self.add_event(event)
        return self.withhold(reason)

    def name_events(self) -> None:
        """Put earlier events and the totals into the current frame."""
        record = self._record
        if self._since:
            record.events = (*self._since, *(event for event in record.events if event not in self._since))
            self._since = ()
        record.lost, record.withheld = self.counter.lost, self.withheld_total
