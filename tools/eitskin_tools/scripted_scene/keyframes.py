"""Solves voltages at a few moments, and interpolates their logarithms between these.

The forward model needs milliseconds, the virtual skin a frame every one to five. Between events the script is smooth,
so voltages solved every ``STEP_S`` and interpolated in log |V| follow it: a stretch multiplies voltages, which is
linear there. A moment at which a touch comes or goes is solved twice, just before and just after, and is in the list
twice::

    times_s   1.70  1.75  1.80 | 1.80  1.85 ...        searchsorted(side="right") falls between the two

Moments whose scenes are equal are solved once. The demonstration's keyframes are shipped with the package, and others
are kept in the user's cache; both carry a digest of the moments and of the model, so that a changed script is solved
again.
"""

import hashlib
import itertools
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.files.arrays import read_npz
from eitskin_proto.files.writing import replacing
from eitskin_proto.sensor.table import N_ROWS
from eitskin_sim.fem.solve import solve_scene
from eitskin_sim.scene.scene import Scene, scene_json

Array = npt.NDArray[np.float64]

STEP_S: Final = 0.05
"""Between two keyframes at most: it leaves 2e-4 of V, rms."""

MIN_STEPS: Final = 6
"""Between two events at least: a touch that is being pressed changes faster than anything else."""

MODEL: Final = "tensor mesh snapped to touches, biquadratic, kinked; 2"
"""Stands for the forward model in digests; the number grows when its voltages change by more than 1e-3."""

LARGEST_FILE: Final = 64 << 20
"""Bytes of kept keyframes; those of the demonstration have 110,000."""

SHIPPED_FOLDER: Final = Path(__file__).with_name("solved")
"""Keyframes that come with the package."""

Solve = Callable[[Scene], Array]
"""From a scene to its (104,) V."""


def solve(scene: Scene) -> Array:
    """Return the (104,) V of a scene by the forward model."""
    return solve_scene(scene).voltages


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
            return np.array(self.voltages[min(right, len(times) - 1)])
        start, stop = self.voltages[right - 1], self.voltages[right]
        share = (time_s - times[right - 1]) / (times[right] - times[right - 1])
        if share == 0.0:
            return np.array(start)
        ratio = stop / start
        if np.all(ratio > 0.0):
            return np.asarray(start * ratio**share)
        return np.asarray(np.where(ratio > 0.0, start * np.abs(ratio) ** share, start + share * (stop - start)))


def moment_times_s(events_s: Sequence[float], until_s: float, step_s: float = STEP_S) -> Array:
    """Return the times to solve: every event, and at most ``step_s`` apart, up to the first past ``until_s``."""
    times: list[float] = []
    for start, stop in itertools.pairwise(events_s):
        if start > until_s:
            break
        count = max(MIN_STEPS, int(np.ceil((stop - start) / step_s - 1e-9)))
        times.extend(np.linspace(start, stop, count + 1).tolist())
    return np.array(times)


def digest(moments: Sequence[Moment], model: str) -> str:
    """Return 16 hex digits that stand for these moments, solved by this model."""
    content = hashlib.sha256(model.encode())
    for moment in moments:
        content.update(f"{moment.time_s!r} {scene_json(moment.scene)}\n".encode())
    return content.hexdigest()[:16]


def cache_folder() -> Path:
    """Return the user's cache folder for keyframes (XDG base directory specification)."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "eitskin" / "keyframes"


def load(name: str, folder: Path) -> Keyframes | None:
    """Return the keyframes of an earlier run, or None where there are none that can be read."""
    try:
        file = read_npz(folder / f"{name}.npz", LARGEST_FILE)
        times_s, voltages = file["times_s"].astype(np.float64), file["voltages"].astype(np.float64)
    except (OSError, ValueError, KeyError):
        return None
    fits = times_s.ndim == 1 and len(times_s) > 0 and voltages.shape == (len(times_s), N_ROWS)
    return Keyframes(times_s, voltages) if fits and np.isfinite(voltages).all() and np.isfinite(times_s).all() else None


def save(name: str, keyframes: Keyframes, folder: Path) -> None:
    """Store keyframes in one step: a reader sees the whole file or none.

    Raises:
        OSError: The folder cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with replacing(folder / f"{name}.npz") as file:
        np.savez_compressed(file, times_s=keyframes.times_s, voltages=keyframes.voltages.astype(np.float32))
