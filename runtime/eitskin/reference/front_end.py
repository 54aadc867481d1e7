"""Detects a stuck front end: rows that are too much alike, and a capture whose rows or frames repeat.

On no sheet do many rows read the same count: rows span a factor of hundreds, and each has its own noise. Of n rows
spread with at most ``MAX_DENSITY`` to a factor of e, the chance that m rows read the same x counts, at some x of this
size, is about ::

    x (MAX_DENSITY / x)^m / m!                  ln p is summed over all groups of rows with one count; below -20
                                            (2e-9) the converter is stuck, or a drive's rows repeat

Rows that read alike in the reference are one row here, since a symmetric sheet has them in fours. Rows of no count at
all are those of an electrode that is off, and rows that the device marks as cut off are counted by themselves. Wires
that are stuck before the converter have noise: there the rows of all drives, or of all measurements, are nearly alike.

Readings that repeat from frame to frame are those of a front end that hangs (:mod:`eitskin.reference.repeats`).
"""

import math
from collections import Counter
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin.reference.repeats import SURPRISE, evidence, ranges
from eitskin_proto.sensor.table import N_ROWS, TABLE

Array = npt.NDArray[np.float64]

MAX_DENSITY: Final = 50.0
"""Rows within a factor of e: the flat sheet has 38 at most."""

MIN_LOG_CHANCE: Final = -20.0
"""ln of 2e-9, of rows that are denser than on any sheet: they are not, so that it never came in 110,000 frames."""

DISTINCT_RATIO: Final = 1.1
"""Factor between two rows of a reference that may not read the same."""

SYMMETRIC: Final = 4
"""Rows of a symmetric sheet that read the same, where no reference tells which."""

LARGEST_GROWTH: Final = 8.0
"""A row grows at most sixfold by any deformation: one that is cut off at more was not driven there by a sheet."""

MAX_CUT_OFF: Final = 8
"""Rows that may be cut off at more than ``LARGEST_GROWTH`` times their reference."""


MIN_MEAN_DISTANCE: Final = 0.02
"""Mean distance, in log, of a row from the mean of those of all drives: 0.6 and more while the demonstration plays,
noise where all drives are one."""

MIN_BESIDE_RATIO: Final = 3.0
"""Of what a row beside its drive reads more than one across: below it, all of them are looked at."""


def _row(drive: int, measure: int) -> int:
    return int(np.flatnonzero((TABLE[:, 0] == drive) & (TABLE[:, 1] == measure))[0])


def _wire(column: int, strong: int, what: str) -> tuple[int, Array, Array, str]:
    """Return of rows with one drive (0) or measurement (1): a strong row, distance from the mean, weights, name."""
    same = TABLE[:, column][:, None] == TABLE[:, column][None, :]
    judged = same.sum(axis=1) >= 4
    return strong, np.eye(N_ROWS) - same / same.sum(axis=1, keepdims=True), judged / judged.sum(), what


_ACROSS: Final = _row(0, 8)
"""A row across the sheet; one beside the same drive, or the same measurement, reads a hundred times as much."""
_WIRES: Final = (_wire(0, _row(0, 2), "measurements"), _wire(1, _row(6, 8), "drives"))


def stuck(
    counts: npt.NDArray[np.number],
    reference: npt.NDArray[np.number] | None = None,
    cut_off: int = 0,
    limit: float = 0,
    *,
    own_rows: bool = True,
) -> str:
    """Return the fault of rows that no sheet can have, or "".

    Args:
        counts: (rows,) as converted, or means of two readings; or (n,) of the idle drives.
        reference: As many counts of the reference, 0 in rows that carry nothing; None where there is none yet.
        cut_off: Bit r: the device says that row r was cut off.
        limit: Largest count of the converter.
        own_rows: 104 rows are those of the project's table, so that drives and measurements can be compared.
    """
    marked = None
    if cut_off:
        whole = np.frombuffer(cut_off.to_bytes((max(len(counts), N_ROWS) + 7) // 8, "little"), np.uint8)
        marked = np.unpackbits(whole, bitorder="little", count=len(counts)) > 0
        if reference is not None:
            strange = int((marked & (np.abs(reference) * LARGEST_GROWTH < limit)).sum())
            if strange > MAX_CUT_OFF:
                return f"{strange} rows are cut off at {limit:g} counts, of which the reference has an eighth at most"
        counts = np.where(marked, 0, counts)
    values = counts.tolist()  # what every frame far from its reference comes through: no numpy, whose calls are cold
    if len(values) - len(set(values)) > 1 and (found := _alike(counts, values, reference)):
        return found
    if own_rows and len(values) == N_ROWS:
        weak = MIN_BESIDE_RATIO * abs(values[_ACROSS])
        for strong, depart, weights, what in _WIRES:
            if abs(values[strong]) < weak and counts.all():
                logs = np.abs(counts, dtype=np.float64)
                apart = depart @ np.log(logs, out=logs)
                if float(np.abs(apart, out=apart) @ weights) < MIN_MEAN_DISTANCE:
                    return f"the rows of all {what} are identical"
    return ""


def _alike(
    counts: npt.NDArray[np.number],
    values: list[float],
    reference: npt.NDArray[np.number] | None,
) -> str:
    """Return whether rows share counts as no sheet's do; ``values`` are the counts once more, as numbers."""
    chance, same, most, which, total = 0.0, 0, 0, 0.0, len(counts)
    crowded = max(1.0, total / N_ROWS)  # 208 rows are 104 read both ways
    for value in [value for value, times in Counter(values).items() if value and times > 1]:
        group = np.flatnonzero(counts == value)
        many = _different(group, reference, SYMMETRIC * math.ceil(crowded))
        if len(group) >= 0.75 * total:
            chance = -math.inf
        elif many < 2:
            continue
        if len(group) > most:
            most, which = len(group), value
        same += len(group)
        size = abs(float(value))
        chance += min(0.0, math.log(size) + many * math.log(MAX_DENSITY * crowded / size) - math.lgamma(many + 1.0))
    if chance >= MIN_LOG_CHANCE:
        return ""
    return f"{same} of {total} rows share counts, {most} of them {which:g}"


def _different(rows: npt.NDArray[np.intp], reference: npt.NDArray[np.number] | None, symmetric: int) -> int:
    """Return how many of some rows should read differently."""
    if reference is None:
        return max(1, len(rows) - symmetric + 1)
    different, last = 0, 0.0
    for size in np.sort(np.abs(reference[rows])).tolist():
        if size > DISTINCT_RATIO * last:
            different, last = different + 1, size
    return different


def repeated(voltages: Array, step_V: float) -> tuple[str, ...]:
    """Return what of a capture's repetitions no living front end reads.

    Args:
        voltages: (n, rows) V.
        step_V: Of one count.
    """
    mean_V, steps = voltages.mean(axis=0), np.diff(voltages, axis=0)
    same = np.count_nonzero(steps == 0.0, axis=0)
    if same.min() == len(steps):
        return (
            f"all {len(voltages)} frames are the same bit by bit: the front end hangs, or it has no noise at all, as "
            "only a simulation can",
        )
    # Noise from one frame to the next. A row that hangs has none: what the others have counts, in V or as a share
    size, there = np.abs(mean_V), mean_V != 0.0
    noise_V = np.sqrt(np.mean(steps**2, axis=0) / 2.0)
    usual_V = np.minimum(np.median(noise_V[there] / size[there]) * size, np.median(noise_V[there]))
    chance = np.exp(-evidence(np.maximum(noise_V, usual_V) / step_V)) * len(steps)
    surprise = same * np.log(np.maximum(same / chance, 1.0)) - same + chance
    hanging = np.flatnonzero((surprise >= SURPRISE) & (same > chance) & there)
    if not hanging.size:
        return ()
    return (f"rows {ranges(hanging)} repeat their reading, which noise does not do: the front end hangs",)


def front_end_faults(voltages: Array, step_V: float | None = None) -> tuple[str, ...]:
    """Return the faults of the front end that recorded frames show; none if it works.

    Args:
        voltages: (n, 104) V.
        step_V: Of one count; None takes a 24-bit converter's that the recording fills to a half.
    """
    step_V = step_V or max(float(np.abs(voltages).max()), 1e-30) / (1 << 22)
    faults = list(repeated(voltages, step_V))
    found = [text for frame in np.rint(voltages / step_V) if (text := stuck(frame))]
    if found:
        faults.append(f"in {len(found)} of {len(voltages)} frames its converter or multiplexer is stuck: {found[-1]}")
    return tuple(faults)
