"""Faint presses that a bundle's gate finds on sheets that are solved, and what could be found.

Devices and bends are drawn from the bundle's own skin, others than its gate has seen; each is pressed anywhere by discs
of 16 mm, under N2 of 52 dB, after a drift common to all rows. A press counts as found if one of five frames trips the
gate as the runtime has it, which remembers the frames before ::

    found            the sheet lay there untouched for a second before
    moving           it is on its way to another bend, which takes a second; the press comes on halfway
    first_frames     nothing was seen before: these are the first frames after the start
    held             share of touched frames while the press stays and a session's drift, even and uneven, comes over it
    false_alarms     share of touched frames of the untouched sheet: at rest, moving, and at rest at the other bend

What lies between two solved bends is a mean of logarithms, and a press on the way changes the logarithms as it does at
the first bend. Beside it stands what an ideal observer has, as the bundle's card states it: d', and the share of
presses of 50 mm2 that it would find at the gate's own rate of false alarms.
"""

import argparse
import math
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from eitskin_tools.bench.harness import program, show
from eitskin_tools.errors import UsageError
from eitskin_tools.processes.threads import one_blas_thread

DRIFT: Final = 0.01
"""Standard deviation of the logarithm of the common factor."""

UNTOUCHED_FRAMES: Final = 200
"""Untouched frames before a press, and of a bend that is on its way: a second at 200 frames/s."""

HELD_FRAMES: Final = 2000
"""Frames that a press stays."""

SEED: Final = 88_107

STRENGTH_RATIOS: Final = (1.0, 2.0)
"""Of presses, over the one that is asked for."""

MEASURED_SHARES: Final = ("found", "moving", "first_frames", "held")
"""Measured shares of presses."""


@dataclass(frozen=True, slots=True)
class UntouchedDevice:
    """A device at a bend with nothing on it, as log(V / V0)."""

    rest: Any
    """(104,) as it lies."""
    uneven: Any
    """(104,) the same after a session's uneven drift."""
    walk: Any
    """(UNTOUCHED_FRAMES, 104) on its way to another bend."""

    @property
    def still(self) -> Any:
        """(UNTOUCHED_FRAMES, 104) at rest."""
        return self.rest[None].repeat(UNTOUCHED_FRAMES, axis=0)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--bundle", default="press", metavar="FILE", help="a file, or a shipped one (default press)")
    parser.add_argument("--sheets", type=int, default=60, metavar="N", help="devices, each at a bend (default 60)")
    parser.add_argument("--presses", type=int, default=3, metavar="N", help="places on each of them (default 3)")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="names the draws (default 0)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Measure and report."""
    one_blas_thread()  # on a busy machine a second one costs as much again
    from eitskin.model.bundle import load_bundle
    from eitskin_tools.command_line import files

    if min(arguments.sheets, arguments.presses) < 1 or arguments.seed < 0:
        raise UsageError("--sheets and --presses must be at least 1, --seed at least 0")
    bundle = load_bundle(files.find(arguments.bundle, files.BUNDLE))
    if bundle.gate_arrays() is None:
        raise UsageError(f"{bundle.path} has no gate: train it with one, see 'eitskin train --help'")
    found = measured(bundle, arguments.sheets, arguments.presses, arguments.seed)
    found["ideal_observer"] = bundle.manifest["gate"].get("ideal_observer")
    show(arguments, found)
    return 0


def measured(bundle: Any, sheets: int, presses: int, seed: int) -> dict[str, Any]:
    """Return what the gate finds, and how often it is wrong about untouched sheets.

    Args:
        bundle: With a gate.
        sheets: Devices, each at a bend.
        presses: Places on each of them.
        seed: Names the draws.
    """
    import numpy as np

    from eitskin.model.gate import RememberingGate
    from eitskin_sim.devices.draws import draw_device, draw_moment
    from eitskin_sim.devices.readings import FINE_MM, readings
    from eitskin_sim.fem.solve import factorise_scene
    from eitskin_sim.scene.family import draw
    from eitskin_sim.scene.parts import Scene, Touch
    from eitskin_sim.scene.shapes import Disc
    from eitskin_training.gate.observer import FRAMES_TO_FIND_A_PRESS, SNR_DB
    from eitskin_training.gate.presses import BORDER_MM, DIAMETER_MM, STRENGTH_MM2, contrast_of

    skin, rng = bundle.skin, np.random.default_rng([SEED, seed])
    noise, arrays = 10.0 ** (-SNR_DB / 20.0), bundle.gate_arrays()
    bends = draw("A", 2 * sheets, SEED + seed, skin)
    half = DIAMETER_MM / 2.0
    strengths = {f"{STRENGTH_MM2 * one:g}": STRENGTH_MM2 * one for one in STRENGTH_RATIOS}
    kept: dict[str, dict[str, list[float]]] = {name: {key: [] for key in strengths} for name in MEASURED_SHARES}
    alarms: list[float] = []

    def frames(logs: Any) -> Any:
        """Return (n, 104) dV of (n, 104) log(V / V0), under noise and one drift."""
        drift = DRIFT * rng.standard_normal()
        return np.exp(logs + drift) * (1.0 + noise * rng.standard_normal(logs.shape)) - 1.0

    for number in range(sheets):
        one = draw_device(skin, rng)
        device = one.device
        here, there = (one.bent(bends[2 * number + n]) for n in range(2))
        later, last = (device.since(draw_moment(skin, rng).late) for _ in range(2))

        def read(device: Any, bend: Any, touches: Any = ()) -> Any:
            scene = Scene(device.sheet, device.electrodes, bend, touches, element_size_mm=FINE_MM)
            return readings(device, factorise_scene(scene).differences())

        reference = read(device, one.reference_bend)
        rest = np.log(read(later, here) / reference)
        way = np.log(read(later, there) / reference) - rest
        uneven = np.log(read(last, here) / reference)
        lying = UntouchedDevice(rest, uneven, rest + np.linspace(0.0, 1.0, UNTOUCHED_FRAMES)[:, None] * way)
        untouched = np.concatenate([lying.still, lying.walk, np.tile(lying.walk[-1], (UNTOUCHED_FRAMES, 1))])
        alarms.append(float(np.mean(judged(RememberingGate(arrays), frames(untouched)))))
        for _ in range(presses):
            x, y = (rng.uniform(half, side - half) for side in skin.outline.size_mm)
            for name, strength in strengths.items():
                touch = Touch((Disc(x, y, half),), contrast=contrast_of(strength, DIAMETER_MM), border_mm=BORDER_MM)
                press = np.log(read(later, here, (touch,)) / reference) - rest
                for key, seen in of_press(press, lying, arrays, frames, rng).items():
                    kept[key][name].append(seen)
        if sys.stderr.isatty():
            print(f"\r{number + 1} of {sheets} ", end="" if number + 1 < sheets else "\n", file=sys.stderr, flush=True)
    return {
        "bundle": bundle.id,
        "sheets": sheets,
        "frames": FRAMES_TO_FIND_A_PRESS,
        "snr_db": SNR_DB,
        "drift": DRIFT,
        "diameter_mm": DIAMETER_MM,
        **{name: {key: share(one, presses) for key, one in by.items()} for name, by in kept.items()},
        "false_alarms": share(alarms, 1),
    }


def of_press(
    press: Any, lying: UntouchedDevice, arrays: Any, frames: Callable[[Any], Any], rng: Any
) -> dict[str, float]:
    """Return by the names of ``MEASURED_SHARES`` whether one press is seen, or how often.

    Args:
        press: (104,) what it adds to log(V / V0).
        lying: The sheet that is pressed.
        arrays: Of the gate.
        frames: Gives (n, 104) dV as it is read of (n, 104) log(V / V0).
        rng: Of the drift while the press stays.
    """
    import numpy as np

    from eitskin.model.gate import RememberingGate
    from eitskin_training.gate.observer import FRAMES_TO_FIND_A_PRESS

    still, pressed = lying.still, lying.still[:FRAMES_TO_FIND_A_PRESS] + press
    at_first = judged(RememberingGate(arrays), frames(pressed))
    gate = RememberingGate(arrays)
    found = judged(gate, frames(np.concatenate([still, pressed])))[UNTOUCHED_FRAMES:]
    ends = np.linspace(0.0, 1.0, HELD_FRAMES)[:, None]
    drift = DRIFT * ends * rng.standard_normal() + ends * (lying.uneven - lying.rest)
    held = judged(gate, frames(lying.rest + drift + press))
    half_way = lying.walk[UNTOUCHED_FRAMES // 2 :][:FRAMES_TO_FIND_A_PRESS] + press
    moving = judged(
        RememberingGate(arrays), frames(np.concatenate([still, lying.walk[: UNTOUCHED_FRAMES // 2], half_way]))
    )
    return {
        "found": any(found),
        "moving": any(moving[-FRAMES_TO_FIND_A_PRESS:]),
        "first_frames": any(at_first),
        "held": float(np.mean(held)),
    }


def judged(gate: Any, changes: Any) -> list[bool]:
    """Return what a gate says of (n, 104) dV, one after the other.

    Args:
        gate: Remembers the frames before.
        changes: dV.
    """
    found = []
    for change in changes:
        gate.change[:] = change
        found.append(gate.touched())
    return found


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


if __name__ == "__main__":
    sys.exit(program(__doc__, add_arguments, run))
