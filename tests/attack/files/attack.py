"""Damaged files of every kind: each must be read, or refused with a line, within bounds of memory and time.

Files are read in a process for each kind, one after the other. A try that takes more CPU time than it may, or more
memory than a crash leaves, ends that process; the next one goes on with the next file.
"""

import gc
import os
import random
import resource
import shutil
import signal
import tempfile
import time
import warnings
from collections import Counter
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Final

from eitskin_proto.errors import SkinError

from ..outcome import Effort, Outcome
from .kinds import KINDS, Kind

MOST_AT_ONCE: Final = 4
"""Kinds that are tried at a time; one may take a gigabyte."""

MEMORY: Final = 2 << 30
"""Bytes of address space more than the process has when everything is imported."""

CPU_S: Final = 20.0
"""Of one try; the signal's default action ends the process."""

SLOW_S: Final = 8.0
"""CPU time of a try that counts as without bound; the slowest honest sample takes half a second."""

WALL_S: Final = 300.0
"""By the clock, for one try: one that waits for something that never comes takes no CPU."""

LONGEST_LINE: Final = 1500


def files(effort: Effort) -> Outcome:
    """Try damaged files of each kind; several kinds at a time where there are cores."""
    outcome = Outcome("files.readers")
    ways: Counter[str] = Counter()
    at_once = max(1, min(MOST_AT_ONCE, len(os.sched_getaffinity(0))))
    with tempfile.TemporaryDirectory(prefix="a") as folder, ThreadPoolExecutor(at_once) as pool:
        tries = {kind: pool.submit(_tried, kind, Path(folder), effort) for kind in KINDS}
        for kind, done in tries.items():
            for seed, (what, how) in done.result().items():
                held = how in ("read", "refused")
                ways[f"{kind}: {how if held else how.partition(':')[0]}"] += 1
                outcome.note(held, f"{kind}, seed {seed}, {what}: {how}")
    outcome.figures["by_kind"] = dict(sorted(ways.items()))
    return outcome


def _tried(kind: str, folder: Path, effort: Effort) -> dict[int, tuple[str, str]]:
    """Return what came of each seed: what was done to the file, and how it ended."""
    first, found = effort.seed * 1_000_000, dict[int, tuple[str, str]]()
    pool = None
    for seed in range(first, first + effort.count(12, KINDS[kind].long)):
        place = folder / f"{kind}-{seed}"
        place.mkdir()
        pool = pool or ProcessPoolExecutor(1, get_context("spawn"), _bounded, (kind, str(folder)))
        try:
            found[seed] = pool.submit(_attempt, kind, place, seed).result(WALL_S)
        except (BrokenProcessPool, TimeoutError) as error:
            found[seed] = "?", f"{type(error).__name__}: a bound, a crash, or {WALL_S:g} s"
            for process in pool._processes.values():
                process.kill()
            pool = None
        finally:
            shutil.rmtree(place, ignore_errors=True)
    if pool is not None:
        pool.shutdown()
    return found


def _bounded(kind: str, folder: str) -> None:
    """Read a whole sample, which imports everything, and bound the memory of this process from then on."""
    warnings.simplefilter("ignore")
    place = Path(tempfile.mkdtemp(dir=folder))
    what, how = _attempt(kind, place, None)
    if how != "read":
        raise RuntimeError(f"the sample of a {kind} itself, {what}, is {how}")
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


def _attempt(kind: str, place: Path, seed: int | None) -> tuple[str, str]:
    """Damage a sample, read it, and return what was done and how that ended; the sample itself if there is no seed."""
    read: Kind = KINDS[kind]
    path, what = read.make(place, None if seed is None else random.Random(seed))
    signal.setitimer(signal.ITIMER_PROF, CPU_S)
    began_s = time.process_time()
    try:
        read.read(path)
        how = "read"
    except (SkinError, OSError) as error:
        how = _judged(error)
    except BaseException as error:
        how = f"{type(error).__name__}: {str(error)[:200]}"
    spent_s = time.process_time() - began_s
    signal.setitimer(signal.ITIMER_PROF, 0.0)
    gc.collect()
    return what, how if spent_s < SLOW_S else f"took {spent_s:.0f} s of CPU"


def _judged(error: Any) -> str:
    """Return "refused" for an error with one line for people."""
    if isinstance(error, OSError):
        return "refused" if isinstance(error.filename, str) else f"{type(error).__name__} that names no file: {error}"
    text = str(error)
    if not text.strip() or "\n" in text or len(text) > LONGEST_LINE:
        return f"{type(error).__name__} with no line of its own: {text[:100]!r}"
    return "refused"
