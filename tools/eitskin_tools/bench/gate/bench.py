"""``eitskin bench gate``: faint presses that a bundle's gate finds on sheets that are solved, and what could be found.

Devices and bends are drawn from the bundle's own skin, others than its gate has seen; each is pressed anywhere by discs
of 16 mm, under N2 of 52 dB, after a drift common to all rows. A press counts as found if one of five frames
trips the gate. Beside it stands what an ideal observer has, as the bundle's card states it: d', and the share of
presses of 50 mm2 that it would find at the gate's own rate of false alarms.
"""

import argparse
import json
import math
import sys
from typing import Any, Final

from eitskin_tools.errors import UsageError

DRIFT: Final = 0.01
"""Standard deviation of the logarithm of the common factor."""

UNTOUCHED: Final = 20
"""Frames of each untouched sheet."""

SEED: Final = 88_107

STRENGTHS: Final = (1.0, 2.0)
"""Of presses, over the one that is asked for."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--bundle", default="press", metavar="FILE", help="a file, or a shipped one (default press)")
    parser.add_argument("--sheets", type=int, default=60, metavar="N", help="devices, each at a bend (default 60)")
    parser.add_argument("--presses", type=int, default=3, metavar="N", help="places on each of them (default 3)")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="names the draws (default 0)")
    parser.add_argument("--flat", action="store_true", help="the stated device, flat: nothing is unknown but drift")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Measure and report."""
    from eitskin.model.bundle import load_bundle
    from eitskin_tools.command_line import files

    if min(arguments.sheets, arguments.presses) < 1 or arguments.seed < 0:
        raise UsageError("--sheets and --presses must be at least 1, --seed at least 0")
    bundle = load_bundle(files.find(arguments.bundle, files.BUNDLE))
    if bundle.gate_arrays() is None:
        raise UsageError(f"{bundle.path} has no gate: train it with one, see 'eitskin train --help'")
    found = measured(bundle, arguments.sheets, arguments.presses, arguments.seed, flat=arguments.flat)
    found["ideal_observer"] = bundle.manifest["gate"].get("ideal_observer")
    if arguments.json:
        print(json.dumps(found))
    else:
        print("\n".join(lines(found)))
    return 0


def measured(bundle: Any, sheets: int, presses: int, seed: int, *, flat: bool) -> dict[str, Any]:
    """Return what the gate finds, and how often it is wrong about untouched sheets.

    Args:
        bundle: With a gate.
        sheets: Devices, each at a bend.
        presses: Places on each of them.
        seed: Names the draws.
        flat: The stated device alone, flat.
    """
    import numpy as np

    from eitskin_sim.devices.device import ideal
    from eitskin_sim.devices.draws import draw_device, draw_moment
    from eitskin_sim.devices.readings import FINE_MM, readings
    from eitskin_sim.fem.solve import factorise_scene
    from eitskin_sim.scene.family import draw
    from eitskin_sim.scene.parts import Bend, Scene, Touch
    from eitskin_sim.scene.shapes import Disc
    from eitskin_tools.evaluation.gate_judge import judge_of
    from eitskin_training.gate.observer import FRAMES, SNR_DB
    from eitskin_training.gate.presses import BORDER_MM, DIAMETER_MM, STRENGTH_MM2, contrast_of

    skin, rng = bundle.skin, np.random.default_rng([SEED, seed])
    noise = 10.0 ** (-SNR_DB / 20.0)
    bends = draw("A", sheets, SEED + seed, skin)
    half = DIAMETER_MM / 2.0
    hits: dict[str, list[bool]] = {f"{STRENGTH_MM2 * one:g}": [] for one in STRENGTHS}
    alarms = []
    for number, drawn in enumerate(bends):
        one = draw_device(skin, rng)
        device = ideal(skin) if flat else one.device
        bend = Bend() if flat else one.bent(drawn)
        later = device if flat else device.since(draw_moment(skin, rng).late)

        def read(device: Any, bend: Any, touches: Any = ()) -> Any:
            scene = Scene(device.sheet, device.electrodes, bend, touches, element_size_mm=FINE_MM)
            return readings(device, factorise_scene(scene).differences())

        def frames(volts: Any, count: int) -> Any:
            drift = math.exp(DRIFT * rng.standard_normal())
            return volts * drift * (1.0 + noise * rng.standard_normal((count, len(volts))))

        reference = read(device, Bend() if flat else one.reference_bend)
        judge = judge_of(bundle)
        alarms.append(float(np.mean([judge(frame, reference) for frame in frames(read(later, bend), UNTOUCHED)])))
        for _ in range(presses):
            x, y = (rng.uniform(half, side - half) for side in skin.outline.size_mm)
            for strength, kept in zip(STRENGTHS, hits.values(), strict=True):
                contrast = contrast_of(STRENGTH_MM2 * strength, DIAMETER_MM)
                touch = Touch((Disc(x, y, half),), contrast=contrast, border_mm=BORDER_MM)
                judge = judge_of(bundle)
                pressed = frames(read(later, bend, (touch,)), FRAMES)
                kept.append(any([judge(frame, reference) for frame in pressed]))
        if sys.stderr.isatty():
            print(f"\r{number + 1} of {sheets} ", end="" if number + 1 < sheets else "\n", file=sys.stderr, flush=True)
    return {
        "bundle": bundle.id,
        "sheets": sheets,
        "flat": flat,
        "frames": FRAMES,
        "snr_db": SNR_DB,
        "drift": DRIFT,
        "diameter_mm": DIAMETER_MM,
        "found": {name: share(kept, presses) for name, kept in hits.items()},
        "false_alarms": share(alarms, 1),
    }


def share(values: Any, each: int) -> dict[str, float]:
    """Return a mean and its standard error; values of one sheet come together.

    Args:
        values: One number, or truth, each.
        each: How many belong to one sheet.
    """
    import numpy as np

    by_sheet = np.array(values, dtype=np.float64).reshape(-1, each).mean(axis=1)
    error = float(by_sheet.std(ddof=1) / math.sqrt(len(by_sheet))) if len(by_sheet) > 1 else 0.0
    return {"share": float(by_sheet.mean()), "standard_error": error}


def lines(found: dict[str, Any]) -> list[str]:
    """Return what people read."""
    where = "the stated device, flat" if found["flat"] else f"{found['sheets']} devices and bends"
    shown = [f"{where}; {found['frames']} frames, N2 of {found['snr_db']:g} dB, drift of {found['drift']:.0%}"]
    for strength, one in found["found"].items():
        shown.append(f"presses of {strength} mm2: found {one['share']:.1%} +- {one['standard_error']:.1%}")
    alarms = found["false_alarms"]
    shown.append(f"untouched frames called touched: {alarms['share']:.2%} +- {alarms['standard_error']:.2%}")
    observer = found["ideal_observer"]
    if observer is None:
        return [*shown, "the bundle's card states no ideal observer"]
    for unknown, by in observer["d_prime"].items():
        five = by[str(found["frames"])]
        shown.append(
            f"ideal observer of {observer['strength_mm2']:g} mm2, {unknown} unknown: d' {five['median']:g} median, "
            f"{five['lowest_tenth']:g} at the worst tenth of places, in {found['frames']} frames; would find "
            f"{five['found']:.1%}"
        )
    return shown
