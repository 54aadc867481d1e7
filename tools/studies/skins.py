"""What a skin takes of a core, untouched and touched, and how many skins lose no frame.

Virtual skins, ``eitskin run --config`` with 1, 2, 4, ... of them, and one subscriber that takes every frame of all by
``subscribe_all``. Untouched frames are judged by the gate; touched ones are all computed (``every_map``), the most that
a skin can cost. Per count the two follow each other, so that a busy machine is busy for both.

CPU time is read from /proc, each process by itself. The virtual skins need cores too, about as much as the runtimes,
which a robot's own electronics do not take: frames that are lost here would be lost later there. What other programs
took meanwhile is said in each row; where that is much, frames are lost by them, and not by the number of skins.
"""

import argparse
import json
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Final

from eitskin_tools.bench.harness import busy_s, cpu_s, program, report
from eitskin_tools.errors import UsageError

SCENES: Final[dict[str, dict[str, Any]]] = {
    "untouched": {"touches": [], "current_A": 0.001, "element_size_mm": 3.0},
    "touched": {
        "touches": [{"disc_mm": [45.0, 35.0, 8.0], "conductivity_S_per_m": 50}],
        "current_A": 0.001,
        "element_size_mm": 3.0,
    },
}
"""What the virtual skins hold: flat, with nothing and with one touch."""

READY_TIMEOUT_S: Final = 120.0
"""How long the processes may take to be ready, on a busy machine."""

WARM_S: Final = 1.0
"""Of the stream before anything is counted."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--counts", default="1,2,4", metavar="N,N", help="how many skins (default 1,2,4)")
    parser.add_argument("--seconds", type=float, default=10.0, metavar="S", help="of each stream (default 10)")
    parser.add_argument("--rate", type=float, default=200.0, metavar="HZ", help="frames a second of each (default 200)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Measure and report."""
    parts = arguments.counts.split(",")
    if not all(part.isdecimal() and 1 <= int(part) <= 32 for part in parts):
        raise UsageError(f"--counts is {arguments.counts!r}, expected numbers from 1 to 32 such as 1,2,4")
    if not 1 <= arguments.seconds < 1e5 or not 1 <= arguments.rate <= 1000:
        raise UsageError("--seconds must be at least 1 and --rate 1 to 1000")
    rows = measure([int(part) for part in parts], arguments.seconds, arguments.rate)
    return report(arguments, rows, summary(rows), cores=len(os.sched_getaffinity(0)))


def measure(counts: list[int], seconds: float, rate_hz: float) -> list[dict[str, Any]]:
    """Return a row for each count and scene.

    Args:
        counts: How many skins.
        seconds: Of each stream.
        rate_hz: Frames a second of each skin.
    """
    from eitskin_tools.processes.children import process_group

    rows = []
    with tempfile.TemporaryDirectory(prefix="eitskin-skins-") as name, process_group() as children:
        folder = Path(name)
        ports = {kind: _virtual(kind, max(counts), rate_hz, folder, children) for kind in SCENES}
        words = ["reference", f"--port={ports['untouched'][0][0]}", f"--out={folder}/flat.json"]
        _finished(words, folder)
        for count in counts:
            for kind in SCENES:
                print(f"skins: {count} {kind}", file=sys.stderr)
                rows.append(_one(kind, ports[kind][:count], seconds, folder, children))
    return rows


def _virtual(kind: str, count: int, rate_hz: float, folder: Path, children: list[Any]) -> list[tuple[str, int]]:
    """Start virtual skins, one after the other, and return their ports and process ids."""
    from eitskin_tools.processes.children import Child

    scene = folder / f"{kind}.json"
    scene.write_text(json.dumps(SCENES[kind]))
    found = []
    for number in range(count):
        words = ["virtual-skin", "--json", f"--rate={rate_hz:g}", f"--scene={scene}", f"--seed={number}"]
        skin = Child(f"{kind}-{number}", "eitskin_tools.cli", words, folder)
        children.append(skin)
        found.append((json.loads(skin.line(skin.out, "{", READY_TIMEOUT_S))["port"], skin.pid))
    return found


def _finished(words: list[str], folder: Path) -> None:
    from eitskin_tools.processes.children import Child, ChildDiedError

    child = Child(words[0], "eitskin_tools.cli", words, folder)
    if child.wait(READY_TIMEOUT_S) != 0:
        child.stop()
        raise ChildDiedError(f"{words[0]}: {child.last_words()}")


def _one(kind: str, skins: list[tuple[str, int]], seconds: float, folder: Path, children: list[Any]) -> dict[str, Any]:
    """Run some skins, take all their frames for a while, and return what that took and what was lost."""
    from eitskin.robot.all_frames import subscribe_all
    from eitskin.robot.described import read_states
    from eitskin_tools.processes.children import Child

    text = f'format = "eitskin-robot"\nversion = 1\nfolder = "{folder}/run"\n'
    for number, (port, _) in enumerate(skins):
        text += f'[[skins]]\nname = "s{number}"\nport = "{port}"\nreference = "flat.json"\n'
        text += "every_map = true\n" if kind == "touched" else ""
    (folder / "robot.toml").write_text(text)
    robot = Child("run", "eitskin_tools.cli", ["run", f"--config={folder}/robot.toml"], folder)
    children.append(robot)
    robot.line(robot.err, f"ready {len(skins)} of ", READY_TIMEOUT_S, children)
    runtimes = [one.pid for one in read_states(folder / "run")]
    with subscribe_all(folder / "run", "all", timeout_s=READY_TIMEOUT_S) as frames:
        _take(frames, WARM_S)
        counts = _take(frames, 0.0)
        received, missed, start_s = dict(frames.received), dict(frames.lost), time.monotonic()
        begin = (cpu_s(runtimes), cpu_s([pid for _, pid in skins]), cpu_s([robot.pid]), time.process_time(), busy_s())
        ended = _take(frames, seconds)
        elapsed_s = time.monotonic() - start_s
        end = (cpu_s(runtimes), cpu_s([pid for _, pid in skins]), cpu_s([robot.pid]), time.process_time(), busy_s())
        taken = [frames.received[name] - count for name, count in received.items()]
        behind = sum(frames.lost[name] - count for name, count in missed.items())
    children.remove(robot)
    robot.stop()
    spent = [after - before for before, after in zip(begin, end, strict=True)]
    lost = sum(ended[name].counts["lost"] - counts[name].counts["lost"] for name in ended)
    withheld = sum(ended[name].counts["withheld"] - counts[name].counts["withheld"] for name in ended)
    return {
        "what": kind, "skins": len(skins), "frames": sum(taken), "slowest_hz": round(min(taken) / elapsed_s, 1),
        "lost": lost, "withheld": withheld, "not_taken": behind,
        "core_percent_a_skin": round(100 * spent[0] / elapsed_s / len(skins), 2),
        "cpu_us_a_frame": round(1e6 * spent[0] / max(sum(taken), 1)),
        "virtual_core_percent_a_skin": round(100 * spent[1] / elapsed_s / len(skins), 2),
        "supervisor_core_percent": round(100 * spent[2] / elapsed_s, 2),
        "subscriber_core_percent": round(100 * spent[3] / elapsed_s, 2),
        "others_core_percent": round(100 * max(0.0, spent[4] - sum(spent[:4])) / elapsed_s),
    }  # fmt: skip


def _take(frames: Any, seconds: float) -> dict[str, Any]:
    """Take frames for so long, and until each skin has sent one; return the last of each."""
    last: dict[str, Any] = {}
    until_s = time.monotonic() + seconds
    while time.monotonic() < until_s or len(last) < len(frames.skins):
        one = next(frames)
        last[one.skin] = one.frame
    return last


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return medians over all rows, touched against untouched, and the most skins of which no frame was ever lost."""
    import numpy as np

    found: dict[str, Any] = {}
    for kind in SCENES:
        own = [row for row in rows if row["what"] == kind]
        found[f"{kind}_cpu_us_a_frame"] = int(np.median([row["cpu_us_a_frame"] for row in own]))
        lossy = {row["skins"] for row in own if row["lost"] + row["withheld"] + row["not_taken"]}
        clean = [row["skins"] for row in own if row["skins"] not in lossy]
        below = [count for count in clean if all(count < other for other in lossy)]
        found[f"{kind}_most_without_loss"] = max(below, default=0)
    found["touched_to_untouched"] = round(
        found["touched_cpu_us_a_frame"] / max(found["untouched_cpu_us_a_frame"], 1), 2
    )
    return found


if __name__ == "__main__":
    sys.exit(program(__doc__, add_arguments, run))
