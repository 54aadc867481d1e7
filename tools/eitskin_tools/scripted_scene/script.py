"""A scripted scene: the sheet and its true map at every moment.

A script is deterministic in time. The demonstration loops through :mod:`eitskin_tools.scripted_scene.choreography`; a
scene from a file is held still. Both begin flat and untouched, because that is when a reference is captured. Everything
that the virtual skin measures, the truth that the streamed maps are judged by, and the cloud that a scanner would send
follow from :meth:`Script.scene_at`.
"""

import multiprocessing
import os
import signal
import sys
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.scene.area import area_map
from eitskin_sim.scene.nominal import nominal_scene
from eitskin_sim.scene.scene import Scene, load_scene
from eitskin_sim.surface.measured_cloud import measured_cloud
from eitskin_tools.console.progress import ProgressBar
from eitskin_tools.processes.signals import endings
from eitskin_tools.scripted_scene import choreography, keyframes
from eitskin_tools.scripted_scene.keyframes import Keyframes, Moment

CURRENT_A: Final = 1e-3
"""What the electronics drive: the "paper" configuration's 1 mA."""

ELEMENT_MM: Final = 2.7
"""Element size of the keyframes' mesh; no data set is generated on this one."""


@dataclass(frozen=True, slots=True)
class Script:
    """A scene that changes with time."""

    name: str
    period_s: float
    """The script repeats after this; infinite for a scene that is held."""
    events_s: tuple[float, ...]
    """Times within a period between which everything is smooth, ascending, from 0."""
    scene: Callable[[float, bool], Scene]
    """(time within the period, whether just before it) -> scene."""
    skin: Skin = PAPER
    """What it plays on: its size, electrodes and map."""

    def scene_at(self, time_s: float) -> Scene:
        """Return the scene at a time since the start, the touches and bend of that moment."""
        return self.scene(self.phase_s(time_s), False)

    def phase_s(self, time_s: float) -> float:
        """Return the time within the period."""
        return time_s % self.period_s if np.isfinite(self.period_s) else max(time_s, 0.0)

    def truth_at(self, time_s: float) -> npt.NDArray[np.float32]:
        """Return the (rows, columns) map of how much of each pixel is touched, 0 to 1."""
        scene = self.scene_at(time_s)
        area = area_map(scene.touches, self.skin.grid, scene.sheet.conductivity_S_per_m)
        return np.asarray(area, dtype=np.float32)

    def cloud_at(self, time_s: float, rng: np.random.Generator | None = None) -> npt.NDArray[np.float64]:
        """Return the (3, rows, columns) mm cloud that a scanner gives at a time.

        Args:
            time_s: Since the start.
            rng: Source of the scanner's noise; None for a perfect scanner.
        """
        return np.asarray(measured_cloud(self.scene_at(time_s).bend, rng, skin=self.skin), dtype=np.float64)

    def moments(self, until_s: float, step_s: float = keyframes.STEP_S) -> list[Moment]:
        """Return the keyframes to solve so that times up to ``until_s`` can be interpolated."""
        last = min(until_s, self.period_s)
        times = keyframes.moment_times_s(self.events_s, last, step_s)
        found: list[Moment] = []
        for index, time_s in enumerate(times):
            doubled = index + 1 < len(times) and times[index + 1] == time_s
            found.append(Moment(float(time_s), self.scene(float(time_s), doubled)))
        return found

    def voltages_at(self, time_s: float, solved: Keyframes) -> npt.NDArray[np.float64]:
        """Return the (104,) V at a time since the start."""
        return solved.at(self.phase_s(time_s))


def demonstration(skin: Skin = PAPER) -> Script:
    """Return the looping script of the demonstration."""
    flat = replace(nominal_scene(skin, element_size_mm=ELEMENT_MM), current_A=CURRENT_A)

    def scene(time_s: float, before: bool) -> Scene:
        touches = choreography.touches_at(time_s, skin, before=before)
        return replace(flat, bend=choreography.bend_at(time_s), touches=touches)

    return Script("demonstration", choreography.PERIOD_S, choreography.events_s(), scene, skin)


def still(scene: Scene, name: str = "still", skin: Skin = PAPER) -> Script:
    """Return a script that is flat and untouched for a while, and then holds one scene for ever.

    Args:
        scene: What to hold; its current is replaced by the electronics'.
        name: What messages call it.
        skin: Whose scene it is.
    """
    held = replace(scene, current_A=CURRENT_A)
    flat, flat_s = held.reference(), choreography.UNTOUCHED_FLAT_S

    def at(time_s: float, before: bool) -> Scene:
        return flat if time_s < flat_s or (before and time_s == flat_s) else held

    return Script(name, float("inf"), (0.0, flat_s, flat_s + 1.0), at, skin)


def script_of(scene: str | Path | None, skin: Skin = PAPER) -> Script:
    """Return the script that holds a scene's file, or the demonstration's.

    Raises:
        SceneError: The file is no valid scene.
        OSError: The file cannot be read.
    """
    if scene is None:
        return demonstration(skin)
    return still(load_scene(scene, skin), Path(scene).name, skin=skin)


QUIETLY_SOLVED_MOMENTS: Final = 20
"""Moments that are solved without a message."""


def prepare(script: Script, until_s: float, *, cache: bool = True) -> Keyframes:
    """Return the keyframes with which times up to ``until_s`` can be interpolated.

    Args:
        script: What to solve.
        until_s: A looping script needs no more than its period, whatever is asked.
        cache: Read and write the user's cache folder.
    """
    moments = script.moments(until_s)
    name = keyframes.digest(moments, keyframes.MODEL)
    folder = keyframes.cache_folder()
    found = (keyframes.load(name, folder) or _shipped(script)) if cache else None
    if found is not None:
        return found
    scenes = list(dict.fromkeys(moment.scene for moment in moments))
    solved = dict(zip(scenes, _solve_all(scenes, os.cpu_count() or 1), strict=True))
    found = Keyframes(
        np.array([moment.time_s for moment in moments]), np.array([solved[moment.scene] for moment in moments])
    )
    if cache:
        try:
            keyframes.save(name, found, folder)
        except OSError as error:
            print(f"eitskin: keyframes could not be cached: {error}", file=sys.stderr)
    return found


def _shipped(script: Script) -> Keyframes | None:
    """Return the package's keyframes of a script, if they are of this script as it is now."""
    if not np.isfinite(script.period_s):
        return None
    return keyframes.load(keyframes.digest(script.moments(script.period_s), keyframes.MODEL), keyframes.SHIPPED_FOLDER)


def ship(*scripts: Script) -> list[str]:
    """Solve whole periods of scripts, put those alone where the package ships them from, and return their digests."""
    names = []
    for script in scripts:
        name = keyframes.digest(script.moments(script.period_s), keyframes.MODEL)
        if keyframes.load(name, keyframes.SHIPPED_FOLDER) is None:
            keyframes.save(name, prepare(script, script.period_s, cache=False), keyframes.SHIPPED_FOLDER)
        names.append(name)
    for stale in keyframes.SHIPPED_FOLDER.glob("*.npz"):
        if stale.stem not in names:
            stale.unlink()
    return names


def _solve_all(scenes: list[Scene], workers: int) -> list[keyframes.Array]:
    if len(scenes) > QUIETLY_SOLVED_MOMENTS and not sys.stderr.isatty():
        text = f"solving {len(scenes)} moments of the script for this sheet, once; it may take minutes"
        print(f"eitskin: {text}", file=sys.stderr)
    with ExitStack() as stack:
        bar = stack.enter_context(ProgressBar("solving the script's keyframes", lines=False))
        solved: Iterable[keyframes.Array] = map(keyframes.solve, scenes)
        if workers > 1 and len(scenes) >= 8:  # leaving the block terminates them, done or not
            pool = stack.enter_context(multiprocessing.Pool(workers, _default_signals))
            solved = pool.imap(keyframes.solve, scenes, chunksize=4)
        results = []
        for voltages in solved:
            results.append(voltages)
            bar.show(len(results), len(scenes))
        return results


def _default_signals() -> None:
    """Let a worker die of what asks for an end, and leave SIGINT to its parent."""
    for number in endings():
        signal.signal(number, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.SIG_IGN)


if __name__ == "__main__":
    from eitskin_proto.skin.skin import PAPER

    print(*ship(demonstration(), demonstration(PAPER.touched("lower"))), sep="\n")
