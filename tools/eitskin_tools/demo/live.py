"""Drawing while the demonstration runs: the newest frame, fifteen times a second, and the truth beside it."""

import sys
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import eitskin
from eitskin_tools.demo.played import told
from eitskin_tools.pictures.draw import RATE_HZ, Painter


def live(publish: str, script: Any, start_us: int, going_on: Callable[[], bool]) -> None:
    """Draw until the demonstration is over.

    Args:
        publish: Endpoint of the frames.
        script: What the virtual skin plays.
        start_us: Device clock when the script began.
        going_on: Says whether to draw on.
    """
    begin = time.monotonic()
    with eitskin.subscribe(publish, timeout_s=0.5, patient=True) as frames, Painter(sys.stdout) as painter:
        while going_on():
            due = time.monotonic() + 1.0 / RATE_HZ
            with suppress(eitskin.NoFrame):
                frame = frames.next_frame()
                time_s = (frame.device_us - start_us) % (1 << 32) * 1e-6
                painter.show(_title(script, time_s), frame.map, script.truth_at(time_s), _footer(frame, begin))
            time.sleep(max(due - time.monotonic(), 0.0))


def _title(script: Any, time_s: float) -> str:
    scene = script.scene_at(time_s)
    bend, touches = scene.bend, len(scene.touches)
    turned = f"bent by {bend.angle_deg:.0f} deg, its axis at {bend.axis_deg:+.0f}"
    shape = "flat" if bend == type(bend)() else f"{turned}, stretched {100 * (bend.stretch_along - 1):.1f} %"
    number = f"{touches} {'press' if script.skin.touch_kind == 'lowering' else 'touch'}{'' if touches == 1 else 'es'}"
    return f"eitskin demo   {time_s:5.1f} s   the sheet is {shape}; {number}{told(script)}"


def _footer(frame: Any, begin: float) -> list[str]:
    skipped = f", skipped {', '.join(frame.skipped)}" if frame.skipped else ""
    return [
        f"frame {frame.sequence}, {'touched' if frame.touched else 'untouched'}, by {frame.solver}{skipped}, "
        f"cloud {frame.cloud}",
        f"last byte to here {frame.latency_s * 1e3:.2f} ms   lost {frame.counts['lost']}   "
        f"corrupt {frame.counts['corrupt']}   {time.monotonic() - begin:.0f} s   Ctrl-C ends",
    ]
