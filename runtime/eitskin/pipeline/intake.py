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
``frozen``            readings of a frame before, in more rows than chance allows (:mod:`eitskin.reference.repeats`)
``reversed``          rows have the other sign than their reference, as no sheet's have
``unlike``            rows fit neither each other nor any touch (:mod:`eitskin.health.evidence`)
``stale``             over budget, and a newer frame was waiting
====================  ===============================================================

The next frame that is published says so in its events: ``withheld:implausible``.
"""

from collections import deque
from typing import Any, Final

import numpy as np
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
                  "frozen", "reversed", "unlike", "stale")  # fmt: skip
"""Why frames are withheld."""

WITHHELD: Final = {reason: f"withheld:{reason}" for reason in REASONS}
"""The event of the next published frame."""

REMEMBERED: Final = (64, 2000)
"""Least and most of the last frames that a frame is compared with; those of a second between."""

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
        "_known",
        "_order",
        "_record",
        "_samples",
        "_since",
        "_view",
        "_width",
        "clock",
        "counter",
        "generation",
        "generation_differs",
        "heard_ns",
        "last_reason",
        "remembered",
        "repeated",
        "withheld",
        "withheld_total",
    )  # fmt: skip

    def __init__(self, hello: Hello, record: FrameRecord, idle_drives: int | None) -> None:
        self._record = record
        self._idle_drives = idle_drives
        self._view = view_of(hello)
        self._samples = samples_at(hello)
        self.counter = StreamCounter()
        self.clock = DeviceClock()
        self.remembered = int(np.clip(hello.rate_mHz // 1000, *REMEMBERED))
        """Different frames that a frame is compared with."""
        self._order: deque[int] = deque()
        self._known: set[int] = set()
        self.repeated = 0
        """Frames in a row, up to the one accepted last, all samples of which are those of an earlier one."""
        self.forget()
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
        samples = hash(payload[self._samples :])
        if samples in self._known:
            self.repeated += 1
        else:
            self.repeated = 0
            self._known.discard(self._order.popleft())
            self._known.add(samples)
            self._order.append(samples)
        if idle != record.idle:
            record.idle = idle
            self.add_event("idle" if idle else "awake")
        record.events = ("saturated",) if view.saturation else ()
        record.sequence, record.device_us = step.sequence, step.device_us
        record.scanned_ns = self.clock.scanned_ns(step.device_us, read_ns)
        record.stamps[READ] = read_ns
        return True

    def forget(self) -> None:
        """Compare the next frames with none before them: they are read anew, as from a recording that begins again."""
        self._order = deque(range(1 << 62, (1 << 62) + self.remembered))  # no hashes, but as large: memory stays
        self._known = set(self._order)

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
            self.forget()
            self.clock.restart()
            self.add_event("device_reset")
        elif step.lost:
            self.add_event("lost")
        return step

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
