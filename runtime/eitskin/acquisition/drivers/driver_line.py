"""A line behind which a driver answers in place of a device.

It is a :class:`eitskin.acquisition.transport.Transport`: it answers HELLO, START and STOP as a device does, and packs
each scan of the driver as VOLTS (:mod:`eitskin_proto.wire.volts`). So everything that takes a line takes any device:
handshake, recovery, hot plugging, capture, doctor.

A complex row is projected on the phase that it had in the first scan. The result is positive, and half of the noise is
left out. A device without a clock has the host's.
"""

import json
import math
import os
import select
import time
from contextlib import suppress
from dataclasses import replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin.acquisition.drivers.driver import Driver, Scan
from eitskin.errors import HandshakeError, NotReady, PortLost, ProtocolError
from eitskin_proto.wire import messages
from eitskin_proto.wire.codes import Code, HelloFlag, Mode
from eitskin_proto.wire.framing import Deframer, crc32c, encode
from eitskin_proto.wire.volts import DRIVER_ID, LARGEST_VOLTS, DriverHello, pack_volts

USUAL_RATE_HZ: Final = 10.0
"""Taken where a driver does not know its rate; it decides when a stream is silent."""

FINEST_SHARE: Final = 1 << 24
"""Steps in the full scale where a driver does not know its converter."""

LARGEST_V: Final = 1e6
"""Full scale where a driver does not know it."""

RATE_CHECK_S: Final = 5.0
"""For which scans are counted before the rate that a driver states is checked, and at least ``RATE_CHECK_SCANS``."""

RATE_CHECK_SCANS: Final = 20
RATE_FACTOR: Final = 2.0
"""By which the rate may differ from the stated one."""


def hello_of(driver: Driver) -> DriverHello:
    """Return what a driver says of its device.

    Raises:
        HandshakeError: It does not say so in a way that can be used.
    """
    table, full_V = driver.table, driver.full_scale_V or LARGEST_V
    step_V = driver.step_V or (full_V if driver.full_scale_V else 1.0) / FINEST_SHARE
    electrodes = b"" if table.electrodes is None else table.electrodes.tobytes()
    settings = {**driver.settings, "table": table.id}
    try:
        found = DriverHello(
            firmware_version=(0, 0, 0), hardware_id=DRIVER_ID, serial_number=driver.serial_number,
            configuration_digest=crc32c(json.dumps(settings, sort_keys=True, default=str).encode()), generation=0,
            configuration_name=driver.name, rate_mHz=round(1000 * (_rate_hz(driver) or USUAL_RATE_HZ)), rows=table.rows,
            sample_bytes=8, volts_per_count=1.0, step_V=step_V, full_scale_V=full_V, signed=int(driver.signed),
            table_name=table.name[:16], electrodes=electrodes,
        )  # fmt: skip
        DriverHello.unpack(found.pack())
    except (ValueError, OverflowError, ProtocolError) as error:
        raise HandshakeError(f"the driver {driver.name} describes its device wrongly: {error}") from error
    return found


def _rate_hz(driver: Driver) -> float:
    """Return scans per second, as the driver says or has measured; 0 if unknown."""
    return float(driver.rate_hz or getattr(driver, "measured_hz", 0.0))


class DriverLine:
    """A line to a driver, which ``close`` closes.

    Args:
        driver: It is open.
        name: Of the port, for people.

    Raises:
        HandshakeError: The driver's description cannot be used.
    """

    line_bytes_per_s = 0
    largest_payload = LARGEST_VOLTS

    def __init__(self, driver: Driver, name: str = "") -> None:
        self.name, self._driver = name or driver.name, driver
        self.hello = hello_of(driver)
        self._requests, self._out = Deframer(), bytearray()
        self._sequence = self._scans = 0
        self._streaming = self._rate_is_known = self._looks = False
        self._first_s = 0.0
        self._axes: npt.NDArray[np.complex128] | None = None
        self._own_clock = True
        self._wake = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._poll = select.poll()
        self._poll.register(self._wake, select.POLLIN)
        self._poll.register(driver.fileno(), select.POLLIN)

    @property
    def trouble(self) -> str:
        """What the driver received in place of scans; "" if it says nothing."""
        return str(getattr(self._driver, "trouble", ""))

    def read(self, timeout_s: float | None = None) -> bytes:
        """Return answers and scans, waiting for the first; nothing after the timeout or ``cancel``.

        Raises:
            PortLost: The device is gone.
            HandshakeError: It sends another number of rows than the driver says, or at another rate.
        """
        end_s = math.inf if timeout_s is None else time.perf_counter() + timeout_s
        while not self._out:
            if self._looks:  # a driver may hold scans already, which no further byte announces
                self._looks = False
                self._take_scans()
                continue
            left_s = end_s - time.perf_counter()
            ready = self._poll.poll(None if left_s == math.inf else max(0, math.ceil(1000 * left_s)))
            if any(file == self._wake for file, _ in ready):
                os.eventfd_read(self._wake)
                return b""
            if ready:
                self._take_scans()
            if left_s <= 0.0:  # what comes may be no scan
                break
        found = bytes(self._out)
        self._out.clear()
        return found

    def _take_scans(self) -> None:
        try:
            for scan in self._driver.scans():
                if self._streaming:
                    self._out += encode(self._packed(scan), LARGEST_VOLTS)
        except OSError as error:
            raise PortLost(
                f"{self.name} vanished ({error}): check the cable and the power, then start again"
            ) from error

    def _packed(self, scan: Scan) -> bytes:
        now_s, rows = time.perf_counter(), self.hello.rows
        if scan.voltages.shape != (rows,):
            raise HandshakeError(
                f"{self.name} sent a scan of shape {scan.voltages.shape}, expected the {rows} rows of "
                f"{self.hello.table_name}; correct the driver or its options"
            )
        self._sequence += 1 + scan.lost
        self._check_rate(now_s, 1 + scan.lost)
        self._own_clock &= scan.device_us is None
        device_us = self._now_us() if scan.device_us is None else scan.device_us
        amount = np.abs(scan.voltages)
        return pack_volts(
            self._projected(scan.voltages), self._sequence, device_us, ~(amount < self.hello.full_scale_V)
        )

    def _projected(self, voltages: npt.NDArray[np.number]) -> npt.NDArray[np.float64]:
        """Return the component of complex voltages along the phase of the first scan; real ones as they are."""
        if voltages.dtype.kind != "c":
            return voltages.astype(np.float64)
        if self._axes is None:
            size = np.abs(voltages)
            self._axes = np.where(size > 0.0, np.conj(voltages) / np.maximum(size, 1e-300), 1.0)
        return np.asarray((voltages * self._axes).real, dtype=np.float64)

    def _check_rate(self, now_s: float, count: int) -> None:
        """Refuse a device whose scans come at another rate than the driver says, once there were enough."""
        if not self._scans:
            self._first_s, count = now_s, 1
        self._scans += count
        passed_s = now_s - self._first_s
        if self._rate_is_known or passed_s < RATE_CHECK_S or self._scans <= RATE_CHECK_SCANS:
            return
        self._rate_is_known, found, stated = True, (self._scans - 1) / passed_s, self._driver.rate_hz
        if stated and not stated / RATE_FACTOR < found < stated * RATE_FACTOR:
            raise HandshakeError(
                f"{self.name} says that it sends {stated:g} scans/s, but sends {found:.3g}; state its rate as it is"
            )

    def write(self, data: bytes) -> None:
        """Take requests; their answers come with the next ``read``.

        Raises:
            NotReady: The device does not take a setting, or sends nothing.
            PortLost: It is gone.
        """
        for payload in self._requests.feed(data):
            answer = self._answer(messages.unpack(payload))
            if answer is not None:
                self._out += encode(answer, LARGEST_VOLTS)

    def _answer(self, request: Any) -> bytes | None:
        kind, code = request.LAYOUT.type, Code.OK
        match request:
            case messages.HelloRequest():
                if self._streaming and not self._scans:
                    why = self.trouble or "nothing came"
                    raise NotReady(f"{self.name} sends no scans: {why}; check its cable, its supply and the options")
                return self._greeting(request.tag)
            case messages.TimeRequest():
                return messages.Time(self._now_us(), request.tag).pack() if self._own_clock else None
            case messages.Start() | messages.Stop():
                self._let(streaming=isinstance(request, messages.Start))
            case messages.SetMode():
                code = Code.OK if request.mode == Mode.ACTIVE else Code.BAD_VALUE
            case _:
                code = Code.UNKNOWN_TYPE
        return messages.Ack(kind, code, 0, request.tag).pack()

    def _greeting(self, tag: int) -> bytes:
        return replace(self.hello, tag=tag, flags=int(HelloFlag.STREAMING) if self._streaming else 0).pack()

    def _let(self, *, streaming: bool) -> None:
        """Start or stop the device; a second START sets it up again."""
        try:
            if self._streaming:
                self._driver.stop()
            self._streaming = False
            if streaming:
                self._scans, self._out = 0, bytearray()
                self._driver.start()
                self._streaming = self._looks = True
        except OSError as error:
            raise PortLost(
                f"{self.name} vanished ({error}): check the cable and the power, then start again"
            ) from error

    @staticmethod
    def _now_us() -> int:
        return time.perf_counter_ns() // 1000 & 0xFFFFFFFF

    def cancel(self) -> None:
        """Make the ``read`` that waits now, or else the next one, return at once; safe in a signal handler."""
        if self._wake >= 0:
            os.eventfd_write(self._wake, 1)

    def report(self) -> list[str]:
        """Return the device and its settings, for people."""
        hello, settings = self.hello, ", ".join(f"{key} {value}" for key, value in self._driver.settings.items())
        rate = f"{rate_hz:g} scans/s" if (rate_hz := _rate_hz(self._driver)) else "rate unknown"
        return [
            f"driver {hello.configuration_name}: {hello.serial_number}, {hello.rows} rows ({hello.table_name}), "
            f"{rate}, step {hello.step_V:.3g} V",
            *([f"settings: {settings}"] if settings else []),
        ]

    def close(self) -> None:
        """Close the driver; a second call does nothing."""
        if self._wake < 0:
            return
        with suppress(OSError):
            self._driver.close()
        wake, self._wake = self._wake, -1  # in this order: ``cancel`` may come from a signal in between
        os.close(wake)
