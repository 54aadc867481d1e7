"""The frame of all benchmarks: options, timing of variants in turn, and the report as rows and a summary.

A benchmark is a module of this folder with ``add_arguments(parser)`` and ``run(arguments) -> int``. Under ``--json`` it
prints one object with ``rows``, a list of flat objects, and ``summary``. A study in ``tools/studies`` has the same two
functions and runs by itself, through :func:`program`.
"""

import argparse
import json
import os
import platform
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from eitskin_proto.errors import SkinError
from eitskin_tools.command_line.parser import Parser
from eitskin_tools.errors import UsageError

Row = dict[str, Any]

PERIOD_S: Final = 0.005
"""Between two paced calls: a frame's period at 200 frames/s, in which caches and clocks cool as on a robot."""


def say(benchmark: str, text: str) -> None:
    """Tell people on stderr how far a benchmark is."""
    print(f"eitskin bench {benchmark}: {text}", file=sys.stderr, flush=True)


def row_text(row: Mapping[str, object]) -> str:
    """Return names and values in a line, lists left out; what was measured stands in front, if the row says ``what``.

    Args:
        row: One row, or a summary.
    """
    shown = {
        name: f"{value:.6g}" if isinstance(value, float) else value
        for name, value in row.items()
        if not isinstance(value, list)
    }
    figures = "  ".join(f"{name} {value}" for name, value in shown.items() if name != "what")
    return f"{row['what']}:  {figures}" if "what" in row else figures


def report(arguments: argparse.Namespace, rows: Iterable[Row], summary: Row, **more: Any) -> int:
    """Print rows and summary, as JSON where ``--json`` asks for it, and return 0.

    Args:
        arguments: Have ``json``.
        rows: Flat objects.
        summary: What they come to.
        more: Further keys of the JSON object.
    """
    if arguments.json:
        print(json.dumps({"rows": list(rows), "summary": summary, **more}))
    else:
        for row in [*rows, summary]:
            print(row_text(row))
    return 0


def paced(ways: Mapping[str, Callable[[], object]], calls: int) -> dict[str, Any]:
    """Return (calls,) ns that each way took, one call of one way a period, the ways in turn.

    Args:
        ways: By name.
        calls: Of each way.
    """
    spans: dict[str, list[int]] = {name: [] for name in ways}
    due = time.perf_counter()
    for _ in range(calls):
        for name, way in ways.items():
            due = max(due + PERIOD_S, time.perf_counter())
            time.sleep(max(due - time.perf_counter(), 0.0))
            start = time.perf_counter_ns()
            way()
            spans[name].append(time.perf_counter_ns() - start)
    return {name: np.array(span) for name, span in spans.items()}


def machine() -> Row:
    """Return what the figures were measured on."""
    model = "unknown"
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                model = line.partition(":")[2].strip()
                break
    except OSError:
        pass
    load = os.getloadavg()[0]
    return {"cpu": model, "cores": os.cpu_count(), "load_1min": round(load, 2), "python": platform.python_version()}


def cpu_s(pids: Iterable[int]) -> float:
    """Return the CPU seconds that processes have used, of all their threads."""
    ticks = 0
    for pid in pids:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        ticks += int(fields[11]) + int(fields[12])
    return ticks / os.sysconf("SC_CLK_TCK")


def busy_s() -> float:
    """Return the CPU seconds that all programs of this machine have used, and other machines have taken from it."""
    name, *ticks = Path("/proc/stat").read_text().splitlines()[0].split()
    assert name == "cpu"
    user, nice, system, _, _, interrupts, soft, stolen = map(int, ticks[:8])
    return (user + nice + system + interrupts + soft + stolen) / os.sysconf("SC_CLK_TCK")


def program(
    doc: str | None,
    add_arguments: Callable[[argparse.ArgumentParser], None],
    run: Callable[[argparse.Namespace], int],
    argv: list[str] | None = None,
) -> int:
    """Run a study from the command line; return 0, 1 if it failed and 2 if an option was wrong.

    Args:
        doc: Of its module; the first line describes it.
        add_arguments: Declares its options.
        run: Measures and reports.
        argv: Words; None for those of this process.
    """
    parser = Parser(description=(doc or "").splitlines()[0])
    add_arguments(parser)
    arguments = parser.parse_args(argv)
    try:
        return run(arguments)
    except (SkinError, ValueError, OSError, ImportError) as error:
        print(f"{parser.prog}: {' '.join(str(error).split())}", file=sys.stderr)
        return 2 if isinstance(error, UsageError) else 1
    except KeyboardInterrupt:
        return 130
