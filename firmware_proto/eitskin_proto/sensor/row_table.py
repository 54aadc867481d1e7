"""Tables of rows: which electrodes carry current and which are measured, in the order in which a device sends them.

A row is four electrodes: the current goes into ``drive +`` and out of ``drive -``, and V = U[measure +] - U[measure -].
A device of another make measures other rows, or the same rows in another order; its table says which. ::

    adjacent-104    the project's own: drive (k, k + 1), measure (m, m + 1), k < m
    adjacent-208    the same with the reciprocal half; N(N - 3) rows and half as many for N electrodes, 8 to 32
    opposite-192    drive (k, k + 8), measure (m, m + 1), m from k + 1 on; N(N - 4) rows for an even N
    pyeit-208       the rows of adjacent-208 as pyEIT's default has them: m from 0 on, and the other sign
    eidors-208      adjacent-208 with the other sign: m from k on (pyEIT: ``rotate_meas``, ``fmmu``)
    rows-N          N rows of an unknown protocol

A :class:`RowMap` computes the rows of one table from the voltages of another. A row is there if its two pairs are, in
either role, since reciprocity makes the two equal; where both were measured it takes their mean.
"""

import re
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.files.digest import id_of_values
from eitskin_proto.sensor import table

MAX_ROWS: Final = 1024
MIN_ELECTRODES, MAX_ELECTRODES = 8, 32

Pair = tuple[int, int]


@dataclass(frozen=True, slots=True, eq=False)
class RowTable:
    """The rows of a scan; tables are equal if their ``id`` is."""

    name: str
    """For people."""
    rows: int
    electrodes: npt.NDArray[np.uint8] | None = None
    """(rows, 4) drive +, drive -, measure +, measure -; None for rows of an unknown protocol."""

    @classmethod
    def of(cls, electrodes: npt.ArrayLike, name: str = "table") -> "RowTable":
        """Return a table of electrodes.

        Args:
            electrodes: (n, 4) drive +, drive -, measure +, measure -, counted from 0.
            name: For people.

        Raises:
            ValueError: It is no table; with what was found and what was expected.
        """
        found = np.asarray(electrodes)
        if found.ndim != 2 or found.shape[1] != 4 or not 1 <= len(found) <= MAX_ROWS:
            raise ValueError(f"{name} has shape {found.shape}, expected (rows, 4) with 1 to {MAX_ROWS} rows")
        if found.dtype.kind not in "iu" and not np.array_equal(found, np.rint(found)):
            raise ValueError(f"{name} has numbers that are not whole, expected electrodes from 0 on")
        if found.min() < 0 or not MIN_ELECTRODES <= int(found.max()) + 1 <= MAX_ELECTRODES:
            raise ValueError(
                f"{name} has electrodes {found.min():g} to {found.max():g}, expected 0 to at least "
                f"{MIN_ELECTRODES - 1} and at most {MAX_ELECTRODES - 1}"
            )
        short = np.flatnonzero((found[:, 0] == found[:, 1]) | (found[:, 2] == found[:, 3]))
        if short.size:
            raise ValueError(f"{name} row {short[0]} is {found[short[0]].tolist()}, expected two electrodes a pair")
        own = found.astype(np.uint8)
        keys, counts = np.unique(own, axis=0, return_counts=True)
        if counts.max() > 1:
            raise ValueError(f"{name} has the row {keys[counts.argmax()].tolist()} twice, expected it once")
        own.setflags(write=False)
        return cls(name, len(own), own)

    @property
    def id(self) -> str:
        """16 hex digits; two tables with the same rows in the same order have the same."""
        return _id(self.rows, None if self.electrodes is None else self.electrodes.tobytes())

    def __repr__(self) -> str:
        return f"<RowTable {self.name}: {self.rows} rows>"


@lru_cache(maxsize=64)
def _id(rows: int, electrodes: bytes | None) -> str:
    return id_of_values({"rows": rows, "electrodes": None if electrodes is None else list(electrodes)})


def _ring(electrodes: int, reach: int, name: str, *, rotated: bool = True, sign: int = 1) -> RowTable:
    """Return the table of a ring whose drives are (k, k + reach), with all adjacent measurements that share none.

    Args:
        electrodes: In the ring.
        reach: 1 for adjacent drives, half of the electrodes for opposite ones.
        name: For people.
        rotated: Measurements begin behind electrode k; else at electrode 0.
        sign: -1 exchanges the electrodes of each measurement.
    """
    rows = []
    for k in range(electrodes):
        drive = k, (k + reach) % electrodes
        for step in range(electrodes):
            m = (k * rotated + step) % electrodes
            measure = m, (m + 1) % electrodes
            if not set(measure) & set(drive):
                rows.append((*drive, *measure[::sign]))
    return RowTable.of(np.array(rows), name)


def _half(whole: RowTable, name: str) -> RowTable:
    """Return the rows of adjacent drives with k < m."""
    assert whole.electrodes is not None
    return RowTable.of(whole.electrodes[whole.electrodes[:, 0] < whole.electrodes[:, 2]], name)


def numbered(rows: int) -> RowTable:
    """Return the table of a number of rows of which nothing else is known.

    Raises:
        ValueError: There are too few or too many.
    """
    if not 1 <= rows <= MAX_ROWS:
        raise ValueError(f"a scan has {rows} rows, expected 1 to {MAX_ROWS}")
    return RowTable(f"rows-{rows}", rows)


_NAME: Final = re.compile(r"(adjacent|opposite|pyeit|eidors|rows)-(\d{1,4})")


@lru_cache(maxsize=64)
def named(name: str) -> RowTable:
    """Return the table of a name, such as ``adjacent-104``.

    Raises:
        ValueError: There is none of this name.
    """
    if (found := _NAME.fullmatch(name)) is not None:
        kind, rows = found[1], int(found[2])
        if kind == "rows":
            return numbered(rows)
        for n in range(MIN_ELECTRODES, MAX_ELECTRODES + 1):
            if kind == "adjacent" and 2 * rows == n * (n - 3):
                return _half(_ring(n, 1, name), name)
            if kind == "opposite" and rows == n * (n - 4) and n % 2 == 0:
                return _ring(n, n // 2, name)
            if kind != "opposite" and rows == n * (n - 3):
                return _ring(n, 1, name, rotated=kind != "pyeit", sign=1 if kind == "adjacent" else -1)
    raise ValueError(
        f"no table of rows is called {name!r}; there are adjacent-104, adjacent-208, opposite-192, pyeit-208 and "
        "eidors-208, the same of 8 to 32 electrodes, and rows-N"
    )


ADJACENT_104: Final = named("adjacent-104")
"""The project's own rows (:data:`eitskin_proto.sensor.table.TABLE`)."""

ADJACENT_208: Final = named("adjacent-208")
"""All rows (:data:`eitskin_proto.sensor.table.FULL_TABLE`)."""

_own = ADJACENT_104.electrodes
assert _own is not None
assert np.array_equal(_own[:, ::2], table.TABLE)


def table_of(value: Any, what: str = "table") -> RowTable:
    """Return the table that a name, a number of rows or (n, 4) electrodes stand for.

    Raises:
        ValueError: They stand for none.
    """
    if isinstance(value, RowTable):
        return value
    if isinstance(value, str):
        return named(value)
    if isinstance(value, int):
        return numbered(value)
    return RowTable.of(value, what)


def usual_table(rows: int) -> RowTable:
    """Return what a number of rows usually is: 104 and 208 adjacent, 192 opposite, else an unknown protocol."""
    return {104: ADJACENT_104, 208: ADJACENT_208, 192: named("opposite-192")}.get(rows) or numbered(rows)


class RowMap:
    """Computes the rows of a table from the voltages of another table.

    Args:
        first: (rows,) index of a voltage.
        second: (rows,) index of its reciprocal; the same index where there is none.
        signs: (2, rows) 1 or -1 of either.
        source_rows: Number of voltages.
    """

    __slots__ = ("_half", "_part", "_reciprocal", "first", "second", "source_rows")

    def __init__(
        self,
        first: npt.NDArray[np.intp],
        second: npt.NDArray[np.intp],
        signs: npt.NDArray[np.float64],
        source_rows: int,
    ) -> None:
        self.source_rows = source_rows
        self.first, self.second = first, second
        self._half = 0.5 * signs
        self._part = np.zeros(len(first))
        self._reciprocal = np.zeros(len(first))

    def apply(self, voltages: npt.NDArray[np.float64], out: npt.NDArray[np.float64]) -> None:
        """Write (rows,) V into ``out`` without making an array."""
        np.take(voltages, self.first, out=self._part, mode="clip")
        np.take(voltages, self.second, out=self._reciprocal, mode="clip")
        np.multiply(self._part, self._half[0], out=self._part)
        np.multiply(self._reciprocal, self._half[1], out=self._reciprocal)
        np.add(self._part, self._reciprocal, out=out)

    def spread(self, spread_V: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Return (rows,) V, the standard deviation of mapped rows whose voltages have this one, (source rows,) V."""
        both = np.hypot(spread_V[self.first], spread_V[self.second]) / 2.0
        return np.where(self.first == self.second, spread_V[self.first], both)

    def any_of(self, marked: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
        """Return (rows,) where either voltage of a row is marked."""
        return np.asarray(marked[self.first] | marked[self.second])


def row_map(source: RowTable, wanted: RowTable, *, signed: bool = True) -> RowMap | None:
    """Return what computes the rows of one table from those of another.

    Args:
        source: Of the voltages.
        wanted: Of the result.
        signed: The voltages have a sign; amounts have none, so that none is changed.

    Returns:
        None if the tables are the same, or rows that nothing is known about of the same number.

    Raises:
        ValueError: The source lacks rows.
    """
    unknown = source.electrodes is None or wanted.electrodes is None
    if source.id == wanted.id or (unknown and source.rows == wanted.rows):
        return None
    if source.electrodes is None or wanted.electrodes is None:
        raise ValueError(f"{wanted.name} cannot be made of {source.name}: {source.rows} rows of an unknown protocol")
    where = {key: (row, sign) for row, (key, sign) in enumerate(map(_key, source.electrodes.tolist()))}
    found, lacking = [], 0
    for (drive, measure), sign in map(_key, wanted.electrodes.tolist()):
        there = [where[key] for key in ((drive, measure), (measure, drive)) if key in where]
        lacking += not there
        if there:
            (first, one), (second, other) = there[0], there[-1]
            found.append((first, second, sign * one, sign * other))
    if lacking:
        raise ValueError(
            f"{wanted.name} cannot be made of {source.name}: {lacking} of {wanted.rows} rows are measured neither "
            "directly nor with drive and measurement exchanged"
        )
    columns = np.array(found).T
    signs = columns[2:].astype(np.float64) if signed else np.ones((2, len(found)))
    return RowMap(columns[0].astype(np.intp), columns[1].astype(np.intp), signs, source.rows)


def _key(row: list[int]) -> tuple[tuple[Pair, Pair], int]:
    """Return a row's two pairs, each with its smaller electrode first, and what that does to its sign."""
    a, b, m, n = row
    return ((min(a, b), max(a, b)), (min(m, n), max(m, n))), (1 if a < b else -1) * (1 if m < n else -1)
