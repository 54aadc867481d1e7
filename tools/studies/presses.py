"""Voltages for simulators: how fast and how exact they are, and whether the runtime finds the presses.

Random presses on a bent hydrogel skin, one and two at a time. The errors are those of dV, V over the untouched sheet's
less 1, against the same scene solved on its own fine mesh: rms over rows. Rates count CPU time of one core. Then the
runtime with the shipped bundle feels single presses of several depths, in frames with noise, each after a rest, and its
largest touch is compared with the truth.
"""

import argparse
import sys
import time
from collections.abc import Callable
from typing import Any, Final

import numpy as np
import numpy.typing as npt

import eitskin
from eitskin_proto.skin.toml import named
from eitskin_sim.fem.solve import solve_scene
from eitskin_sim.press import Press, Sheet
from eitskin_sim.scene.nominal import nominal_scene
from eitskin_sim.scene.parts import Bend, Touch
from eitskin_sim.scene.shapes import Disc
from eitskin_sim.surface.measured_cloud import measured_cloud
from eitskin_tools.bench.harness import program, report
from eitskin_tools.errors import UsageError

Array = npt.NDArray[np.float64]

BEND: Final = Bend(angle_deg=60.0, axis_deg=20.0)
NOISE: Final = 0.003
"""Of each reading, relative: 50 dB."""

RADII_MM: Final = (7.0, 10.0)
DEPTHS_MM: Final = ((4.0, 5.0), (5.0, 7.0), (7.0, 9.0), (9.0, 12.5))
ALL_MM: Final = (4.0, 12.5)

REST, HELD = 100, 5
"""Untouched frames before each press, half a second, and frames in which it is to be found."""

FOUND_MM: Final = 10.0
"""A press is found if the largest touch is nearer than this."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--presses", type=int, default=100, metavar="N", help="presses that are felt (default 100)")
    parser.add_argument("--fine", type=int, default=20, metavar="N", help="frames solved on a fine mesh (default 20)")
    parser.add_argument("--border", type=float, default=12.0, metavar="MM", help="from it to centres (default 12)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Measure and report."""
    if arguments.presses < 1 or arguments.fine < 1 or not 0.0 <= arguments.border <= 40.0:
        raise UsageError("--presses and --fine must be at least 1, and --border 0 to 40")
    skin, random = named("hydrogel"), np.random.default_rng(0)
    sheet = Sheet(skin, measured_cloud(BEND, skin=skin))
    rows: list[dict[str, Any]] = []
    for count in (1, 2):
        frames = [drawn(sheet, random, count, ALL_MM, arguments.border) for _ in range(arguments.fine)]
        rows += compared(sheet, frames)
    for low, high in DEPTHS_MM:
        presses = [drawn(sheet, random, 1, (low, high), arguments.border) for _ in range(arguments.presses)]
        rows.append({"what": f"{low:g} to {high:g} mm", **felt(sheet, presses, random)})
    return report(arguments, rows[:-1], rows[-1])


def drawn(
    sheet: Sheet, random: np.random.Generator, count: int, depths_mm: tuple[float, float], border_mm: float
) -> list[Press]:
    """Return presses of a frame; they may overlap."""
    x_mm, y_mm = ((border_mm, size_mm - border_mm) for size_mm in sheet.skin.outline.size_mm)
    low, high = np.array([x_mm, y_mm, RADII_MM, depths_mm]).T
    return [Press(*row) for row in random.uniform(low, high, (count, 4)).tolist()]


def compared(sheet: Sheet, frames: list[list[Press]]) -> list[dict[str, Any]]:
    """Return rates and errors of both ways."""
    truth = np.array([fine(sheet, frame) for frame in frames]) / fine(sheet, []) - 1.0
    many = frames * (-(-500 // len(frames)))
    ways: dict[str, Callable[[], Array]] = {
        "exact": lambda: np.array([sheet.voltages(frame) for frame in many]),
        "linear": lambda: sheet.linear_voltages(many),
    }
    rows = []
    for name, way in ways.items():
        way()
        began_s = time.process_time()
        volts = way()[: len(frames)]
        spent_s = time.process_time() - began_s
        off = np.linalg.norm(volts / sheet.untouched_V - 1.0 - truth, axis=1) / np.linalg.norm(truth, axis=1)
        rows.append(
            {
                "what": name,
                "presses": len(frames[0]),
                "frames_per_s": round(len(many) / spent_s),
                "error_median": round(float(np.median(off)), 4),
                "error_max": round(float(off.max()), 4),
            }
        )
    return rows


def fine(sheet: Sheet, frame: list[Press]) -> Array:
    """Return (104,) V of a frame, solved on its own fine mesh."""
    ratios = np.exp(sheet.law.log_ratio(np.array([press.depth_mm for press in frame])))
    touches = tuple(
        Touch((Disc(press.x_mm, press.y_mm, press.radius_mm),), contrast=ratio, border_mm=sheet.law.border_mm)
        for press, ratio in zip(frame, ratios.tolist(), strict=True)
    )
    return solve_scene(nominal_scene(sheet.skin, BEND, touches)).voltages


def felt(sheet: Sheet, frames: list[list[Press]], random: np.random.Generator) -> dict[str, Any]:
    """Return how many presses the runtime finds, and how far off."""

    def read(volts: Array) -> Array:
        return np.asarray(volts * (1.0 + NOISE * random.standard_normal(104)))

    off, false = [], 0
    reference = np.array([read(sheet.flat_V) for _ in range(50)])
    with eitskin.Skin(source=eitskin.Feed(), bundle="press", reference=reference) as skin:
        skin.set_cloud(sheet.cloud_mm, sheet.untouched_V, sheet.flat_V)
        for (press,) in frames:
            before = [skin.feed(read(sheet.untouched_V)) for _ in range(REST)]
            false += sum(bool(frame and frame.touches) for frame in before)
            pressed_V = sheet.voltages([press])
            held = [skin.feed(read(pressed_V)) for _ in range(HELD)]
            if seen := [frame.touches for frame in held if frame and frame.touches]:
                x, y = max(seen[0], key=lambda touch: touch.area_mm2).centre_mm
                off.append(float(np.hypot(x - press.x_mm, y - press.y_mm)))
    return {
        "presses": len(frames),
        "found": sum(one < FOUND_MM for one in off),
        "median_mm": round(float(np.median(off)), 2) if off else None,
        "largest_mm": round(max(off), 2) if off else None,
        "false_touches": false,
    }


if __name__ == "__main__":
    sys.exit(program(__doc__, add_arguments, run))
