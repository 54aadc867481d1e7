"""Takes a recording's frames at the times of another clock, such as that of a camera's images.

A time gets the newest published frame, as a robot would have had it then. A frame older than ``MAX_AGE_S``, or than
three periods of a slower skin, is never taken: such times have no row, and are counted.
"""

from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.files.plain import quoted
from eitskin_proto.files.reading import read_text
from eitskin_tools.recording.convert import MAX_FRAMES, Table
from eitskin_tools.recording.layout import RecordingError

MAX_AGE_S: Final = 0.1
"""Of a frame when it is taken."""

MAX_RATE_ERROR: Final = 0.1
"""Of a clock beside its nominal rate; cameras keep a few parts in a thousand."""

LARGEST_CLOCK: Final = 32 * MAX_FRAMES
"""Bytes of a file of times."""


def regular_ns(found: Table, rate_hz: float) -> npt.NDArray[np.int64]:
    """Return (k,) times at a rate, from the first to the last published frame of a recording."""
    published_ns = found.columns["wall_ns"][found.columns["withheld"] == ""]
    first, last = published_ns[[0, -1]].tolist() if len(published_ns) else (0, 0)
    steps = np.arange(int((last - first) * 1e-9 * rate_hz) + 1)
    times_ns: npt.NDArray[np.int64] = first + np.rint(steps * (1e9 / rate_hz)).astype(np.int64)
    return times_ns


def clock_ns(path: Path, rate_hz: float | None = None) -> npt.NDArray[np.int64]:
    """Return the (k,) times of a file in ns since 1970: one a line, in seconds since 1970, each after the one before.

    Args:
        path: The file.
        rate_hz: Its nominal rate, which its median step must confirm; None for any.

    Raises:
        RecordingError: It has no such times, or another rate.
        FileError: It is no text file, or too long.
        OSError: It cannot be read.
    """
    expected = "expected one time a line, in seconds since 1970"
    times_s = []
    for number, line in enumerate(read_text(path, LARGEST_CLOCK).splitlines(), start=1):
        try:
            times_s.append(float(line))
        except ValueError:
            raise RecordingError(f"line {number} of {path} is {quoted(line)}, {expected}") from None
        if not 0.0 <= times_s[-1] < 2.0**33 or (number > 1 and times_s[-1] <= times_s[-2]):
            raise RecordingError(f"line {number} of {path} is {quoted(line)}, {expected}, each after the one before")
    if not times_s:
        raise RecordingError(f"{path} is empty, {expected}")
    if rate_hz is not None and len(times_s) > 1:
        actual_hz = 1.0 / float(np.median(np.diff(times_s)))
        if abs(actual_hz / rate_hz - 1.0) > MAX_RATE_ERROR:
            raise RecordingError(
                f"{path} has {actual_hz:.4g} times a second, expected --rate {rate_hz:g}: change either"
            )
    return np.rint(np.array(times_s) * 1e9).astype(np.int64)


def resampled(found: Table, times_ns: npt.NDArray[np.int64]) -> Table:
    """Return a table with a row for each time that has a frame; column ``clock_ns`` has the time.

    Args:
        found: A recording.
        times_ns: (k,) ns since 1970, rising.

    Raises:
        RecordingError: No time has a frame.
    """
    published = np.flatnonzero(found.columns["withheld"] == "")
    frames_ns = np.maximum.accumulate(found.columns["wall_ns"][published])
    at = np.searchsorted(frames_ns, times_ns, side="right") - 1
    period_ns = np.median(np.diff(frames_ns)) if len(frames_ns) > 1 else 0.0
    fit = at >= 0
    fit[fit] = times_ns[fit] - frames_ns[at[fit]] <= max(1e9 * MAX_AGE_S, 3.0 * period_ns)
    if not fit.any():
        begin, end = 1e-9 * times_ns[[0, -1]]
        first, last = 1e-9 * found.columns["wall_ns"][[0, -1]]
        raise RecordingError(
            f"the times go from {begin:.3f} to {end:.3f} and the frames from {first:.3f} to {last:.3f}, expected times "
            "with a published frame, in seconds since 1970: name the clock of this recording"
        )
    rows = published[at[fit]]
    touches, touch_row = found.touches, found.touch_row
    if touches is not None:
        by_row = found.touches_by_row()
        picked = [by_row[row] for row in rows]
        touch_row = np.repeat(np.arange(len(rows)), [len(some) for some in picked])
        touches = np.concatenate(picked).view(np.ndarray)
    return replace(
        found,
        columns={**{name: values[rows] for name, values in found.columns.items()}, "clock_ns": times_ns[fit]},
        voltages_V=found.voltages_V[rows],
        later=found.later[rows],
        maps=None if found.maps is None else found.maps[rows],
        touches=touches,
        touch_row=touch_row,
    )
