"""What the list of touches takes for a frame.

Maps of 1 to 6 discs of 10 mm with noise, another one each frame, as a runtime goes through them; paced at 5 ms, as a
robot sees them (caches have cooled), and back to back.
"""

import argparse
import sys
import time
from typing import Any, Final

from eitskin_tools.bench.harness import paced, program, report
from eitskin_tools.errors import UsageError

TOUCH_COUNTS: Final = (1, 3, 6)
"""Touches of the maps that are timed."""

DISC_MM: Final = 10.0
NOISE: Final = 0.1
"""Of the maps that are timed, cut off at 0 and 1."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--frames", type=int, default=1000, metavar="N", help="frames for each count (default 1000)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Measure and report."""
    if arguments.frames < 100:
        raise UsageError("--frames must be at least 100: percentiles need values")
    rows = [_timed(count, arguments.frames) for count in TOUCH_COUNTS]
    return report(arguments, rows, {"p50_us": max(row["p50_us"] for row in rows)})


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
    frame = iter(range(2 * frames))

    def update() -> None:
        number = next(frame)
        watch.update(maps[number % len(maps)], number, surface, 5000 * number)

    slow = paced({"touches": update}, frames)["touches"]
    fast = []
    for _ in range(frames):
        start = time.perf_counter_ns()
        update()
        fast.append(time.perf_counter_ns() - start)
    cool, warm = percentiles_us(slow), percentiles_us(np.array(fast))
    return {
        "what": f"time of {count} touches", "p50_us": cool["p50"], "p99_us": cool["p99"],
        "warm_p50_us": warm["p50"], "warm_p99_us": warm["p99"],
    }  # fmt: skip


if __name__ == "__main__":
    sys.exit(program(__doc__, add_arguments, run))
