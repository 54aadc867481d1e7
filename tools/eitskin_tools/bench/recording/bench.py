"""What a recorder and a viewer cost the stream: the same stream with and without them, and whether the file is whole.

A stream of frames goes on all the while (:mod:`eitskin_tools.bench.recording.stream`). In each round it goes on by
itself for some seconds, and as long with ``eitskin record`` and ``eitskin view`` beside it; rounds begin with the one
and with the other in turn. The pages are readers in this process: no browser draws. When the stream has ended, the
files are computed once more by ``eitskin reinfer``.
"""

import argparse
import json
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any, Final

from eitskin_tools.errors import UsageError

CASES: Final = {False: "alone", True: "beside"}
"""Names of the parts without and with recorder and viewer."""

MOST_PAGES: Final = 16

REINFER_S: Final = 3600.0
"""How long a file may take to be computed again."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--seconds", type=float, default=60.0, metavar="S", help="of each part of a round (60)")
    parser.add_argument("--rounds", type=int, default=2, metavar="N", help="how often both take their turn (2)")
    parser.add_argument("--rate", type=float, default=200.0, metavar="HZ", help="frames a second (200)")
    parser.add_argument("--pages", type=int, default=1, metavar="N", help="that look at the viewer (1)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Measure, print, and return 0; 1 if a map came out as another one."""
    if not 1 <= arguments.seconds < 1e5 or not 10 <= arguments.rate <= 1000 or not 1 <= arguments.rounds <= 100:
        raise UsageError("--seconds must be at least 1, --rate 10 to 1000 and --rounds 1 to 100")
    if not 1 <= arguments.pages <= MOST_PAGES:
        raise UsageError(f"--pages is {arguments.pages}, expected 1 to {MOST_PAGES}")
    found = measure(arguments.seconds, arguments.rounds, arguments.rate, arguments.pages)
    if arguments.json:
        print(json.dumps(found))
    else:
        _print(found)
    return 1 if found["reinfer"]["differing"] else 0


def measure(seconds: float, rounds: int, rate_hz: float, pages: int) -> dict[str, Any]:
    """Return both cases, what their ratio is, and what the recordings are worth.

    Args:
        seconds: Of each part of a round.
        rounds: How often both take their turn.
        rate_hz: Frames a second.
        pages: That look at the viewer.
    """
    from eitskin_tools.bench.frame.bench import machine
    from eitskin_tools.bench.recording.stream import streamed

    order = [beside for number in range(rounds) for beside in ((True, False) if number % 2 else (False, True))]
    print(f"eitskin bench recording: {len(order)} parts of {seconds:g} s", file=sys.stderr, flush=True)
    with tempfile.TemporaryDirectory(prefix="eitskin-recording-") as name:
        folder = Path(name)
        stream = streamed(order, seconds, rate_hz, pages, folder)
        print(f"eitskin bench recording: {len(stream.files)} files are computed again", file=sys.stderr, flush=True)
        again = summed([_again(number, file, folder) for number, file in enumerate(stream.files)])
    cases = {name: case(stream, pages, beside=beside) for beside, name in CASES.items()}
    alone, beside = cases["alone"], cases["beside"]
    ratios = {
        name: round(beside["latency_us"][name] / alone["latency_us"][name], 3) for name in ("p50", "p99")
    }  # fmt: skip
    runtime = {key: stream.runtime[key] for key in ("frames", "lost", "corrupt", "withheld")}
    return {**cases, "ratios": ratios, "reinfer": again, "runtime": runtime, "rate_hz": rate_hz, "machine": machine()}


def case(stream: Any, pages: int, *, beside: bool) -> dict[str, Any]:
    """Return what all parts of one kind were like together.

    Args:
        stream: That has ended.
        pages: That looked at the viewer.
        beside: Those with recorder and viewer, or those without.
    """
    from eitskin_tools.bench.recording.stream import joined, part_of
    from eitskin_tools.demo.score import timing

    parts = [part for part in stream.parts if part.beside == beside]
    records = [part_of(stream, part) for part in parts]
    each = [timing(record, stream.wire_ns) for record in records]
    every = timing(joined(records, [slice(None)] * len(records)), stream.wire_ns)
    seconds, frames = sum(part.seconds for part in parts), every["frames"]
    cpu_s = {name: sum(part.cpu_s[name] for part in parts) for name in parts[0].cpu_s}
    found = {
        "seconds": round(seconds, 3),
        "frames": frames,
        "lost": sum(one["lost"] for one in each),
        "latency_us": every["latency_us"],
        "stages_us": every["stages_us"],
        "each_us": [{name: one["latency_us"][name] for name in ("p50", "p99")} for one in each],
        "runtime_cpu_us_a_frame": round(1e6 * cpu_s["run"] / frames, 1),
        "core_percent": {name: round(100.0 * used / seconds, 2) for name, used in cpu_s.items()},
    }
    if beside:
        total = {key: sum(part.recorder[key] for part in parts) for key in ("frames", "missed", "dropped", "bytes")}
        found["recorder"] = total
        found["pictures_a_page_s"] = round(sum(part.pictures for part in parts) / seconds / pages, 2)
    return found


def _again(number: int, file: Path, folder: Path) -> dict[str, Any]:
    """Return what ``eitskin reinfer`` says of a recording."""
    from eitskin_tools.processes.children import Child, ChildDiedError

    child = Child(f"reinfer-{number}", "eitskin_tools.cli", ["reinfer", str(file), "--json", "--quiet"], folder)
    try:
        if child.wait(REINFER_S) is None:
            raise TimeoutError(f"{file.name} was not computed again within {REINFER_S:g} s")
    finally:
        child.stop()
    text = child.out.read_text()
    if not text:
        raise ChildDiedError(f"{child.name} ended with status {child.status}: {child.last_words()}")
    found: dict[str, Any] = json.loads(text)
    return found


def summed(found: list[dict[str, Any]]) -> dict[str, Any]:
    """Return what several recordings came to."""
    total = {
        key: sum(one.get(key, 0) for one in found)
        for key in ("frames", "withheld", "published", "equal", "unknown", "recorded_s", "elapsed_s", "cpu_s")
    }
    return {
        **{key: round(value, 3) for key, value in total.items()},
        "unknown_why": dict(sum((Counter(one.get("unknown_why", {})) for one in found), Counter())),
        "differing": sum(sum(one.get("differing", {}).values()) for one in found),
        "times_real_time": round(total["recorded_s"] / total["elapsed_s"], 2),
        "times_real_time_cpu": round(total["recorded_s"] / total["cpu_s"], 2),
    }


def _print(found: dict[str, Any]) -> None:
    from eitskin_tools.recording.reinfer.tally import told_of_unknown

    for name in CASES.values():
        one = found[name]
        latency = "  ".join(f"{key} {value:.0f}" for key, value in one["latency_us"].items())
        stages = ", ".join(f"{key} {us['p50']:.0f}/{us['p99']:.0f}" for key, us in one["stages_us"].items() if us)
        print(f"{name}: {one['frames']} frames in {one['seconds']:.0f} s, {one['lost']} lost")
        print(f"  wire to subscriber, us: {latency}")
        print(f"  stages, us p50/p99: {stages}")
        print(f"  CPU of the runtime, us a frame: {one['runtime_cpu_us_a_frame']}; percent of a core: "
              + ", ".join(f"{key} {value:.1f}" for key, value in one["core_percent"].items()))  # fmt: skip
    kept, again = found["beside"]["recorder"], found["reinfer"]
    print(f"ratio with recorder and viewer beside: p50 {found['ratios']['p50']}, p99 {found['ratios']['p99']}")
    print(f"recorded {kept['frames']} frames, {kept['missed']} missed, {kept['bytes'] / 1e6:.1f} MB; "
          f"{found['beside']['pictures_a_page_s']} pictures/s a page")  # fmt: skip
    print(f"computed again: {again['equal']} of {again['published']} published maps bit-equal"
          f"{told_of_unknown(again)}; {again['times_real_time']} times real time, {again['times_real_time_cpu']} by "
          "CPU time")  # fmt: skip
