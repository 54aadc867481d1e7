"""Voltages at a few moments, and between them by interpolating their logarithms.

The forward model needs milliseconds, the virtual skin a frame every one to five. Between events the script is smooth, so
voltages solved every ``STEP_S`` and interpolated in log |V| follow it: a stretch multiplies voltages, which is linear
there. A moment at which a touch comes or goes is solved twice, just before and just after, and stands twice in the list::

    times_s   1.70  1.75  1.80 | 1.80  1.85 ...        searchsorted(side="right") falls between the two

Moments whose scenes are equal are solved once. Solving starts again only where the file of an earlier run is missing.
"""

import hashlib
import os
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_sim.scene import Scene, scene_json

Array = npt.NDArray[np.float64]

STEP_S: Final = 0.05
"""Between two keyframes. The error that this leaves is measured by :func:`interpolation_error`."""

Solve = Callable[[Scene], Array]
"""From a scene to its (104,) V."""


@dataclass(frozen=True, slots=True)
class Moment:
    """One keyframe's time and scene."""

    time_s: float
    scene: Scene


@dataclass(frozen=True, slots=True, eq=False)
class Keyframes:
    """Solved moments."""

    times_s: Array
    """(n,) ascending; an event stands twice."""
    voltages: Array
    """(n, rows) V."""

    def at(self, time_s: float) -> Array:
        """Return the (rows,) V at a time; before the first and after the last keyframe theirs."""
        times = self.times_s
        right = int(np.searchsorted(times, time_s, side="right"))
        if right == 0 or right == len(times):
            return self.voltages[min(right, len(times) - 1)].copy()
        start, stop = self.voltages[right - 1], self.voltages[right]
        share = (time_s - times[right - 1]) / (times[right] - times[right - 1])
        if share == 0.0:
            return start.copy()
        ratio = stop / start
        if np.all(ratio > 0.0):
            return np.asarray(start * ratio**share)
        return np.asarray(np.where(ratio > 0.0, start * np.abs(ratio) ** share, start + share * (stop - start)))


def moment_times_s(events_s: Sequence[float], until_s: float, step_s: float = STEP_S) -> Array:
    """Return the times to solve: every event, and evenly at most ``step_s`` apart in between, up to the one past ``until_s``."""
    times: list[float] = []
    for start, stop in zip(events_s, events_s[1:], strict=False):
        if start > until_s:
            break
        count = max(1, int(np.ceil((stop - start) / step_s - 1e-9)))
        times.extend(np.linspace(start, stop, count + 1).tolist())
    return np.array(times)


def digest(moments: Sequence[Moment], model: str) -> str:
    """Return 16 hex digits that stand for these moments, solved by this model."""
    content = hashlib.sha256(model.encode())
    for moment in moments:
        content.update(f"{moment.time_s!r} {scene_json(moment.scene)}\n".encode())
    return content.hexdigest()[:16]


def solve_moments(moments: Sequence[Moment], solve: Solve) -> Iterator[tuple[int, Array]]:
    """Yield (index, (rows,) V) of every moment, solving equal scenes once."""
    known: dict[Scene, Array] = {}
    for index, moment in enumerate(moments):
        if moment.scene not in known:
            known[moment.scene] = solve(moment.scene)
        yield index, known[moment.scene]


def cache_folder() -> Path:
    """Return the user's cache folder for keyframes (XDG base directory specification)."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "eitskin" / "keyframes"


def load(name: str, folder: Path) -> Keyframes | None:
    """Return the keyframes of an earlier run, or None where there are none that can be read."""
    try:
        with np.load(folder / f"{name}.npz", allow_pickle=False) as file:
            return Keyframes(file["times_s"], file["voltages"])
    except (OSError, ValueError, KeyError, EOFError):
        return None


def save(name: str, keyframes: Keyframes, folder: Path) -> None:
    """Store keyframes in one step: a reader sees the whole file or none.

    Raises:
        OSError: The folder cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=folder, prefix=f".{name}-", suffix=".npz", delete=False) as file:
        try:
            np.savez(file, times_s=keyframes.times_s, voltages=keyframes.voltages)
            os.replace(file.name, folder / f"{name}.npz")
        except BaseException:
            os.unlink(file.name)
            raise


def interpolation_error(
    keyframes: Keyframes, scene_at: Callable[[float], Scene], solve: Solve, times_s: Array
) -> Array:
    """Return the (n, rows) relative error |V - V_solved| / |V_solved| at some times, the middles of steps being the worst."""
    errors = []
    for time_s in times_s:
        exact = solve(scene_at(float(time_s)))
        errors.append(np.abs(keyframes.at(float(time_s)) - exact) / np.abs(exact))
    return np.array(errors)
