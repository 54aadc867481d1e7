"""A script's keyframes: shipped, cached, or solved now on every core, with a progress bar where someone is watching.

After a change of the demonstration or the forward model, ``python -m eitskin_tools.scripted_scene.prepare`` solves what
is shipped.
"""

import multiprocessing
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final, Protocol

import numpy as np

from eitskin_sim.scene.scene import Scene
from eitskin_tools.processes.signals import endings
from eitskin_tools.scripted_scene import keyframes
from eitskin_tools.scripted_scene.keyframes import Keyframes
from eitskin_tools.scripted_scene.script import Script

FEW: Final = 20
"""So many moments are solved before anybody wonders."""


def prepare(script: Script, until_s: float, *, workers: int | None = None, cache: bool = True) -> Keyframes:
    """Return the keyframes with which times up to ``until_s`` can be interpolated.

    Args:
        script: What to solve.
        until_s: A looping script needs no more than its period, whatever is asked.
        workers: Processes; by default one a core.
        cache: Read and write the user's cache folder.
    """
    moments = script.moments(until_s)
    name = keyframes.digest(moments, keyframes.MODEL)
    folder = keyframes.cache_folder()
    found = (keyframes.load(name, folder) or _shipped(script)) if cache else None
    if found is not None:
        return found
    scenes = list(dict.fromkeys(moment.scene for moment in moments))
    solved = dict(zip(scenes, _solve_all(scenes, workers or os.cpu_count() or 1), strict=True))
    found = Keyframes(
        np.array([moment.time_s for moment in moments]), np.array([solved[moment.scene] for moment in moments])
    )
    if cache:
        try:
            keyframes.save(name, found, folder)
        except OSError as error:
            print(f"eitskin: keyframes were not kept for the next time: {error}", file=sys.stderr)
    return found


def _shipped(script: Script) -> Keyframes | None:
    """Return the package's keyframes of a script, if they are of this script as it is now."""
    if not np.isfinite(script.period_s):
        return None
    return keyframes.load(keyframes.digest(script.moments(script.period_s), keyframes.MODEL), keyframes.SHIPPED)


def ship(*scripts: Script) -> list[str]:
    """Solve whole periods of scripts, put those alone where the package ships them from, and return their digests."""
    names = []
    for script in scripts:
        name = keyframes.digest(script.moments(script.period_s), keyframes.MODEL)
        if keyframes.load(name, keyframes.SHIPPED) is None:
            keyframes.save(name, prepare(script, script.period_s, cache=False), keyframes.SHIPPED)
        names.append(name)
    for stale in keyframes.SHIPPED.glob("*.npz"):
        if stale.stem not in names:
            stale.unlink()
    return names


def _solve_all(scenes: list[Scene], workers: int) -> list[keyframes.Array]:
    with _bar(len(scenes)) as step:
        if workers == 1 or len(scenes) < 8:
            results = []
            for scene in scenes:
                results.append(keyframes.solve(scene))
                step()
            return results
        with multiprocessing.Pool(workers, _default_signals) as pool:  # leaving the block terminates them, done or not
            results = []
            for voltages in pool.imap(keyframes.solve, scenes, chunksize=4):
                results.append(voltages)
                step()
            return results


def _default_signals() -> None:
    """Let a worker die of what asks for an end, and leave SIGINT to its parent."""
    for number in endings():
        signal.signal(number, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.SIG_IGN)


class _Step(Protocol):
    def __call__(self) -> None: ...


@contextmanager
def _bar(total: int) -> Iterator[_Step]:
    if not sys.stderr.isatty():
        if total > FEW:
            print(
                f"eitskin: solving {total} moments of the script for this sheet, once; it may take minutes",
                file=sys.stderr,
            )
        yield lambda: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("solving the script's keyframes", total=total)
        yield lambda: bar.advance(task)


if __name__ == "__main__":
    from eitskin_proto.skin.skin import PAPER
    from eitskin_tools.scripted_scene.script import demonstration

    print(*ship(demonstration(), demonstration(PAPER.touched("lowering"))), sep="\n")
