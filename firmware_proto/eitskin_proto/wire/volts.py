"""The scan of another maker's device, in volts, and what describes that device; both exist on the host alone.

A driver (:mod:`eitskin.acquisition.drivers`) reads a device that does not speak the project's wire. Its scans go
through the same intake, streams and recordings as frames of the wire. Their payload is VOLTS::

    0     1      2     4           8         12         16            16 + 8 rows
    type  flags  rows  generation  sequence  device_us  volts         cut off
    u8    u8     u16   u32         u32       u32        rows * f64    a bit a row, rounded up

In place of HELLO stands the :class:`DriverHello`, which has the fields of HELLO with ``rows`` as u16, and then what a
driver states besides: the table of its rows, the converter's step and its full scale. Its hardware_id is that of no
firmware, so that a device that sends one is refused.
"""

import math
import struct
from dataclasses import dataclass
from typing import ClassVar, Final, Self

import numpy as np
import numpy.typing as npt

from eitskin_proto.errors import ProtocolError
from eitskin_proto.sensor.row_table import ADJACENT_104, ADJACENT_208, MAX_ROWS, RowTable
from eitskin_proto.sensor.table import N_FULL_ROWS
from eitskin_proto.wire.codes import MessageType
from eitskin_proto.wire.frames import FRAME_TYPE, FrameView
from eitskin_proto.wire.frames import HEADER_BYTES as FRAME_HEADER_BYTES
from eitskin_proto.wire.layout import Layout
from eitskin_proto.wire.messages import Hello
from eitskin_proto.wire.scan_rows import ALL_DRIVES

VOLTS_TYPE: Final = 0xF0
"""First byte of the payload; no message of the wire has it."""

SCANS: Final = bytes([FRAME_TYPE, VOLTS_TYPE])
"""First bytes of payloads that are scans."""

DRIVER_ID: Final = 0x44525652
"""``hardware_id`` of a device behind a driver."""

HEADER: Final = struct.Struct("<BBHIII")
HEADER_BYTES: Final = HEADER.size


def volts_bytes(rows: int) -> int:
    """Return the length of a VOLTS payload."""
    return HEADER_BYTES + 8 * rows + (rows + 7) // 8


LARGEST_VOLTS: Final = volts_bytes(MAX_ROWS)
"""Bytes of a VOLTS payload; a DriverHello is shorter."""


def pack_volts(
    voltages: npt.NDArray[np.float64],
    sequence: int,
    device_us: int,
    cut_off: npt.NDArray[np.bool_] | None = None,
) -> bytes:
    """Return the payload of a scan.

    Args:
        voltages: (rows,) V.
        sequence: Counts scans, lost ones included, modulo 2^32.
        device_us: Clock of the device, or of the driver, at the end of the scan, modulo 2^32.
        cut_off: (rows,) which rows are beyond the converter's full scale; None for none.
    """
    rows = len(voltages)
    marked = bytes((rows + 7) // 8) if cut_off is None else np.packbits(cut_off, bitorder="little").tobytes()
    head = HEADER.pack(VOLTS_TYPE, 0, rows, 0, sequence & 0xFFFFFFFF, device_us & 0xFFFFFFFF)
    return head + voltages.astype("<f8").tobytes() + marked


class VoltsView:
    """Decodes scan after scan into the same memory, with the attributes of a :class:`FrameView`."""

    __slots__ = ("_kept", "counts", "device_dropped", "device_us", "generation", "saturation", "sequence")

    flags = 0
    drives = ALL_DRIVES
    sample_bytes = 8

    def __init__(self, rows: int) -> None:
        self.counts = np.zeros(rows, dtype="<f8")
        """(rows,) V, of which the next ``load`` writes others; a count is a volt."""
        self._kept = self.counts.data.cast("B")
        self.generation = self.sequence = self.device_us = self.device_dropped = self.saturation = 0

    @property
    def rows(self) -> int:
        """Of a scan."""
        return len(self.counts)

    def load(self, payload: bytes) -> None:
        """Decode one payload.

        Raises:
            ProtocolError: It is not one scan of this number of rows.
        """
        rows = len(self.counts)
        if len(payload) != volts_bytes(rows) or payload[0] != VOLTS_TYPE:
            raise ProtocolError(
                f"a payload of {len(payload)} bytes with type 0x{payload[:1].hex()} is not VOLTS of {rows} rows"
            )
        _, _, stated, self.generation, self.sequence, self.device_us = HEADER.unpack_from(payload)
        if stated != rows:
            raise ProtocolError(f"VOLTS has {stated} rows, expected {rows}")
        end = HEADER_BYTES + 8 * rows
        self._kept[:] = payload[HEADER_BYTES:end]
        self.saturation = int.from_bytes(payload[end:], "little")


@dataclass(frozen=True, slots=True)
class DriverHello(Hello):
    """What a driver says of its device."""

    LAYOUT: ClassVar = Layout(
        MessageType.HELLO,
        (
            *((name, "u16" if name == "rows" else kind) for name, kind in Hello.LAYOUT.fields),
            ("step_V", "f64"), ("full_scale_V", "f64"), ("signed", "u8"), ("table_name", "text16"),
            ("electrodes", "tail"),
        ),
        max_tail=4 * MAX_ROWS,
    )  # fmt: skip
    step_V: float = 1e-9
    """Of the converter."""
    full_scale_V: float = 1e3
    """Largest voltage that the converter reads; a row above it is cut off."""
    signed: int = 1
    """0 for amounts, which are never negative."""
    table_name: str = ""
    electrodes: bytes = b""
    """(rows, 4) of the table, an unsigned byte each; empty for an unknown protocol."""

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        """Return the description of a payload.

        Raises:
            ProtocolError: It is none, or contradicts itself.
        """
        found = cls(**cls.LAYOUT.unpack(payload))
        try:
            found.table  # noqa: B018 -- raises
        except ValueError as error:
            raise ProtocolError(f"HELLO of a driver: {error}") from error
        if not 1 <= found.rows <= MAX_ROWS or not found.step_V > 0.0 or not math.isfinite(found.full_scale_V):
            raise ProtocolError(f"HELLO of a driver has {found.rows} rows and steps of {found.step_V:g} V")
        return found

    @property
    def table(self) -> RowTable:
        """Its rows.

        Raises:
            ValueError: They are no table.
        """
        if not self.electrodes:
            return RowTable(self.table_name, self.rows)
        if len(self.electrodes) != 4 * self.rows:
            raise ValueError(f"{len(self.electrodes)} electrodes of {self.rows} rows, expected four a row")
        return RowTable.of(np.frombuffer(self.electrodes, np.uint8).reshape(-1, 4), self.table_name)


_HARDWARE_AT: Final = next(at for at, name, _ in Hello.LAYOUT.offsets() if name == "hardware_id")


def unpack_hello(payload: bytes) -> Hello:
    """Return the HELLO of a device, or what a driver says of one.

    Raises:
        ProtocolError: It is neither.
    """
    stated = int.from_bytes(payload[_HARDWARE_AT : _HARDWARE_AT + 4], "little")
    return DriverHello.unpack(payload) if stated == DRIVER_ID else Hello.unpack(payload)


def table_of_hello(hello: Hello) -> RowTable:
    """Return the rows of a device's scans."""
    if isinstance(hello, DriverHello):
        return hello.table
    return ADJACENT_208 if hello.rows == N_FULL_ROWS else ADJACENT_104


def step_of(hello: Hello) -> float:
    """Return the converter's step in V: of a count, or as the driver says."""
    return hello.step_V if isinstance(hello, DriverHello) else hello.volts_per_count


def is_signed(hello: Hello) -> bool:
    """Return whether voltages have a sign."""
    return not isinstance(hello, DriverHello) or bool(hello.signed)


def view_of(hello: Hello) -> FrameView | VoltsView:
    """Return the decoder of a device's scans."""
    return VoltsView(hello.rows) if isinstance(hello, DriverHello) else FrameView()


def samples_at(hello: Hello) -> int:
    """Return where samples begin in the payload of a scan."""
    return HEADER_BYTES if isinstance(hello, DriverHello) else FRAME_HEADER_BYTES
