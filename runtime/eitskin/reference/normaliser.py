"""From a frame's counts to dV, into memory that exists already.

A frame carries the 104 rows of the table, or all 208, of which each reciprocal pair is averaged: twice the
measurements, 0.7 of the noise. Scans of other rows are mapped to those of the bundle (``row_table``).
dV = V / V0 - 1, and 0 in weak rows (:mod:`eitskin_proto.sensor.normalise`).
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.errors import MismatchError
from eitskin_proto.sensor.normalise import inverse_reference
from eitskin_proto.sensor.row_table import ADJACENT_104, RowMap, RowTable, row_map
from eitskin_proto.sensor.table import N_FULL_ROWS, N_ROWS, RECIPROCAL_IN_FULL, ROW_IN_FULL
from eitskin_proto.wire.messages import Hello
from eitskin_proto.wire.volts import DriverHello, is_signed, table_of_hello

LARGEST_CHANGE: Final = 1e6
"""Norm of dV. Strong rows are above 1e-4 of the largest, so no working front end changes one by more than 1e4."""

NO_SIGNAL: Final = 1e-3
"""A frame without a row above this share of its reference carries no current: a touch of contrast 50, on the whole
sheet, leaves every row a fiftieth."""


LARGE_CHANGE: Final = 1.0
"""|dV|^2 above which rows are looked at: five or more rows of a drive that read the same are farther than this from any
sheet's (1.8 at least, the flat sheet's 5 rows of drive 9)."""


class Normaliser:
    """Turns counts into dV, and into volts on request.

    Args:
        volts_per_count: V, of HELLO.
        rows: Of the result.
        mapped: Computes them from the rows of a scan; None where a scan has them, or is one of the wire.
    """

    __slots__ = (
        "_counts", "_direct", "_exact", "_inverse", "_map", "_offset", "_reciprocal", "_samples", "_scale", "_voltages",
        "far", "rows", "silent", "volts_per_count", "weak_count",
    )  # fmt: skip

    def __init__(self, volts_per_count: float, rows: int = N_ROWS, mapped: RowMap | None = None) -> None:
        self.rows, self._map = rows, mapped
        self.volts_per_count = volts_per_count
        """V, what one count means."""
        self.weak_count = 0
        """Rows of the reference that carry no information."""
        self.silent = False
        """The last frame was refused because no row had a voltage."""
        self.far = False
        """The last frame is so far from the reference that its rows may be no sheet's."""
        self._inverse = np.zeros(rows)
        self._scale = np.zeros(rows)
        self._offset = np.zeros(rows)
        self._exact = np.zeros(rows)
        self._voltages = np.zeros(rows)
        self._samples = np.zeros(0 if mapped is None else mapped.source_rows)
        self._direct = np.zeros(N_ROWS, dtype=np.int32)
        self._reciprocal = np.zeros(N_ROWS, dtype=np.int32)
        self._counts = np.zeros(rows)

    def use_reference(self, reference: npt.NDArray[np.float64], lost: npt.NDArray[np.intp] | None = None) -> None:
        """Normalise against a reference from the next frame on.

        Args:
            reference: (rows,) V.
            lost: Rows that do not stand out of their noise, whose dV is 0 like that of weak ones.

        Raises:
            ValueError: It holds no voltage at all.
        """
        self._inverse[:] = inverse_reference(reference)
        if lost is not None:
            self._inverse[lost] = 0.0
        self._offset[:] = self._inverse != 0.0
        self.weak_count = self.rows - int(self._offset.sum())
        self.use_scale(self.volts_per_count)

    def use_scale(self, volts_per_count: float) -> None:
        """Read counts in another unit from the next frame on, in V."""
        self.volts_per_count = volts_per_count
        np.multiply(self._inverse, volts_per_count, out=self._scale)

    def load(self, counts: npt.NDArray[np.number]) -> None:
        """Take a frame.

        Args:
            counts: (104,) or (208,) of the wire, or those of the device's table.
        """
        if self._map is not None:
            self._samples[:] = counts
            self._map.apply(self._samples, self._counts)
        elif len(counts) != self.rows and len(counts) == N_FULL_ROWS:
            # mode="clip" writes straight into out; the indices are constants and in range
            np.take(counts, ROW_IN_FULL, out=self._direct, mode="clip")
            np.take(counts, RECIPROCAL_IN_FULL, out=self._reciprocal, mode="clip")
            np.add(self._direct, self._reciprocal, out=self._counts, dtype=np.float64)  # int32 would overflow
            np.multiply(self._counts, 0.5, out=self._counts)
        else:
            self._counts[:] = counts  # here, since a product of two types takes longer than both

    def voltages(self) -> npt.NDArray[np.float64]:
        """Return (rows,) V of the frame; the next call overwrites them."""
        np.multiply(self._counts, self.volts_per_count, out=self._voltages)
        return self._voltages

    def rows_into(
        self, rows: npt.NDArray[np.intp], scale: npt.NDArray[np.float64], offset: npt.NDArray[np.float64]
    ) -> None:
        """Write what turns the counts of some rows into dV: dV = counts * scale - offset.

        Args:
            rows: (n,) of the table.
            scale: (n,) written.
            offset: (n,) written; 0 in weak rows.
        """
        np.take(self._scale, rows, out=scale, mode="clip")
        np.take(self._offset, rows, out=offset, mode="clip")

    def change_into(self, out: npt.NDArray[np.float32]) -> bool:
        """Write dV and return whether all of it is plausible.

        Args:
            out: (rows,).
        """
        np.multiply(self._counts, self._scale, out=self._exact)
        np.subtract(self._exact, self._offset, out=self._exact)
        square = float(self._exact.dot(self._exact))
        usable = self.rows - self.weak_count
        # dV = -1 in every row has the square `usable`; only a frame that comes near it is looked at row by row.
        self.silent = abs(square - usable) <= 2.0 * NO_SIGNAL * usable and self._is_silent()
        if self.silent or not square <= LARGEST_CHANGE * LARGEST_CHANGE:  # also false for NaN
            return False
        self.far = square > LARGE_CHANGE
        out[:] = self._exact
        return True

    @property
    def counts(self) -> npt.NDArray[np.float64]:
        """(rows,) counts of the frame, means of two where it has 208."""
        return self._counts

    def cut_off(self, bits: int, samples: int) -> int:
        """Return which rows are cut off, a bit each.

        Args:
            bits: Bit r: row r of the scan is cut off.
            samples: Rows of the scan.
        """
        if self._map is None and samples == self.rows:
            return bits
        marked = np.array([bits >> row & 1 for row in range(samples)], dtype=bool)
        both = marked[ROW_IN_FULL] | marked[RECIPROCAL_IN_FULL] if self._map is None else self._map.any_of(marked)
        return int.from_bytes(np.packbits(both, bitorder="little").tobytes(), "little")

    def _is_silent(self) -> bool:
        return bool(np.abs(self._exact + self._offset).max() < NO_SIGNAL)


def rows_of(hello: Hello) -> RowTable:
    """Return the project's table if a device's scans have its rows, else the device's own."""
    source = table_of_hello(hello)
    try:
        row_map(source, ADJACENT_104)
    except ValueError:
        return source
    return ADJACENT_104


def normaliser_of(hello: Hello, table: RowTable = ADJACENT_104) -> Normaliser:
    """Return the normaliser of a device's scans.

    Args:
        hello: Of the device.
        table: Rows of the result.

    Raises:
        MismatchError: The device does not measure these rows.
    """
    source, mapped = table_of_hello(hello), None
    if isinstance(hello, DriverHello) or table.id != ADJACENT_104.id:
        try:
            mapped = row_map(source, table, signed=is_signed(hello))
        except ValueError as error:
            hint = f"{error}; take a bundle that was taught with this device ('eitskin teach')"
            raise MismatchError("the device's rows", found=source.name, expected=table.name, hint=hint) from error
    return Normaliser(hello.volts_per_count, table.rows, mapped)
