"""Scans that this program has itself: put in one at a time, taken from an iterable, or measured on request.

:class:`Feed` is a driver without a device. A program puts its voltages in; an eventfd wakes the frame loop. A thread
of :class:`Pump` does so for an iterable, or for a driver whose ``measure`` blocks.
"""

import os
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from itertools import chain
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin.acquisition.drivers.driver import Described, Driver, PolledDriver, Scan
from eitskin.acquisition.drivers.driver_line import DriverLine
from eitskin.errors import PortLost
from eitskin_proto.sensor.row_table import RowTable, table_of, usual_table

MOST_WAITING: Final = 64
"""Scans that wait to be taken; then the oldest are lost, and counted."""


class Feed:
    """Scans of a program's own.

    Args:
        table: Their rows: a name such as ``adjacent-208``, (rows, 4) electrodes, or a number of rows.
        name: For people.
        serial_number: Of the device that they come from; a reference belongs to it.
        settings: All that changes its voltages; a reference belongs to it, too.
        rate_hz: Scans per second; 0 if unknown.
        step_V: Of the converter; 0 if unknown.
        full_scale_V: Of the converter; 0 if unknown.
        signed: False for amounts and for complex voltages.

    Raises:
        ValueError: The table is none.
    """

    def __init__(
        self,
        table: Any = "adjacent-104",
        *,
        name: str = "feed",
        serial_number: str = "FEED",
        settings: Mapping[str, object] | None = None,
        rate_hz: float = 0.0,
        step_V: float = 0.0,
        full_scale_V: float = 0.0,
        signed: bool = True,
    ) -> None:
        self.table: RowTable = table_of(table)
        self.name, self.serial_number, self.settings = name, serial_number, dict(settings or {})
        self.rate_hz, self.step_V, self.full_scale_V, self.signed = rate_hz, step_V, full_scale_V, signed
        self._waiting: deque[Scan] = deque()
        self._lost = 0
        self._lock = threading.Lock()
        self._ready = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._failed: Exception | None = None

    def put(self, voltages: npt.ArrayLike, device_us: int | None = None) -> None:
        """Add a scan, from any thread.

        Args:
            voltages: (rows,) V, real or complex.
            device_us: When it was made, in microseconds of the device's clock; None if unknown.

        Raises:
            ValueError: It has another number of rows, or NaN for a time.
        """
        found = np.asarray(voltages)
        if found.shape != (self.table.rows,) or found.dtype.kind not in "fiuc":
            raise ValueError(f"a scan has shape {found.shape} {found.dtype}, expected ({self.table.rows},) volts")
        with self._lock:
            if len(self._waiting) == MOST_WAITING:
                self._lost += 1 + self._waiting.popleft().lost
            self._waiting.append(Scan(found, None if device_us is None else int(device_us), self._lost))
            self._lost = 0
            self._tell()

    def fail(self, error: Exception) -> None:
        """End the stream with an error once what waits is taken."""
        self._failed = error
        with self._lock:
            self._tell()

    def _tell(self) -> None:
        """Wake the reader, unless it has closed the feed; under the lock."""
        if self._ready >= 0:
            os.eventfd_write(self._ready, 1)

    def fileno(self) -> int:
        """Return a descriptor that is readable while scans wait."""
        return self._ready

    def scans(self) -> Iterator[Scan]:
        """Yield what waits.

        Raises:
            PortLost: The stream has ended.
        """
        with suppress(BlockingIOError):
            os.eventfd_read(self._ready)
        while self._waiting:
            with self._lock:
                scan = self._waiting.popleft()
            yield scan
        if (error := self._failed) is not None:
            with self._lock:
                self._tell()  # for the next read
            raise PortLost(f"{self.name} ended: {error}") from error

    def start(self) -> None:
        """Forget what waits from before."""
        with self._lock:
            self._waiting.clear()

    def stop(self) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Give the descriptor back; a second call does nothing."""
        with self._lock:
            ready, self._ready = self._ready, -1
            if ready >= 0:
                os.close(ready)


class Pump(Feed):
    """A feed that a thread fills.

    Args:
        described: Says what the scans are; it is started, stopped and closed with the pump.
        following: Returns the next scan's voltages, and may block.
        period_s: Shortest time between two scans.
    """

    measured_hz = 0.0
    """Scans per second of a device that does not say, as the first one took; 0 if unknown."""

    def __init__(
        self,
        described: Described,
        following: Callable[[], npt.ArrayLike],
        period_s: float = 0.0,
    ) -> None:
        super().__init__(
            described.table, name=described.name, serial_number=described.serial_number, settings=described.settings,
            rate_hz=described.rate_hz, step_V=described.step_V, full_scale_V=described.full_scale_V,
            signed=described.signed,
        )  # fmt: skip
        self._described, self._following, self._period_s = described, following, period_s
        self._runs = threading.Event()
        self._ended = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Begin to measure."""
        super().start()
        self._described.start()
        self._runs.set()
        if self._thread is None:
            self._thread = threading.Thread(target=self._pump, name=self.name, daemon=True)
            self._thread.start()

    def stop(self) -> None:
        """Cease to measure."""
        self._runs.clear()
        self._described.stop()

    def _pump(self) -> None:
        due_s = time.perf_counter()
        while not self._ended.is_set():
            self._runs.wait()
            try:
                self.put(self._following())
            except StopIteration:
                self.fail(EOFError("it has no more scans"))
                return
            except Exception as error:  # of a device's or a program's own code; the reader raises it
                self.fail(error)
                return
            due_s = max(due_s + self._period_s, time.perf_counter())
            self._ended.wait(max(0.0, due_s - time.perf_counter()) if self._period_s else 0.0)

    def close(self) -> None:
        """End the thread as soon as its scan is made, and close the driver; a second call does nothing."""
        self._ended.set()
        self._runs.set()
        self._described.close()
        super().close()


def line_of(source: Any, name: str = "") -> DriverLine:
    """Return a line to a driver, to a polled one, or to scans that come from an iterable.

    Args:
        source: A :class:`Driver` or :class:`PolledDriver`, or an iterable of (rows,) V.
        name: Of the port, for people.

    Raises:
        HandshakeError: A driver's description cannot be used.
        ValueError: It is none of these, or an iterable without scans.
    """
    if hasattr(source, "scans"):
        driver: Driver = source
    elif hasattr(source, "measure"):
        polled: PolledDriver = source
        driver = pump = Pump(polled, polled.measure, 1.0 / polled.rate_hz if polled.rate_hz else 0.0)
        if not polled.rate_hz:
            polled.start()
            begin_s = time.perf_counter()
            polled.measure()
            pump.measured_hz = float(f"{1.0 / max(time.perf_counter() - begin_s, 1e-3):.2g}")
            polled.stop()
    elif isinstance(source, Iterable):
        scans = iter(source)
        try:
            first = np.asarray(next(scans))
        except StopIteration:
            raise ValueError("source has no scans, expected an iterable of (rows,) volts") from None
        rest = chain([first], scans)
        described = Feed(usual_table(first.size), name="iterable", signed=first.dtype.kind != "c")
        driver = Pump(described, lambda: next(rest))
    else:
        raise ValueError(f"source is {type(source).__name__}, expected a driver, eitskin.Feed or an iterable of scans")
    return DriverLine(driver, name)
