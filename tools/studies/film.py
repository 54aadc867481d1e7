"""What looking at a recording costs: how soon it is there, how long a jump takes, what memory it needs."""

import argparse
import json
import random
import resource
import sys
import time
from pathlib import Path
from typing import Any, Final

import numpy as np

from eitskin_tools.bench.harness import program
from eitskin_tools.command_line import files
from eitskin_tools.recording.layout import FRAME, WIRE
from eitskin_tools.recording.reader import Recording
from eitskin_tools.view.film import Film, Overview

JUMPS: Final = 100
"""To different seconds, in any order."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("file", type=Path, metavar="FILE.mcap", help="the recording")
    parser.add_argument("--bundle", type=files.bundle, help="what computes its maps")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Measure, print, and return 0."""
    found = measured(arguments.file, arguments.bundle)
    print(json.dumps(found) if arguments.json else printed(found))
    return 0


def measured(path: Path, bundle: Path | None = None) -> dict[str, Any]:
    """Return what one recording showed.

    Args:
        path: Of the recording.
        bundle: What computes its maps; None for the one that was running.
    """
    begin_s = time.perf_counter()
    film = Film(path, bundle)
    open_s = time.perf_counter() - begin_s
    took_ms, cpu_ms, sizes = [], [], []
    for number in random.Random(7).sample(range(film.parts), min(JUMPS, film.parts)):
        begin_s, begin_cpu_s = time.perf_counter(), time.process_time()
        sizes.append(len(film.part(number)))
        took_ms.append(1000.0 * (time.perf_counter() - begin_s))
        cpu_ms.append(1000.0 * (time.process_time() - begin_cpu_s))
    before_MB = _peak_MB()
    begin_s, overview = time.process_time(), Overview(film.seconds, film.first_ns)
    for entry in Recording(path).entries({WIRE.topic, FRAME.topic}):
        overview.add(entry)
    message = overview.message(done=True)
    return {
        "seconds": round(film.seconds, 1),
        "file_MB": round(path.stat().st_size / 1e6, 1),
        "open_s": round(open_s, 3),
        "jumps": len(sizes),
        "jump_p50_ms": round(float(np.quantile(took_ms, 0.5)), 1),
        "jump_p99_ms": round(float(np.quantile(took_ms, 0.99)), 1),
        "jump_cpu_p50_ms": round(float(np.quantile(cpu_ms, 0.5)), 1),
        "part_kB": round(sum(sizes) / len(sizes) / 1e3, 1),
        "overview_cpu_s": round(time.process_time() - begin_s, 2),
        "overview_kB": round(len(message) / 1e3, 1),
        "peak_MB": round(before_MB, 1),
        "peak_with_overview_MB": round(_peak_MB(), 1),
    }


def _peak_MB() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def printed(found: dict[str, Any]) -> str:
    """Return it in words."""
    return (
        f"{found['seconds']:g} s in {found['file_MB']:g} MB: open after {found['open_s']:g} s\n"
        f"a jump takes {found['jump_p50_ms']:g} ms (p50), {found['jump_p99_ms']:g} ms (p99) of {found['jumps']}, "
        f"{found['jump_cpu_p50_ms']:g} ms of CPU (p50); {found['part_kB']:g} kB each\n"
        f"all marks after {found['overview_cpu_s']:g} s of CPU, {found['overview_kB']:g} kB\n"
        f"peak memory {found['peak_MB']:g} MB, with the marks {found['peak_with_overview_MB']:g} MB"
    )


if __name__ == "__main__":
    sys.exit(program(__doc__, add_arguments, run))
