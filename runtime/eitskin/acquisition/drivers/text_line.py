"""``line:PATH``: any device or program that prints a scan a line, as numbers separated by commas or spaces.

    line:/dev/ttyACM0?baud=115200           a serial port
    line:-                                  standard input; any other path may be a file or a FIFO

A line may begin with a label and a colon (``magnitudes: 0.1, 0.2``). Options, all of which may be left out:

==========  ============================================================================================
numbers     of a line (default: as the first whole line of 8 or more has)
order       a table (``pyeit-208``), or its kind alone: ``adjacent``, ``opposite``, ``pyeit``, ``eidors``
table       a file instead: CSV, or .npy, of (rows, 4) electrodes
values      ``signed`` (default), ``amounts`` (RMS, |Z|), or ``complex``: pairs of real and imaginary part
scale       volts of a printed 1 (default 1)
step        volts of the converter's step (default: the last decimal of the first line)
full_scale  volts that the converter does not exceed
rate        scans per second; checked
start       a text that is sent to start the device
serial      a name of the device, which its reference belongs to
==========  ============================================================================================

N x N numbers, 64 to 1,024, are a matrix of drives and measurements; its entries at the drive's own electrodes are left
out.
"""

import math
import os
import re
import select
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin.acquisition.drivers.driver import Scan, parse_rest
from eitskin.acquisition.serial_port import SerialPort
from eitskin.errors import NotReady, PortLost, PortMissing, TransportError
from eitskin_proto.files.arrays import read_npy
from eitskin_proto.sensor.row_table import MAX_ELECTRODES, MIN_ELECTRODES, RowTable, named, usual_table

PROBE_S: Final = 10.0
"""Longest wait for the first whole line, and then for the next."""

RATE_S: Final = 0.3
"""For which lines are counted if the rate is not stated."""

LARGEST_LINE: Final = 1 << 17
"""Bytes."""

DEFAULT_BAUD: Final = 115_200

_DECIMALS: Final = re.compile(rb"[-+]?\d*\.?(\d*)(?:[eE]([-+]?\d+))?")


class _Pipe:
    """Standard input, a FIFO or a file."""

    def __init__(self, path: str) -> None:
        self.name = "standard input" if path == "-" else path
        try:
            self._file = os.dup(0) if path == "-" else os.open(path, os.O_RDONLY)
        except OSError as error:
            raise PortMissing(f"{path} cannot be opened: {error.strerror}") from error

    def fileno(self) -> int:
        return self._file

    def read(self, timeout_s: float) -> bytes:
        ready, _, _ = select.select([self._file], [], [], timeout_s)
        if not ready:
            return b""
        if not (data := os.read(self._file, 65536)):
            raise PortLost(f"{self.name} ended")
        return data

    def write(self, data: bytes) -> None:
        raise TransportError(f"{self.name} takes no text; leave out the option start")

    def close(self) -> None:
        if self._file >= 0:
            os.close(self._file)
        self._file = -1


class TextLine:
    """A driver of lines of numbers (:class:`eitskin.acquisition.drivers.driver.Driver`).

    Args:
        source: It is open.
        options: Of the port's name.

    Raises:
        NotReady: No line of numbers came.
        ValueError: An option is wrong, or does not fit the numbers of a line.
    """

    name = "line"

    def __init__(self, source: Any, options: Any) -> None:
        self._source, self._buffer, self._damaged = source, b"", 0
        self._damage = ""
        """What is wrong with the last damaged line."""
        self._lines, self._came_s = 0, time.monotonic()
        """Whole lines so far, and when the last one came."""
        self._start = str(options.value("start", "")).encode()
        values = options.choice("values", ("signed", "amounts", "complex"), "signed")
        self._complex, self.signed = values == "complex", values == "signed"
        self._scale = options.number("scale", 1.0, above=0.0)
        self.rate_hz = options.number("rate", 0.0, low=0.0)
        self.full_scale_V = options.number("full_scale", 0.0, low=0.0)
        step_V = options.number("step", 0.0, low=0.0)
        self.serial_number = str(options.value("serial", "LINE"))[:16]
        numbers = options.whole("numbers", 0)
        order, file = options.text("order", ""), options.text("table", "")
        options.close()
        if self._start:
            source.write(self._start)
        first = self._first_line(numbers * (2 if self._complex else 1))
        self._numbers = len(_words(first))
        self.measured_hz = 0.0 if self.rate_hz or self._is_file else self._measured_hz()
        self.table, self._picked = _rows_of(self._numbers // (2 if self._complex else 1), order, file)
        self.step_V = step_V or self._scale * _step_of(first)
        self.settings = {"numbers": self._numbers, "values": values, "scale": self._scale}

    def _first_line(self, numbers: int) -> bytes:
        """Return the first whole line of so many numbers; for 0, of as many as a scan may have."""
        end_s, begun, seen = time.monotonic() + PROBE_S, self._is_file, b""  # a device's first line is cut off
        while (left_s := end_s - time.monotonic()) > 0.0:
            self._buffer += self._source.read(left_s)
            *lines, self._buffer = self._buffer.split(b"\n")
            for at, line in enumerate(lines):
                whole, begun, seen = begun, True, line
                words = _words(line)
                fits = len(words) == numbers if numbers else len(words) >= MIN_ELECTRODES
                if whole and fits and _parsed(words) is not None:
                    if self._is_file:  # nothing of a file is over yet
                        self._buffer = b"\n".join([*lines[at:], self._buffer])
                    return line
            self._buffer = self._buffer[-LARGEST_LINE:]
        wanted = f"a line of {numbers} numbers" if numbers else "a line of numbers"
        found = _damage(_words(seen), numbers) or f"the last line had {len(_words(seen))} words"
        found = found if seen else "no line came"
        raise NotReady(
            f"{self._source.name} sent no {wanted[2:]} within {PROBE_S:g} s: {found}; check numbers and baud"
        )

    def _measured_hz(self) -> float:
        """Return how many lines come a second, to two digits; 0 if no second one comes."""
        begin_s = now_s = last_s = time.monotonic()
        lines = 0
        while (left_s := begin_s + (RATE_S if lines else PROBE_S) - now_s) > 0.0:
            data = self._source.read(left_s)
            now_s = time.monotonic()
            if found := data.count(b"\n"):
                lines, last_s = lines + found, now_s
            self._buffer += data
        return float(f"{lines / max(last_s - begin_s, 1e-3):.2g}")

    @property
    def _is_file(self) -> bool:
        return isinstance(self._source, _Pipe)

    @property
    def trouble(self) -> str:
        """What came in place of scans."""
        if self._damage or not self._lines:
            return self._damage or "no line came"
        return f"it stopped after {self._lines} lines, {time.monotonic() - self._came_s:.0f} s ago"

    def fileno(self) -> int:
        """Return the port's descriptor."""
        return int(self._source.fileno())

    def scans(self) -> Iterator[Scan]:
        """Yield the scans of whole lines; a damaged line is counted as lost with the next.

        Raises:
            PortLost: The port is gone, or the input has ended.
        """
        if not self._is_file or b"\n" not in self._buffer:
            self._buffer += self._source.read(0.0)
        *lines, self._buffer = self._buffer.split(b"\n")
        self._buffer = self._buffer[-LARGEST_LINE:]
        for line in lines:
            words = _words(line)
            if not words:
                continue
            self._damage = _damage(words, self._numbers)
            found = None if self._damage else _parsed(words)
            if found is None:
                self._damaged += 1
                continue
            self._lines, self._came_s = self._lines + 1, time.monotonic()
            if self._complex:
                found = found[0::2] + 1j * found[1::2]
            lost, self._damaged = self._damaged, 0
            yield Scan(found[self._picked] * self._scale, None, lost)

    def start(self) -> None:
        """Send the text that starts the device, if there is one, and forget lines that came before."""
        if self._start:
            self._source.write(self._start)
        while not self._is_file and (data := self._source.read(0.0)):
            self._buffer += data
        if not self._is_file:
            self._buffer = self._buffer.rpartition(b"\n")[2]
        self._damaged = 0

    def stop(self) -> None:
        """Do nothing: the device goes on."""

    def close(self) -> None:
        """Close the port; a second call does nothing."""
        self._source.close()


def open_text_line(rest: str) -> TextLine:
    """Return the driver of a port ``line:REST``.

    Raises:
        TransportError: It cannot be opened.
        NotReady: No line of numbers came.
        ValueError: An option is wrong.
    """
    path, options = parse_rest(rest, "line")
    baud = options.whole("baud", DEFAULT_BAUD, low=300, high=1 << 30)
    if not path:
        raise ValueError("expected line:PATH, such as line:/dev/ttyACM0 or line:-")
    piped = path == "-" or (Path(path).exists() and not Path(path).is_char_device())
    source = _Pipe(path) if piped else SerialPort(path, baud)
    try:
        return TextLine(source, options)
    except BaseException:
        source.close()
        raise


def _words(line: bytes) -> list[bytes]:
    return line.rpartition(b":")[2].translate(None, b"[]()\r").replace(b",", b" ").replace(b";", b" ").split()


def _parsed(words: list[bytes]) -> npt.NDArray[Any] | None:
    """Return the numbers; None if one of them is none."""
    try:
        found = np.array([float(word) for word in words])
    except ValueError:
        return None
    return found if np.isfinite(found).all() else None


def _damage(words: list[bytes], numbers: int) -> str:
    """Return what is wrong with a line; empty if it has so many numbers (for 0, any)."""
    if numbers and len(words) != numbers:
        return f"the last line had {len(words)} numbers, expected {numbers}"
    at = next((at for at, word in enumerate(words) if _parsed([word]) is None), None)
    return (
        "" if at is None else f"column {at + 1} of the last line is {words[at].decode(errors='replace')!r}, no number"
    )


def _step_of(line: bytes) -> float:
    """Return the last decimal of the most exact number."""
    found = [_DECIMALS.fullmatch(word) for word in _words(line) if float(word) != 0.0]
    exponents = [int(one[2] or 0) - len(one[1]) for one in found if one is not None]
    return float(10.0 ** min(exponents, default=0))


def _rows_of(numbers: int, order: str, file: str) -> tuple[RowTable, npt.NDArray[np.intp]]:
    """Return the table of a line, and where its rows are among the numbers.

    Raises:
        ValueError: They do not fit each other.
    """
    side = math.isqrt(numbers)
    matrix = side * side == numbers and MIN_ELECTRODES <= side <= MAX_ELECTRODES and not file
    if file:
        table = RowTable.of(read_npy(file, 1 << 20) if file.endswith(".npy") else np.loadtxt(file, delimiter=","), file)
    elif "-" in order:
        table = named(order)
        matrix = matrix and table.rows != numbers
    elif matrix:
        table = named(f"{order or 'adjacent'}-{side * (side - (4 if order == 'opposite' else 3))}")
    else:
        table = named(f"{order}-{numbers}") if order else usual_table(numbers)
    if not matrix:
        if table.rows != numbers:
            raise ValueError(f"a line has {numbers} numbers, expected the {table.rows} rows of {table.name}")
        return table, np.arange(numbers)
    assert table.electrodes is not None
    drive, _, one, other = table.electrodes.astype(np.intp).T
    lower = np.where((one + 1) % side == other, one, other)
    return table, drive * side + lower
