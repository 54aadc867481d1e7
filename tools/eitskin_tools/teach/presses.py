"""Reads a file of presses at known places.

::

    PRESSES.npz  voltages_V (n, rows)   readings in order of time; or
                 change (n, rows)       change of each press, V / V_untouched - 1, where nothing else was kept
                 xy_mm (n, 2)           places from the corner of the outline, NaN where the sheet is untouched
                 size_mm (2,)           length and width
                 outline text           "rectangle", or "disc" in the square of size_mm
                 table (rows, 4)        drive +, drive -, measure +, measure - of each row (optional)

Each reading is held against the last untouched one before it. Changes larger than 1 have another unit; they are used as
they are, but no runtime can compute them.
"""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Final, Literal, cast

import numpy as np
import numpy.typing as npt

from eitskin.model.taught import SMALLEST_RATIO
from eitskin_proto.errors import SkinError
from eitskin_proto.files.archive import BadArchiveError, members
from eitskin_proto.files.arrays import Array, Arrays, numbers, read_npz, text
from eitskin_proto.files.plain import quoted
from eitskin_proto.sensor.row_table import MAX_ROWS, RowTable, numbered

LARGEST_FILE: Final = 1 << 28
"""Bytes: 30,000 readings of 1,024 rows."""

FEWEST: Final = 6
"""Presses that can be taught."""

LEAST_SPREAD: Final = 0.1
"""Share of either side over which places must be spread."""

SIZES_MM: Final = (50.0, 400.0)
"""Of a sheet that a skin can describe."""

BLOCKS: Final = 30
"""Stretches of time, about, that a cross-validation keeps together."""

Outline = Literal["rectangle", "disc"]
Way = Literal["last", "first", "common"]
"""Against what readings are held: the last untouched one, the first, or the first without the rows' common factor."""


class PressesError(SkinError, ValueError):
    """A file of presses that cannot be used."""


@dataclass(frozen=True, eq=False)
class Presses:
    """Recorded presses, checked."""

    readings: Array
    """(n, rows) V; or changes, where ``is_change``."""
    xy_mm: Array
    """(n, 2); NaN where untouched."""
    size_mm: tuple[float, float]
    outline: Outline
    table: RowTable
    is_change: bool

    @property
    def sheet(self) -> str:
        """Rows, outline and size, for people."""
        return f"{self.table.name} on a {self.outline} of {self.size_mm[0]:g} x {self.size_mm[1]:g} mm"

    @cached_property
    def pressed(self) -> npt.NDArray[np.bool_]:
        """(n,) whether the sheet is pressed."""
        return np.isfinite(self.xy_mm[:, 0])

    @cached_property
    def last_untouched(self) -> npt.NDArray[np.intp]:
        """(n,) the last untouched reading before each; before the first one, that."""
        untouched = np.flatnonzero(~self.pressed)
        position = np.searchsorted(untouched, np.arange(len(self.pressed))) - 1
        return np.asarray(untouched[np.maximum(position, 0)])

    @property
    def logarithmic(self) -> bool:
        """Whether logarithms of ratios are compared, which a runtime can compute as well."""
        return not self.is_change or bool(np.abs(self.readings).max() < 1.0)

    def against(self, way: Way = "last") -> Array | None:
        """Return (n, rows) V of the untouched reading that each is held against; None where changes are given."""
        if self.is_change:
            return None
        first = np.broadcast_to(np.flatnonzero(~self.pressed)[0], len(self.pressed))
        return np.asarray(self.readings[self.last_untouched if way == "last" else first])

    def changes(self, way: Way = "last") -> Array:
        """Return (n, rows) V / V_untouched - 1 of every reading, or what the file gives.

        A row that is 0 or changes its sign in an untouched reading has no ratio, and no change.
        """
        against = self.against(way)
        if against is None:
            return self.readings
        ratio = np.ones_like(self.readings)
        np.divide(self.readings, against, out=ratio, where=self._usable)
        if way == "common":
            ratio /= np.exp(np.median(np.log(np.maximum(ratio[:, self._usable], SMALLEST_RATIO)), axis=1))[:, None]
        return np.asarray(ratio - 1.0)

    def levels(self) -> Array:
        """Return (m, rows) log |V| of untouched readings, 0 in rows without a change."""
        untouched = self.readings[~self.pressed]
        return np.asarray(np.log(np.abs(np.where(self._usable, untouched, 1.0))))

    @cached_property
    def _usable(self) -> npt.NDArray[np.bool_]:
        """(rows,) whether a row has one sign in all untouched readings."""
        untouched = self.readings[~self.pressed]
        return np.asarray((untouched > 0.0).all(axis=0) | (untouched < 0.0).all(axis=0))

    def logarithms(self, way: Way = "last") -> Array:
        """Return (n, rows) what is learned: log(V / V_untouched) of every reading, or changes as they are."""
        changes = self.changes(way)
        return np.log1p(np.maximum(changes, SMALLEST_RATIO - 1.0)) if self.logarithmic else changes

    @cached_property
    def blocks(self) -> npt.NDArray[np.intp]:
        """(presses,) the stretch of time of each; presses against one untouched reading share it."""
        index = np.flatnonzero(self.pressed)
        if not self.is_change:
            index = np.unique(self.last_untouched[self.pressed], return_inverse=True)[1]
        return np.asarray(index * min(BLOCKS, int(index.max()) + 1) // (int(index.max()) + 1))


def load_presses(path: str | Path) -> Presses:
    """Return the presses of a file.

    Raises:
        PressesError: An array is missing, has another shape, or contradicts another one; or there is no press.
        FileError: It is no intact file of plain arrays.
        OSError: It cannot be read.
    """
    arrays = read_npz(path, LARGEST_FILE)
    try:
        return _presses(arrays)
    except ValueError as error:
        raise PressesError(f"{path}: {error}") from error


def check_teachable(presses: Presses) -> None:
    """Refuse presses from which no field can be learned.

    Raises:
        PressesError: They are too few, or at one place.
    """
    count = int(presses.pressed.sum())
    if count < FEWEST:
        raise PressesError(f"holds {count} presses, expected at least {FEWEST}; record more, spread over the sheet")
    extent = np.ptp(presses.xy_mm[presses.pressed], axis=0)
    if (extent < LEAST_SPREAD * np.array(presses.size_mm)).any():
        raise PressesError(
            f"all presses lie within {extent[0]:.1f} x {extent[1]:.1f} mm, expected places all over the sheet, in mm; "
            "press elsewhere too"
        )


def is_presses(path: str | Path) -> bool:
    """Return whether a file is one of presses, by the names of its arrays.

    Raises:
        OSError: It cannot be read.
    """
    with Path(path).open("rb") as stream:
        try:
            return "xy_mm.npy" in members(stream)
        except BadArchiveError:
            return False


def _presses(arrays: Arrays) -> Presses:
    given = [name for name in ("voltages_V", "change") if name in arrays]
    if len(given) != 1 or "xy_mm" not in arrays or "size_mm" not in arrays:
        there = ", ".join(map(quoted, list(arrays)[:12])) or "no array"
        raise ValueError(f"found {there}; expected voltages_V or change, and xy_mm and size_mm")
    readings = numbers(arrays, given[0], (None, None))
    n, rows = readings.shape
    if not 1 <= rows <= MAX_ROWS:
        raise ValueError(f"{given[0]} has {rows} rows, expected 1 to {MAX_ROWS}")
    size = numbers(arrays, "size_mm", (2,))
    if size.min() < SIZES_MM[0] or size.max() > SIZES_MM[1]:
        raise ValueError(f"size_mm is {size.tolist()}, expected {SIZES_MM[0]:g} to {SIZES_MM[1]:g} each")
    outline = text(arrays, "outline") if "outline" in arrays else "rectangle"
    if outline not in ("rectangle", "disc"):
        raise ValueError(f"outline is {quoted(outline)}, expected rectangle or disc")
    xy = _places(arrays, n, size, outline)
    table = RowTable.of(arrays["table"]) if "table" in arrays else numbered(rows)
    if table.rows != rows:
        raise ValueError(f"table has {table.rows} rows, and {given[0]} {rows}; expected as many")
    is_change = given[0] == "change"
    untouched = np.isnan(xy[:, 0])
    if is_change and untouched.any():
        index = int(np.flatnonzero(untouched)[0])
        raise ValueError(f"xy_mm[{index}] is NaN; expected the place of each press, since change has presses alone")
    if not is_change and not untouched.any():
        raise ValueError("xy_mm has no NaN, so no reading is untouched; expected one before the presses, or 'change'")
    return Presses(readings, xy, (float(size[0]), float(size[1])), cast("Outline", outline), table, is_change)


def _places(arrays: Arrays, n: int, size: Array, outline: str) -> Array:
    found = arrays["xy_mm"]
    if found.dtype.kind not in "fiu" or found.shape != (n, 2):
        raise ValueError(f"xy_mm is {found.dtype} of shape {found.shape}, expected numbers ({n}, 2)")
    xy = np.asarray(found, dtype=np.float64)
    odd = np.flatnonzero(np.isnan(xy).sum(axis=1) == 1)
    if odd.size:
        raise ValueError(f"xy_mm[{odd[0]}] is {xy[odd[0]].tolist()}, expected two numbers, or twice NaN")
    off = (xy < 0.0).any(axis=1) | (xy > size).any(axis=1)
    if outline == "disc":
        off |= (((xy - size / 2.0) / (size / 2.0)) ** 2).sum(axis=1) > 1.0
    if off.any():
        index = int(np.flatnonzero(off)[0])
        raise ValueError(
            f"xy_mm[{index}] is {xy[index].tolist()}, which is off the {outline} of {size[0]:g} x {size[1]:g} mm; "
            "places are counted from the outline's corner"
        )
    return xy
