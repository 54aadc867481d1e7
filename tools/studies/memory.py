"""Does the runtime's memory stay flat over minutes at 1000 frames a second?

The virtual skin, ``eitskin run`` and a subscriber that takes every frame run as processes, and the runtime's resident
memory, threads and open files are read from /proc once a second. The first part is left out of the judgement: caches of
texts and the ring of stamps fill then. A slope is reported beside the extremes, since a leak of a few bytes a frame
would hide in them: at 1000 frames/s one byte a frame is 3.6 MB an hour.
"""

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Final

from eitskin_tools.bench.harness import program, show
from eitskin_tools.command_line import files
from eitskin_tools.errors import UsageError

SETTLING_SHARE: Final = 0.25
"""Share of the samples that is left out."""

READY_TIMEOUT_S: Final = 60.0
"""How long the processes may take to be ready, on a busy machine."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--seconds", type=float, default=600.0, metavar="S", help="length of the stream (default 600)")
    parser.add_argument("--rate", type=float, default=1000.0, metavar="HZ", help="frames a second (default 1000)")
    parser.add_argument("--bundle", type=files.bundle, metavar="FILE", help="bundle to run (default: the shipped one)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Measure and report."""
    if not 4 <= arguments.seconds < 1e6 or not 1 <= arguments.rate <= 1000:
        raise UsageError("--seconds must be at least 4, and --rate 1 to 1000")
    show(arguments, measure(arguments.seconds, arguments.rate, arguments.bundle))
    return 0


def measure(seconds: float, rate_hz: float, bundle: Path | None) -> dict[str, Any]:
    """Return what a stream took.

    Args:
        seconds: Of streaming.
        rate_hz: Frames a second.
        bundle: To run; None for the shipped one.
    """
    from eitskin_tools.processes.children import Child, process_group

    print(f"memory: {seconds:g} s at {rate_hz:g} frames/s", file=sys.stderr)
    with tempfile.TemporaryDirectory(prefix="eitskin-memory-") as name, process_group() as children:
        folder = Path(name)
        publish = f"ipc://{folder}/frames"
        skin = Child("virtual-skin", "eitskin_tools.cli", ["virtual-skin", "--json", f"--rate={rate_hz:g}"], folder)
        children.append(skin)
        port = json.loads(skin.line(skin.out, "{", 2 * READY_TIMEOUT_S))["port"]
        named = ["--bundle", str(bundle)] if bundle else []
        runtime = Child(
            "run", "eitskin_tools.cli",
            ["run", f"--port={port}", f"--publish={publish}", f"--control=ipc://{folder}/control", "--json", *named],
            folder,
        )  # fmt: skip
        children.append(runtime)
        runtime.line(runtime.err, "ready ", READY_TIMEOUT_S, children)
        taker = Child(
            "subscriber", "eitskin_tools.cli", ["subscribe", publish, "--mode=all", "--json", "--timeout-s=60"], folder
        )
        children.append(taker)
        samples = _watch(runtime.pid, seconds, children)
        runtime.stop()
        spoken = json.loads(runtime.out.read_text())
    found = summary(samples)
    found |= {key: spoken[key] for key in ("frames", "lost", "withheld", "cpu_us_per_frame")}
    per_frame = found["mb_per_hour"] * 2**20 / 3600 / max(spoken["rate_hz"], 1.0)
    return {**found, "bytes_per_frame": round(per_frame, 3), "seconds": seconds, "rate_hz": spoken["rate_hz"]}


def _watch(pid: int, seconds: float, children: list[Any]) -> list[dict[str, float]]:
    samples = []
    start = time.monotonic()
    while (elapsed := time.monotonic() - start) < seconds:
        for child in children:
            child.check()
        samples.append({"time_s": elapsed, **memory_of(pid)})
        time.sleep(1.0)
    return samples


def memory_of(pid: int) -> dict[str, float]:
    """Return a process's resident memory in MB, its threads and its open files."""
    fields = dict(line.split(":", 1) for line in Path(f"/proc/{pid}/status").read_text().splitlines())
    return {
        "rss_mb": int(fields["VmRSS"].split()[0]) / 1024,
        "threads": int(fields["Threads"]),
        "files": len(list(Path(f"/proc/{pid}/fd").iterdir())),
    }


def summary(samples: list[dict[str, float]]) -> dict[str, Any]:
    """Return what samples say after settling.

    Args:
        samples: One a second: time_s and what :func:`look` returns.
    """
    import numpy as np

    kept = samples[int(SETTLING_SHARE * len(samples)) :]
    times, rss = (np.array([sample[key] for sample in kept]) for key in ("time_s", "rss_mb"))
    slope = float(np.polyfit(times, rss, 1)[0]) if len(kept) > 2 else 0.0
    return {
        "rss_mb": {"first": round(rss[0], 2), "last": round(rss[-1], 2), "max": round(float(rss.max()), 2)},
        "mb_per_hour": round(3600 * slope, 3),
        "threads": sorted({int(sample["threads"]) for sample in kept}),
        "files": sorted({int(sample["files"]) for sample in kept}),
        "samples": len(samples),
    }


if __name__ == "__main__":
    sys.exit(program(__doc__, add_arguments, run))
