"""The frame: one scan of the skin, self-describing down to the drives it scanned.

::

    0     1      2             3     4           8         12         16      18              20
    type  flags  sample_bytes  rows  generation  sequence  device_us  drives  device_dropped  samples  saturation
    u8    u8     u8            u8    u32         u32       u32        u16     u16             rows * 2|3|4 bytes, then
                                                                                              a bit a row, rounded up

Samples are signed, little-endian; volts = count * HELLO.volts_per_count. They start on a multiple of four and end in
the saturation bits: row r was cut off by the front end if bit r is set. :class:`Frame` is the value for tests and
tools; :class:`FrameView` is the frame loop's decoder, which writes into arrays that exist already.
"""

import struct
from dataclasses import dataclass
from typing import Final, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from eitskin_proto.errors import ProtocolError
from eitskin_proto.sensor.table import N_FULL_ROWS
from eitskin_proto.wire.codes import FrameFlag, MessageType
from eitskin_proto.wire.scan_rows import ALL_DRIVES, row_count

HEADER: Final = struct.Struct("<BBBBIIIHH")
"""type, flags, sample_bytes, rows, generation, sequence, device_us, drives, device_dropped."""

HEADER_BYTES: Final = HEADER.size
_unpack_header = HEADER.unpack_from

_EIGHT: Final = np.int32(8)  # a Python int would be converted in every call

FRAME_TYPE: Final = int(MessageType.FRAME)
"""As a plain number: comparing enumerations costs a microsecond a frame."""

HEADER_FIELDS: Final = (
    ("flags", "u8"), ("sample_bytes", "u8"), ("rows", "u8"), ("generation", "u32"), ("sequence", "u32"),
    ("device_us", "u32"), ("drives", "u16"), ("device_dropped", "u16"),
)  # fmt: skip
"""The same for the generated tables, after the type byte."""

SAMPLE_BYTES: Final = (2, 3, 4)
"""Widths that a sample may have."""


def frame_bytes(rows: int, sample_bytes: int) -> int:
    """Return the length of a frame's payload."""
    return HEADER.size + rows * sample_bytes + (rows + 7) // 8


def full_scale(sample_bytes: int) -> int:
    """Return the largest count of a sample; the smallest is one further from zero."""
    return (1 << (8 * sample_bytes - 1)) - 1


def quantise(
    voltages: npt.NDArray[np.floating], volts_per_count: float, sample_bytes: int
) -> tuple[npt.NDArray[np.int32], int]:
    """Return the counts of some voltages, cut off at full scale, and the saturation bits.

    Args:
        voltages: (rows,) V.
        volts_per_count: V.
        sample_bytes: 2, 3 or 4.

    Returns:
        (rows,) counts; and an int whose bit r tells that row r was cut off or was not a number.
    """
    limit = full_scale(sample_bytes)
    exact = np.rint(np.asarray(voltages, dtype=np.float64) / volts_per_count)
    bad = ~(np.abs(exact) <= limit)
    counts = np.clip(np.nan_to_num(exact, nan=0.0, posinf=limit, neginf=-limit), -limit, limit).astype(np.int32)
    return counts, int.from_bytes(np.packbits(bad, bitorder="little").tobytes(), "little")


def _check(payload: bytes, flags: int, sample_bytes: int, rows: int, drives: int) -> None:
    if sample_bytes not in SAMPLE_BYTES:
        raise ProtocolError(f"FRAME has samples of {sample_bytes} bytes, expected 2, 3 or 4")
    expected = row_count(bool(flags & FrameFlag.FULL), drives)
    if rows != expected or rows == 0:
        raise ProtocolError(f"FRAME has {rows} rows, but its drives 0x{drives:04x} have {expected}")
    if len(payload) != frame_bytes(rows, sample_bytes):
        raise ProtocolError(
            f"FRAME has {len(payload)} bytes, expected {frame_bytes(rows, sample_bytes)} for {rows} rows of "
            f"{sample_bytes} bytes"
        )


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One scan, as a value."""

    sequence: int
    """Counts scans since boot, sent or not, modulo 2^32."""
    device_us: int
    """Device clock at the end of the scan, modulo 2^32."""
    counts: npt.NDArray[np.int32]
    """(rows,) samples in table order."""
    generation: int = 0
    """Of the configuration that made this scan."""
    sample_bytes: int = 4
    flags: int = 0
    """:class:`eitskin_proto.wire.codes.FrameFlag`."""
    drives: int = ALL_DRIVES
    """Bit k: drive k was scanned."""
    device_dropped: int = 0
    """Scans that the device could not send since START, at most 65535."""
    saturation: int = 0
    """Bit r: row r was cut off."""

    def pack(self) -> bytes:
        """Return the payload.

        Raises:
            ValueError: The counts do not fit the sample width, or their number does not fit the drives.
        """
        rows = row_count(bool(self.flags & FrameFlag.FULL), self.drives)
        if self.sample_bytes not in SAMPLE_BYTES:
            raise ValueError(f"sample_bytes is {self.sample_bytes}, expected 2, 3 or 4")
        if self.counts.shape != (rows,) or rows == 0:
            raise ValueError(f"counts have shape {self.counts.shape}, but drives 0x{self.drives:04x} have {rows} rows")
        limit = full_scale(self.sample_bytes)
        low, high = int(self.counts.min()), int(self.counts.max())
        if low < -limit - 1 or high > limit:
            raise ValueError(
                f"counts span {low} to {high}, but {self.sample_bytes} bytes carry {-limit - 1} to {limit}"
            )
        if self.saturation >> rows:
            raise ValueError(f"saturation 0x{self.saturation:x} names rows beyond the {rows} of this frame")
        samples = self.counts.astype("<i4").view(np.uint8).reshape(rows, 4)[:, : self.sample_bytes]
        head = HEADER.pack(
            MessageType.FRAME, self.flags, self.sample_bytes, rows, self.generation, self.sequence, self.device_us,
            self.drives, self.device_dropped,
        )  # fmt: skip
        return head + samples.tobytes() + self.saturation.to_bytes((rows + 7) // 8, "little")

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        """Return the frame of a payload.

        Raises:
            ProtocolError: The payload is not exactly one frame.
        """
        view = FrameView()
        view.load(payload)
        return cls(
            sequence=view.sequence,
            device_us=view.device_us,
            counts=view.counts.copy(),
            generation=view.generation,
            sample_bytes=view.sample_bytes,
            flags=view.flags,
            drives=view.drives,
            device_dropped=view.device_dropped,
            saturation=view.saturation,
        )


class FrameView:
    """Decodes frame after frame into the same memory.

    ``load`` fills the header's attributes and ``counts``, a (rows,) int32 view that the next ``load`` overwrites. No
    array is made, and the header is not judged again, unless its shape differs from the last frame's.
    """

    __slots__ = (
        "_counts", "_kept", "_raw", "_shape", "_source", "counts", "device_dropped",
        "device_us", "drives", "flags", "generation", "rows", "sample_bytes", "saturation", "sequence",
    )  # fmt: skip

    def __init__(self) -> None:
        self._raw = np.zeros(N_FULL_ROWS * 4, dtype=np.uint8)
        self._counts = np.zeros(N_FULL_ROWS, dtype=np.int32)
        self._shape = (0, 0, 0, 0, 0)
        """flags, sample_bytes, rows, drives and length of the last frame: what passed once passes again."""
        self._source: npt.NDArray[np.signedinteger] = self._counts
        self._kept = memoryview(self._raw.data)
        self.counts: npt.NDArray[np.int32] = self._counts[:0]
        self.flags = self.sample_bytes = self.rows = self.generation = self.sequence = 0
        self.device_us = self.drives = self.device_dropped = self.saturation = 0

    def _reshape(self, shape: tuple[int, int, int, int, int]) -> None:
        self._shape = shape
        self.flags, width, rows, self.drives, _ = shape
        self.sample_bytes, self.rows = width, rows
        self.counts = self._counts[:rows]
        if width == 3:
            # Overlapping words, three bytes apart: each has its sample in the upper three bytes, where the sign is, and
            # a stray byte below. One arithmetic shift then extends the sign and drops the stray.
            self._kept = memoryview(self._raw.data)[1 : 1 + 3 * rows]
            self._source = np.ndarray((rows,), "<i4", self._raw.data, 0, (3,))
        elif width == 4:
            self._kept = self._counts.data.cast("B")[: 4 * rows]
        else:
            self._kept = memoryview(self._raw.data)[: rows * width]
            self._source = self._raw[: rows * width].view(f"<i{width}")

    def load(self, payload: bytes) -> None:
        """Decode one payload.

        Raises:
            ProtocolError: It is not exactly one frame; the view then still holds the frame before.
        """
        if len(payload) < HEADER_BYTES or payload[0] != FRAME_TYPE:
            raise ProtocolError(f"a payload of {len(payload)} bytes with type 0x{payload[:1].hex()} is not a FRAME")
        _, flags, width, rows, generation, sequence, device_us, drives, dropped = _unpack_header(payload)
        shape = (flags, width, rows, drives, len(payload))
        known = shape == self._shape
        if not known:
            _check(payload, flags, width, rows, drives)
        end = HEADER_BYTES + rows * width
        saturation = int.from_bytes(payload[end:], "little")
        if saturation and saturation >> rows:
            raise ProtocolError(f"FRAME marks rows beyond its {rows} as saturated")
        if not known:
            self._reshape(shape)
        self._kept[:] = payload[HEADER_BYTES:end]
        if width == 3:
            np.right_shift(self._source, _EIGHT, out=self.counts)
        elif width == 2:
            self.counts[...] = self._source
        self.generation, self.sequence, self.device_us = generation, sequence, device_us
        self.device_dropped, self.saturation = dropped, saturation


MODULUS: Final = 1 << 32

MAX_LOST: Final = 1_000_000
"""More lost frames than this (83 minutes at 200 frames/s) is taken for a reset."""


class Step(NamedTuple):
    """The counters of one frame; a tuple, since a frozen dataclass costs 3 us more a frame."""

    sequence: int
    """Unwrapped: grows over wraps; restarts after a reset."""
    device_us: int
    """Unwrapped microseconds, likewise."""
    lost: int
    """Frames between the last one and this one that never came."""
    reset: bool
    """Whether the device has restarted since the last frame."""
    duplicate: bool
    """The same sequence number as the last frame, at no earlier time: the counters are unchanged."""


class StreamCounter:
    """Follows one stream's sequence and device time."""

    __slots__ = ("_device_us", "_sequence", "lost", "resets")

    def __init__(self) -> None:
        self._sequence: int | None = None
        self._device_us = 0
        self.lost = 0
        """Frames lost so far."""
        self.resets = 0
        """Resets seen so far."""

    @property
    def sequence(self) -> int | None:
        """Unwrapped, of the last frame; None before the first."""
        return self._sequence

    @property
    def device_us(self) -> int:
        """Unwrapped microseconds of the last frame."""
        return self._device_us

    def restart(self) -> None:
        """Forget the last frame, as after a handshake with a device that is known to have restarted."""
        self._sequence = None

    def step(self, sequence: int, device_us: int) -> Step:
        """Return the next frame's counters.

        Args:
            sequence: u32 of the frame.
            device_us: u32 of the frame.
        """
        if self._sequence is None:
            self._sequence, self._device_us = sequence, device_us
            return Step(sequence, device_us, 0, False, False)
        forward = (sequence - self._sequence) % MODULUS
        earlier = (device_us - self._device_us) % MODULUS > MODULUS // 2
        if forward == 0 and not earlier:
            return Step(self._sequence, self._device_us, 0, False, True)
        if forward == 0 or forward - 1 > MAX_LOST:
            self.resets += 1
            self._sequence, self._device_us = sequence, device_us
            return Step(sequence, device_us, 0, True, False)
        self._sequence += forward
        self._device_us += (device_us - self._device_us) % MODULUS
        self.lost += forward - 1
        return Step(self._sequence, self._device_us, forward - 1, False, False)
