"""What the list of touches takes for a frame, and how far off it is with a shipped network.

Time: maps of 1 to 6 discs of 10 mm with noise, another one each frame, as a runtime goes through them; paced at 5 ms,
as a robot sees them (caches have cooled), and back to back. Accuracy: the trials of ``eitskin evaluate --single 10``,
one hard square touch on bent sheets, and those of ``--pair 10``; a pair is told apart if two touches are listed, each
within 5 mm of its own.
"""

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any, Final

from eitskin_tools.bench.harness import program, row_text
from eitskin_tools.command_line import files
from eitskin_tools.errors import UsageError

TOUCH_COUNTS: Final = (1, 3, 6)
"""Touches of the maps that are timed."""

DISC_MM: Final = 10.0
NOISE: Final = 0.1
"""Of the maps that are timed, cut off at 0 and 1."""

APART_MM: Final = 5.0
"""How near a touch of a pair must lie."""

PERIOD_S: Final = 0.005


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--frames", type=int, default=1000, metavar="N", help="frames for each count (default 1000)")
    parser.add_argument(
        "--deformations", type=int, default=20, metavar="N", help="bent sheets (default 20; 0: no trials)"
    )
    parser.add_argument("--each", type=int, default=5, metavar="N", help="touches at each deformation (default 5)")
    parser.add_argument(
        "--bundle", type=files.bundle, metavar="FILE", help="the network (default: the shipped one for areas)"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Measure and report."""
    if arguments.frames < 100 or arguments.deformations < 0 or arguments.each < 1:
        raise UsageError("--frames must be at least 100, --deformations at least 0 and --each at least 1")
    rows = [_timed(count, arguments.frames) for count in TOUCH_COUNTS]
    if arguments.deformations:
        rows += _trials(arguments.bundle, arguments.deformations, arguments.each)
    summary = {"p50_us": max(row["p50_us"] for row in rows[: len(TOUCH_COUNTS)])}
    if arguments.deformations:
        summary["centre_rms_mm"] = rows[len(TOUCH_COUNTS)]["centre_rms_mm"]
    if arguments.json:
        print(json.dumps({"rows": rows, "summary": summary}))
    else:
        for row in rows:
            print(row_text(row))
    return 0


def _timed(count: int, frames: int) -> dict[str, Any]:
    import numpy as np

    from eitskin.touches.surface import Surface
    from eitskin.touches.watch import TouchWatch
    from eitskin_proto.skin.skin import PAPER
    from eitskin_tools.demo.score import percentiles_us

    grid = PAPER.grid
    rng = np.random.default_rng(count)
    centres = grid.pixel_centres_mm()
    places = [(25.0 + 50.0 * (index % 3), 25.0 + 50.0 * (index // 3)) for index in range(count)]
    maps = []
    for _ in range(50):
        image = np.zeros(grid.shape)
        for place in places:
            far = np.linalg.norm(centres - (place + rng.uniform(-5, 5, 2)), axis=-1)
            image += np.clip((DISC_MM / 2 - far) / grid.pitch_mm + 0.5, 0.0, 1.0)
        maps.append(np.clip(image + NOISE * rng.standard_normal(grid.shape), 0, 1).astype(np.float32).ravel())
    watch, surface = TouchWatch(grid), Surface(grid.flat_cloud_mm(), grid)
    spans: dict[str, list[int]] = {"paced": [], "warm": []}
    due = time.perf_counter()
    for kind, found in spans.items():
        for frame in range(frames):
            if kind == "paced":
                due = max(due + PERIOD_S, time.perf_counter())
                time.sleep(max(due - time.perf_counter(), 0.0))
            values = maps[frame % len(maps)]
            start = time.perf_counter_ns()
            watch.update(values, (kind, frame), surface, 5000 * frame)
            found.append(time.perf_counter_ns() - start)
    paced, warm = (percentiles_us(np.array(spans[kind])) for kind in ("paced", "warm"))
    return {
        "what": f"time of {count} touches", "p50_us": paced["p50"], "p99_us": paced["p99"],
        "warm_p50_us": warm["p50"], "warm_p99_us": warm["p99"],
    }  # fmt: skip


def _trials(bundle: Path | None, deformations: int, each: int) -> list[dict[str, Any]]:
    """Return how far off a single touch is, and how many pairs are told apart."""
    import numpy as np

    from eitskin.touches.moments import TouchFinder
    from eitskin_proto.skin.skin import PAPER
    from eitskin_sim.evaluation import trials
    from eitskin_sim.evaluation.harness import Case, Conditions, Run, evaluate_all
    from eitskin_tools.evaluation.solvers import Request, named

    finder = TouchFinder(PAPER.grid)
    solver = named(Request("vd2t", bundle=None if bundle is None else str(bundle)), "area", PAPER)
    lists: list[Any] = []

    def solve(case: Case) -> Any:
        image = solver.run.solver(case)
        lists.append(finder.find(image).numbers)
        return image

    def listed(phantoms: list[Any]) -> list[tuple[Any, Any]]:
        lists.clear()
        evaluate_all(phantoms, [Run(solve, solver.run.reference)], Conditions())
        places = [np.array([_middle(touch) for touch in phantom.scene.touches]) for phantom in phantoms]
        return list(zip(places, lists, strict=True))

    single = listed(trials.single(10.0, deformations, each))
    off = np.array([np.linalg.norm(found[:2].T - true[0], axis=1).min() for true, found in single if found.size])
    areas = np.array([found[5, 0] for _, found in single if found.shape[1] == 1])
    rows: list[dict[str, Any]] = [
        {
            "what": "single 10 mm", "touches": len(single), "listed_once": int(areas.size),
            "centre_rms_mm": round(float(np.sqrt(np.mean(off**2))), 3),
            "centre_median_mm": round(float(np.median(off)), 3),
            "area_median_mm2": round(float(np.median(areas)), 1), "true_area_mm2": 100.0, "bundle": solver.bundle_id,
        }
    ]  # fmt: skip
    pairs = listed(trials.pair(10.0, deformations, each))
    apart = sum(_apart(true, found) for true, found in pairs)
    rows.append({"what": "pairs 10 mm apart", "pairs": len(pairs), "told_apart": apart})
    return rows


def _middle(touch: Any) -> tuple[float, float]:
    """Return the middle of a trial's square."""
    (shape,) = touch.shapes
    x0, y0, x1, y1 = shape.bounds_mm
    return (x0 + x1) / 2, (y0 + y1) / 2


def _apart(true: Any, found: Any) -> bool:
    import numpy as np

    if found.shape[1] != 2:
        return False
    distance = np.linalg.norm(true[:, None] - found[:2].T[None], axis=-1)
    return bool(max(distance[0, 0], distance[1, 1]) <= APART_MM or max(distance[0, 1], distance[1, 0]) <= APART_MM)


if __name__ == "__main__":
    sys.exit(program(__doc__, add_arguments, run))
