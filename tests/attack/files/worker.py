"""Reads damaged files, one after another, under a bound of memory and of CPU time; a process of its own.

    python -m tests.attack.files.worker FOLDER KIND

Reads a seed a line from stdin, and answers each with one line of JSON: ``how`` it ended and ``what`` was done to the
file. A try that takes longer than it may ends this process by a signal; whoever started it sees that.
"""

import gc
import json
import random
import resource
import shutil
import signal
import sys
import time
import warnings
from pathlib import Path
from typing import Any, Final

from .kinds import KINDS, Kind

MEMORY: Final = 2 << 30
"""Bytes of address space more than the process has when everything is imported."""

CPU_S: Final = 20.0
"""Of one try; the signal's default action ends the process."""

SLOW_S: Final = 8.0
"""CPU time of a try that counts as without bound; the slowest honest sample takes half a second."""

LONGEST_LINE: Final = 1500


def main() -> None:
    """Try what is asked for until stdin ends."""
    folder, kind = Path(sys.argv[1]), KINDS[sys.argv[2]]
    warnings.simplefilter("ignore")
    attempt(kind, folder, None)  # imports and whole files: what follows is damage alone
    status = Path("/proc/self/statm").read_text().split()
    limit = int(status[0]) * resource.getpagesize() + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    print("ready", flush=True)
    for line in sys.stdin:
        signal.setitimer(signal.ITIMER_PROF, CPU_S)
        found = attempt(kind, folder, int(line))
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        print(json.dumps(found), flush=True)
        gc.collect()


def attempt(kind: Kind, folder: Path, seed: int | None) -> dict[str, Any]:
    """Damage a sample, read it, and return what came of it; the sample itself if there is no seed."""
    from eitskin_proto.errors import SkinError

    place = folder / "try"
    place.mkdir()
    try:
        path, what = kind.make(place, None if seed is None else random.Random(seed))
        began = time.process_time()
        try:
            kind.read(path)
            how = "read"
        except (SkinError, OSError) as error:
            how = _judged(error)
        except BaseException as error:
            if seed is None:
                raise
            how = f"{type(error).__name__}: {str(error)[:200]}"
        if seed is None and how != "read":
            raise RuntimeError(f"the sample itself was {how}")
        spent = time.process_time() - began
        if spent > SLOW_S:
            how = f"took {spent:.0f} s of CPU"
        return {"how": how, "what": what, "seconds": round(spent, 2)}
    finally:
        for left in place.iterdir():
            if left.is_dir() and not left.is_symlink():
                left.chmod(0o700)
        shutil.rmtree(place)


def _judged(error: BaseException) -> str:
    """Return "refused" for an error with one line for people."""
    if isinstance(error, OSError):
        return "refused" if isinstance(error.filename, str) else f"{type(error).__name__} that names no file: {error}"
    text = str(error)
    if not text.strip() or "\n" in text or len(text) > LONGEST_LINE:
        return f"{type(error).__name__} with no line of its own: {text[:100]!r}"
    return "refused"


if __name__ == "__main__":
    main()
