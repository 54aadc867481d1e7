"""Converts a touch's strength to newtons with a table that the user measured. eitskin itself measures no force.

The table is CSV with the columns ``strength``, ``newtons`` and ``newtons_error`` (one standard deviation), one line a
load, by rising strength. Between two lines it is interpolated linearly; outside the table there is no value. The
strength is that of verified touches, in mm2: ``table.newtons(touch.strength_mm2, touch.strength_error_mm2 or 0.0)``.
"""

import csv
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Final, Self

from eitskin.errors import CalibrationError

COLUMNS: Final = ("strength", "newtons", "newtons_error")


class ForceTable:
    """Your own calibration from the strength of verified touches to force.

    Args:
        rows: At least two of (strength in mm2, force in N, its standard deviation in N), by rising strength.
        source: Name of the table in error messages.

    Raises:
        CalibrationError: There are fewer than two, one is not finite, an error is negative, or strength does not rise.
    """

    def __init__(self, rows: Sequence[tuple[float, float, float]], source: str = "the table") -> None:
        self.rows = tuple((float(strength), float(newtons), float(error)) for strength, newtons, error in rows)
        """As they were given."""
        if len(self.rows) < 2:
            raise CalibrationError(f"{source}: found {len(self.rows)} loads, expected at least 2")
        for number, row in enumerate(self.rows, 1):
            if not all(map(math.isfinite, row)) or row[2] < 0.0:
                raise CalibrationError(
                    f"{source}: load {number} is {row}, expected finite numbers, and an error of at least 0"
                )
        for number, (before, after) in enumerate(zip(self.rows, self.rows[1:], strict=False), 2):
            if not after[0] > before[0]:
                raise CalibrationError(
                    f"{source}: load {number} has strength {after[0]:g} after {before[0]:g}, expected rising numbers"
                )

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Return the table in a file.

        Args:
            path: A CSV file whose first line names the columns.

        Raises:
            CalibrationError: It has other columns, or values that make no table.
            OSError: There is no such file.
        """
        with Path(path).open(newline="", encoding="utf-8-sig") as file:
            try:
                lines = [[cell.strip() for cell in line] for line in csv.reader(file) if line]
            except (csv.Error, UnicodeDecodeError) as error:
                raise CalibrationError(f"{path} is not a CSV file: {error}") from error
        found = lines[0] if lines else []
        if tuple(found) != COLUMNS:
            raise CalibrationError(f"{path}: found columns {', '.join(found) or 'none'}, expected {', '.join(COLUMNS)}")
        rows = []
        for number, line in enumerate(lines[1:], 2):
            try:
                strength, newtons, error_N = map(float, line)
            except ValueError as error:
                raise CalibrationError(f"{path}: line {number} is {','.join(line)}, expected three numbers") from error
            rows.append((strength, newtons, error_N))
        return cls(rows, str(path))

    def newtons(self, strength: float | None, error: float = 0.0) -> tuple[float, float] | None:
        """Return the force and its standard deviation, in N; None outside the table.

        Args:
            strength: Strength of a verified touch, in mm2; None if unknown, as for touches of maps.
            error: Standard deviation of the strength, in mm2.
        """
        if strength is None or not self.rows[0][0] <= strength <= self.rows[-1][0]:
            return None
        after = next(index for index, row in enumerate(self.rows) if index and strength <= row[0])
        (s0, n0, e0), (s1, n1, e1) = self.rows[after - 1], self.rows[after]
        part = (strength - s0) / (s1 - s0)
        own = e0 + part * (e1 - e0)  # a calibration errs alike at neighbouring loads: errors do not average out
        return n0 + part * (n1 - n0), math.hypot(own, error * (n1 - n0) / (s1 - s0))
