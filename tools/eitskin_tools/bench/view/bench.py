"""What the live page costs: the stream of 200 frames a second without a viewer, and with 0, 1 and 3 pages open.

Processes as in the demonstration: a virtual skin, the runtime, a subscriber that takes every frame, and the viewer. The
pages are readers of its stream in this process: no browser draws, so that the figures are the server's own. Cases take
turns, round by round. ``--file`` measures a recording instead: jumps to any second of it, and its memory.
"""

import argparse
import json
import sys
import tempfile
from pathlib import Path
from typing import Any, Final

from eitskin_tools.bench.skins.bench import cpu_s
from eitskin_tools.bench.view.pages import readers
from eitskin_tools.command_line import files
from eitskin_tools.demo.recorder import Record
from eitskin_tools.processes.children import Child, process_group

CASES: Final[dict[str, int | None]] = {"no viewer": None, "0 pages": 0, "1 page": 1, "3 pages": 3}
READY_S: Final = 120.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--seconds", type=float, default=20.0, metavar="S", help="of each case in a round (20)")
    parser.add_argument("--rounds", type=int, default=3, metavar="N", help="in which all cases take turns (3)")
    parser.add_argument("--rate", type=float, default=200.0, metavar="HZ", help="frames a second (200)")
    parser.add_argument("--file", type=Path, metavar="FILE.mcap", help="measure looking at this recording instead")
    parser.add_argument("--bundle", type=files.bundle, help="with --file: what computes its maps")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Measure, print, and return 0."""
    if arguments.file is not None:
        from eitskin_tools.bench.view.film import measured, printed

        one = measured(arguments.file, arguments.bundle)
        print(json.dumps(one) if arguments.json else printed(one))
        return 0
    found: dict[str, list[dict[str, Any]]] = {name: [] for name in CASES}
    for number in range(arguments.rounds):
        for name, pages in CASES.items():
            print(f"round {number + 1} of {arguments.rounds}: {name}", file=sys.stderr, flush=True)
            found[name].append(_measure(pages, arguments.seconds, arguments.rate))
    rows = [_summed(name, runs) for name, runs in found.items()]
    if arguments.json:
        print(json.dumps({"rows": rows, "summary": {"lost_by_subscriber": sum(r["lost_by_subscriber"] for r in rows)}}))
        return 0
    for row in rows:
        print(
            f"{row['case']:<10} {row['frames']} frames, {row['lost_by_subscriber']} lost by the subscriber, "
            f"{row['lost_on_the_wire']} on the wire; latency p50 {row['p50_ms']:.2f} ms, p99 {row['p99_ms']:.2f} ms; "
            f"viewer {row['viewer_cpu_percent']:.1f} % of a core, {row['pictures_per_page_s']:.1f} pictures/s a page"
        )
    return 0


def _summed(name: str, runs: list[dict[str, Any]]) -> dict[str, Any]:
    total = {key: sum(found[key] for found in runs) for key in ("frames", "lost_by_subscriber", "lost_on_the_wire")}
    means = ("p50_ms", "p99_ms", "viewer_cpu_percent", "pictures_per_page_s")
    return {"case": name, **total, **{key: sum(found[key] for found in runs) / len(runs) for key in means}}


def _measure(pages: int | None, seconds: float, rate_hz: float) -> dict[str, Any]:
    """Return what one case showed."""
    import numpy as np

    with tempfile.TemporaryDirectory(prefix="eitskin-view-") as name, process_group() as children:
        folder = Path(name)
        publish, record = f"ipc://{folder}/frames", folder / "record.npz"
        skin = _started(
            children, "virtual-skin", ["virtual-skin", "--json", f"--rate={rate_hz:g}", "--seconds=1000"], folder
        )
        port = json.loads(skin.line(skin.out, "{", READY_S))["port"]
        words = ["run", f"--port={port}", f"--publish={publish}", f"--control=ipc://{folder}/control", "--json"]
        runtime = _started(children, "run", words, folder)
        runtime.line(runtime.err, "ready ", READY_S, children)
        viewer, address = None, ""
        if pages is not None:
            words = ["view", f"--endpoint={publish}", "--port=0", "--no-open"]
            viewer = _started(children, "view", words, folder)
            address = viewer.line(viewer.out, "viewing ", READY_S, children).rpartition(" at ")[2].split()[0]
        with readers(address, pages or 0) as counts:
            capacity = int(seconds * rate_hz * 1.5) + 1000
            words = [publish, str(record), f"--seconds={seconds:g}", f"--capacity={capacity}"]
            taker = Child("subscriber", "eitskin_tools.demo.recorder", words, folder)
            children.append(taker)
            taker.line(taker.out, "first", READY_S, children)
            watched = [] if viewer is None else [viewer.pid]
            before_s, shown = cpu_s(watched), sum(counts)
            while taker.wait(1.0) is None:
                for child in children[:-1]:
                    child.check()
            used_s, shown = cpu_s(watched) - before_s, sum(counts) - shown
            if taker.status:
                taker.check()
        found = Record.load(record)
        latency_ms = (found.received_ns - found.host_ns[:, 0]) / 1e6
        return {
            "frames": len(found.sequence),
            "lost_by_subscriber": found.late,
            "lost_on_the_wire": int(found.sequence[-1] - found.sequence[0] + 1 - len(found.sequence)) - found.late,
            "p50_ms": float(np.quantile(latency_ms, 0.5)),
            "p99_ms": float(np.quantile(latency_ms, 0.99)),
            "viewer_cpu_percent": 100.0 * used_s / seconds,
            "pictures_per_page_s": shown / seconds / pages if pages else 0.0,
        }


def _started(children: list[Child], name: str, words: list[str], folder: Path) -> Child:
    child = Child(name, "eitskin_tools.cli", words, folder)
    children.append(child)
    return child
