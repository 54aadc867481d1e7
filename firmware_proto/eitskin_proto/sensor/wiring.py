"""How the rows of a foreign reading are ordered, by the levels of an untouched sheet.

The levels of rows are known to a factor: far pairs read less than near ones, and pairs beside a corner differ. So the
rank correlation of readings with a forward model shows whether rows are in order: 0.93 to 0.99 on sheets and tanks that
are, 0.8 to 0.9 where they are off by one row, about 0 where they are shuffled. Each known order is a permutation of the
model's rows::

    order       the table's 104 rows, or their reciprocals; all 208 as this project or as pyEIT sorts them
    shifted     readings come one or two rows late or early
    rolled      electrode 0 is at another electrode's place
    reversed    electrodes are numbered clockwise

The permutation with the largest likelihood of ranks is named if it is far more likely than the stated one. A
permutation that leaves the model's levels as they are, such as half a turn of a rectangle, cannot be distinguished.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.table import (
    FULL_TABLE,
    N_ELECTRODES,
    N_FULL_ROWS,
    N_ROWS,
    RECIPROCAL_IN_FULL,
    ROW_IN_FULL,
    TABLE,
)

Array = npt.NDArray[np.float64]
Table = npt.NDArray[np.intp]

MIN_RANK_CORRELATION: Final = 0.9
"""Of a known order, at least. Rows off by one reach 0.9 at most, real sheets and tanks in order 0.93 at least."""

MIN_LOG_LIKELIHOOD: Final = 10.0
"""Gain of another order's log likelihood above which it is named."""

STRUCTURED_SHARE: Final = 0.6
"""Share of the variance of log readings that drives, pairs and their distance explain in any order of a real sheet;
shuffled rows have 0.25 to 0.4."""

SAME_LEVELS: Final = 0.999
"""Correlation of log levels from which an order cannot be distinguished from the stated one."""

MIN_LAG_GAIN: Final = 0.3
"""Gain of the logarithm of touched over untouched changes above which readings are late or early by one; a lag that is
right also makes that logarithm as large."""

MIN_UNTOUCHED: Final = 6
"""Untouched readings that a lag is found from."""


@dataclass(frozen=True, slots=True)
class Wiring:
    """What the levels of rows say about their order."""

    right: bool
    """Rows are in the stated order, as far as levels show."""
    text: str
    """The finding in a sentence."""
    rank_correlation: float
    """Of the readings with the model in the stated order."""
    inverted: bool
    """Readings have the opposite sign of the model's. Changes relative to a reference do not depend on it."""
    reciprocity: float | None = None
    """Median relative difference of reciprocal rows; None where 104 rows are read."""


def read_wiring(readings_V: Array, model_V: Array) -> Wiring:
    """Return whether rows are in order, or which known order they have.

    Args:
        readings_V: (104,) or (208,) V, or (n, 104) or (n, 208), whose medians are taken; of a mostly untouched sheet.
        model_V: (104,) V in table order, or (208,), of a forward model, any current.

    Raises:
        ValueError: Readings have another number of rows, or are not finite.
    """
    readings = np.atleast_2d(np.asarray(readings_V, dtype=np.float64))
    if readings.ndim != 2 or readings.shape[1] not in (N_ROWS, N_FULL_ROWS) or not np.isfinite(readings).all():
        raise ValueError(f"readings of shape {readings.shape}, expected finite (n, {N_ROWS}) or (n, {N_FULL_ROWS}) V")
    read, model = np.median(readings, axis=0), np.asarray(model_V, dtype=np.float64)
    model = model[ROW_IN_FULL] if len(model) == N_FULL_ROWS else model
    levels = np.zeros((N_ELECTRODES, N_ELECTRODES))
    levels[TABLE[:, 0], TABLE[:, 1]] = levels[TABLE[:, 1], TABLE[:, 0]] = np.abs(model)
    stated = (TABLE if len(read) == N_ROWS else FULL_TABLE).astype(np.intp)
    expected = levels[stated[:, 0], stated[:, 1]]
    sign = np.sign(np.median(read)) or 1.0
    found = rank_correlation(sign * read, expected)
    inverted = bool(sign * np.sign(np.median(model)) < 0.0)
    apart = None
    if len(read) == N_FULL_ROWS:
        one, other = read[ROW_IN_FULL], read[RECIPROCAL_IN_FULL]
        apart = float(np.median(2.0 * np.abs(one - other) / (np.abs(one) + np.abs(other) + 1e-300)))
    names = _better_orders(sign * read, stated, levels, found)
    if names:
        text = f"the rows are not in the stated order: {' or '.join(names)}"
    elif _without_two(sign * read, stated, expected) >= MIN_RANK_CORRELATION:
        signs = ", with inverted signs, which changes do not depend on" if inverted else ""
        return Wiring(True, f"the rows are in order{signs}", found, inverted, apart)
    elif _structured_share(read, stated) > STRUCTURED_SHARE:
        text = (
            "the levels are not those of a sheet read by four wires: look for an offset of each drive, contacts in the "
            "measured path, or a sink current that is not the source's"
        )
    else:
        text = "the rows are in no known order"
    return Wiring(False, f"{text} (rank correlation with the model {found:.2f})", found, inverted, apart)


def lag_of(readings_V: Array, touched: npt.NDArray[np.bool_]) -> int:
    """Return by how many readings a series is late against its labels: 1, 0 or -1.

    Args:
        readings_V: (n, rows) V in order of time.
        touched: (n,) whether something touched the sheet at each.
    """
    if np.count_nonzero(~touched) < MIN_UNTOUCHED or np.count_nonzero(touched) < MIN_UNTOUCHED:
        return 0
    score = {lag: _separation(np.roll(readings_V, -lag, axis=0), touched) for lag in (0, 1, -1)}
    best = max(score, key=lambda lag: score[lag])
    return best if score[best] > max(score[0], 0.0) + MIN_LAG_GAIN else 0


def _separation(readings: Array, touched: npt.NDArray[np.bool_]) -> float:
    """Return the logarithm of what touched readings change, over what untouched ones do, since the last untouched."""
    untouched = np.flatnonzero(~touched)
    last = untouched[np.maximum(np.searchsorted(untouched, np.arange(len(readings)), side="left") - 1, 0)]
    change = (readings - readings[last])[untouched[0] + 1 :]
    size = np.median(np.abs(change), axis=0) + 1e-300
    energy, pressed = np.mean((change / size) ** 2, axis=1), touched[untouched[0] + 1 :]
    return float(np.log(np.median(energy[pressed]) + 1e-300) - np.log(np.median(energy[~pressed]) + 1e-300))


def _orders(rows: int) -> Iterator[tuple[str, Table]]:
    """Return known orders by their names, the stated one first."""
    full = FULL_TABLE.astype(np.intp)
    if rows == N_ROWS:
        lower = full[full[:, 0] > full[:, 1]]
        bases = {"": TABLE.astype(np.intp), "reciprocal rows": lower, "reciprocal rows by drive": _sorted(lower)}
    else:
        bases = {"": full, "pyEIT's order": _sorted(full)}
    for name, base in bases.items():
        if name:
            yield name, base
        of = f" of {name}" if name else ""
        for rows_late in (1, -1, 2, -2):
            many = f"{abs(rows_late)} row{'s' if abs(rows_late) > 1 else ''} {'late' if rows_late > 0 else 'early'}"
            yield f"readings come {many}{of}", np.roll(base, rows_late, axis=0)
        for k in range(1, N_ELECTRODES):
            yield f"electrode 0 is at the place of {k}{of}", (base + k) % N_ELECTRODES
        for k in range(N_ELECTRODES):
            yield f"electrodes run clockwise from the place of {(k + 1) % N_ELECTRODES}{of}", (k - base) % N_ELECTRODES


def _better_orders(read: Array, stated: Table, levels: Array, found: float) -> list[str]:
    """Return the names of the most likely order and of those with the same levels, at most four.

    There are none where the stated order is about as likely.
    """
    expected = np.log(levels[stated[:, 0], stated[:, 1]])
    others: list[tuple[str, Array]] = []
    for name, order in _orders(len(read)):
        other = np.log(levels[order[:, 0], order[:, 1]])
        if np.corrcoef(expected, other)[0, 1] < SAME_LEVELS:
            others.append((name, other))
    if not others:
        return []
    scores = [rank_correlation(read, other) for _, other in others]
    best = max(scores)
    left = [max(1.0 - rank * abs(rank), 1e-9) for rank in (found, best)]
    gain = 0.5 * N_ROWS * float(np.log(left[0] / left[1]))
    if best < MIN_RANK_CORRELATION or gain < MIN_LOG_LIKELIHOOD:
        return []
    likely = others[scores.index(best)][1]
    names = [name for name, other in others if np.corrcoef(likely, other)[0, 1] >= SAME_LEVELS]
    return names[: 4 if "place" in names[0] else 1]


def _without_two(read: Array, stated: Table, expected: Array) -> float:
    """Return the best rank correlation without the rows of two neighbours, which may have failed."""
    best = rank_correlation(read, expected)
    for electrode in range(N_ELECTRODES):
        pairs = (electrode - 1, electrode, (electrode + 1) % N_ELECTRODES)
        kept = ~np.isin(stated, np.array(pairs) % N_ELECTRODES).any(axis=1)
        best = max(best, rank_correlation(read[kept], expected[kept]))
    return best


def _structured_share(read: Array, stated: Table) -> float:
    """Return the share of the variance of log readings that drives, pairs and their distance explain."""
    apart = (stated[:, 1] - stated[:, 0]) % N_ELECTRODES
    apart = np.minimum(apart, N_ELECTRODES - apart)
    each = np.arange(N_ELECTRODES)
    columns = np.hstack([of[:, None] == each for of in (stated[:, 0], stated[:, 1], apart)]).astype(np.float64)
    logs = np.log(np.abs(read) + 1e-300)
    logs -= logs.mean()
    left = logs - columns @ np.linalg.lstsq(columns, logs, rcond=None)[0]
    return float(1.0 - left @ left / (logs @ logs + 1e-300))


def rank_correlation(one: Array, other: Array) -> float:
    """Return Spearman's correlation of two (n,) arrays."""
    first, second = (np.argsort(np.argsort(values)).astype(np.float64) for values in (one, other))
    return float(np.corrcoef(first, second)[0, 1])


def _sorted(table: Table) -> Table:
    return table[np.lexsort((table[:, 1], table[:, 0]))]
