"""``sciospec:PATH``: a Sciospec EIT device with 16 or 32 channels on its full-speed USB port.

A message is ``tag length data tag``, big-endian, without a check sum. The device answers each command with an ACK,
which the set-up waits for. A frame is one message for each drive and group of 16 channels::

    B4 89 group in out  u16 frequency  u32 ms  16 x (f32 re, f32 im)  B4

Options: ``rate`` (scans/s, default 40), ``current`` (A, default 0.001), ``frequency`` (Hz, default 20000),
``electrodes`` (16 or 32), ``drive`` (``adjacent`` or ``opposite``), ``serial`` (a name that the reference belongs to).
"""

import struct
import time
from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from eitskin.acquisition.drivers.driver import Scan, parse_rest
from eitskin.acquisition.serial_port import SerialPort
from eitskin.errors import NotReady
from eitskin_proto.sensor.row_table import named

ACK_S: Final = 2.0
"""Longest wait for the answer to a command."""

BAUD: Final = 9600
"""The USB port ignores it."""

ACK, FRAME, SET_UP, OUTPUT = 0x18, 0xB4, 0xB0, 0xB2
ACCEPTED: Final = 0x83
REFUSED: Final = (0x01, 0x02, 0x81, 0x82)
"""Codes of the ACK to a command that was wrong, late, not executed, not known."""

FRAME_BYTES: Final = 140
CHANNELS: Final = 16
"""Of a group."""

FULL_SCALE_V: Final = 10.0


class Sciospec:
    """A driver of the device (:class:`eitskin.acquisition.drivers.driver.Driver`).

    Args:
        port: It is open.
        options: Of the port's name.

    Raises:
        NotReady: It does not answer.
        ValueError: An option is wrong.
    """

    name = "sciospec"
    signed, step_V, full_scale_V = False, 0.0, FULL_SCALE_V

    def __init__(self, port: Any, options: Any) -> None:
        self._port, self._buffer, self._damaged = port, b"", 0
        self.rate_hz = options.number("rate", 40.0, above=0.0, high=100.0)
        self._current_A = options.number("current", 1e-3, low=1e-7, high=1e-2)
        self._frequency_hz = options.number("frequency", 20e3, low=100.0, high=1e6)
        self._electrodes = n = options.whole("electrodes", 16, low=16, high=32)
        drive = options.choice("drive", ("adjacent", "opposite"), "adjacent")
        self.serial_number = str(options.value("serial", "SCIOSPEC"))[:16]
        options.close()
        if n % CHANNELS:
            raise ValueError(f"sciospec electrodes is {n}, expected 16 or 32")
        self._reach = 1 if drive == "adjacent" else n // 2
        self.table = named(f"{drive}-{n * (n - (3 if drive == 'adjacent' else 4))}")
        self.settings = {"rate_hz": self.rate_hz, "current_A": self._current_A, "frequency_hz": self._frequency_hz}
        assert self.table.electrodes is not None
        self._drive, _, self._plus, self._minus = self.table.electrodes.astype(np.intp).T
        self._potentials = np.zeros((n, n), dtype=np.complex128)
        self._have: set[tuple[int, int]] = set()
        self._command(b"\xb4\x01\x00\xb4", "stop", required=False)

    def start(self) -> None:
        """Set the device up, and start it.

        Raises:
            NotReady: It does not answer, or refuses a setting.
        """
        n = self._electrodes
        self._command(b"\xb4\x01\x00\xb4", "stop", required=False)
        self._command(b"\xb0\x01\x01\xb0", "reset of the set-up")
        self._command(b"\xb0\x03\x02\x00\x00\xb0", "burst count")
        self._command(b"\xb0\x09\x05" + struct.pack(">d", self._current_A) + b"\xb0", "current")
        self._command(b"\xb0\x03\x08\x01\x01\xb0", "single-ended measurement")
        self._command(b"\xb0\x05\x03" + struct.pack(">f", self.rate_hz) + b"\xb0", "frame rate")
        frequency = struct.pack(">ffHB", self._frequency_hz, self._frequency_hz, 1, 0)
        self._command(b"\xb0\x0c\x04" + frequency + b"\xb0", "frequency")
        for k in range(n):
            self._command(bytes([SET_UP, 3, 6, k + 1, (k + self._reach) % n + 1, SET_UP]), "drive")
        for output in (1, 2, 3):
            self._command(bytes([OUTPUT, 2, output, 1, OUTPUT]), "output")
        self._have, self._damaged = set(), 0
        self._command(b"\xb4\x01\x01\xb4", "start")

    def _command(self, command: bytes, what: str, *, required: bool = True) -> None:
        """Send a command and wait for its ACK."""
        self._port.write(command)
        end_s = time.monotonic() + ACK_S
        while (left_s := end_s - time.monotonic()) > 0.0:
            for message in self._messages(left_s):
                if message[0] == ACK and message[2] in REFUSED and required:
                    raise NotReady(
                        f"{self._port.name} refused the {what}, with code {message[2]:#04x}; check the options"
                    )
                if message[0] == ACK and message[2] in (ACCEPTED, *REFUSED):
                    return
        raise NotReady(
            f"{self._port.name} did not acknowledge the {what} within {ACK_S:g} s: is it a Sciospec device, is it on?"
        )

    def _messages(self, timeout_s: float) -> Iterator[bytes]:
        """Yield whole messages; bytes that begin none are dropped one at a time."""
        self._buffer += self._port.read(timeout_s)
        while len(self._buffer) >= 2 and len(self._buffer) >= self._buffer[1] + 3:
            end = self._buffer[1] + 3
            if self._buffer[end - 1] != self._buffer[0]:
                self._buffer = self._buffer[1:]
                continue
            message, self._buffer = self._buffer[:end], self._buffer[end:]
            yield message

    @property
    def trouble(self) -> str:
        """What came in place of scans."""
        return f"of the last scan {len(self._have)} of {self._electrodes**2 // CHANNELS} messages came"

    def fileno(self) -> int:
        """Return the port's descriptor."""
        return int(self._port.fileno())

    def scans(self) -> Iterator[Scan]:
        """Yield complete scans.

        Raises:
            PortLost: The port is gone.
        """
        n = self._electrodes
        for message in self._messages(0.0):
            if message[0] != FRAME or len(message) != FRAME_BYTES:
                continue
            group, k = message[2] - 1, message[3] - 1
            if not 0 <= k < n or not 0 <= group < n // CHANNELS or message[4] - 1 != (k + self._reach) % n:
                continue
            if (k, group) in self._have:  # a later scan, and this one never became whole
                self._have, self._damaged = set(), self._damaged + 1
            found = np.frombuffer(message, ">f4", 2 * CHANNELS, 11).astype(np.float64)
            self._potentials[k, CHANNELS * group : CHANNELS * (group + 1)] = found[0::2] + 1j * found[1::2]
            self._have.add((k, group))
            if len(self._have) == n * n // CHANNELS:
                lost, self._damaged, self._have = self._damaged, 0, set()
                voltages = self._potentials[self._drive, self._plus] - self._potentials[self._drive, self._minus]
                yield Scan(voltages, 1000 * int.from_bytes(message[7:11], "big") & 0xFFFFFFFF, lost)

    def stop(self) -> None:
        """Stop the device."""
        self._port.write(b"\xb4\x01\x00\xb4")

    def close(self) -> None:
        """Close the port; a second call does nothing."""
        self._port.close()


def open_sciospec(rest: str) -> Sciospec:
    """Return the driver of a port ``sciospec:REST``.

    Raises:
        TransportError: It cannot be opened.
        NotReady: The device does not answer.
        ValueError: An option is wrong.
    """
    path, options = parse_rest(rest, "sciospec")
    if not path:
        raise ValueError("expected sciospec:PATH, such as sciospec:/dev/ttyUSB0")
    port = SerialPort(path, BAUD)
    try:
        return Sciospec(port, options)
    except BaseException:
        port.close()
        raise
