"""How much nearer a taught sheet places a press that rests, with the noise of a gelatin sheet.

The simulated sheet of docs/examples/press.json is taught single readings. Their noise is that of a gelatin sheet:
rows differ, five components have much of it, and all rows drift together. Then other presses rest, each after
untouched frames. Printed is the error of the first frame, and of the mean after some frames.
"""

import argparse
import sys
from typing import Any, Final

from taught_shapes import SCENE, presses  # type: ignore[import-not-found]  # beside this script

from eitskin_tools.bench.harness import program, report

SIGNAL: Final = 1.2
"""Median change of a row by a press, over the standard deviation of its noise."""

ROW_SPREAD: Final = 0.75
"""Standard deviation of its logarithm over rows."""

SHARED: Final = 0.44
"""Part of the variance that ``COMPONENTS`` have."""

COMPONENTS: Final = 5

DRIFT: Final = 0.39
"""Standard deviation of the change of all rows from one untouched reading to the next, over a row's median noise."""

BETWEEN: Final = 10_000
"""Frames between two of these readings, ten presses apart: 50 s."""

BEFORE: Final = 100
"""Untouched frames before each press, and those of the reference."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--presses", type=int, default=60, metavar="N", help="taught and tested presses (default 60)")
    parser.add_argument("--frames", type=int, default=50, metavar="N", help="frames of a press (default 50)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Teach, test and report."""
    import numpy as np

    from eitskin.model.taught import TaughtField
    from eitskin.reference.steadiness import steady_frames
    from eitskin_proto.sensor.noise_law import noise_of
    from eitskin_sim.scene.scene import load_scene
    from eitskin_tools.teach.teaching import teach_shapes

    scene, rng, frames = load_scene(SCENE), np.random.default_rng(3), arguments.frames
    taught, tested = (presses(scene, arguments.presses, seed=seed, noise=0.0) for seed in (0, 1000))
    median = np.median(np.abs(taught.readings[taught.pressed] / taught.readings[0] - 1.0)) / SIGNAL
    sd = median * np.exp(ROW_SPREAD * rng.standard_normal(104))
    mix = rng.standard_normal((COMPONENTS, 104))
    mix *= np.sqrt(SHARED / (mix**2).sum(axis=0)) * sd

    def noise(count: int) -> Any:
        own = np.sqrt(1.0 - SHARED) * sd * rng.standard_normal((count, 104))
        drift = DRIFT * median / np.sqrt(BETWEEN) * rng.standard_normal((count, 1)).cumsum(axis=0)
        return own + rng.standard_normal((count, COMPONENTS)) @ mix + drift

    taught.readings[:] *= np.exp(noise(len(taught.readings)))
    (found,) = teach_shapes({"flat": taught}, None, 0.01).values()
    rest = tested.readings[0] * np.exp(noise(BEFORE))
    spread, shared = noise_of(rest / rest.mean(axis=0) - 1.0)
    reference_V = rest.mean(axis=0)
    field = TaughtField([found.arrays], found.skin.grid)
    size = np.abs(reference_V)
    most = steady_frames(rest, spread * size)
    field.use_reference(reference_V, spread * size, shared * size[:, None], BEFORE, most)
    errors_mm, fused = [], []
    for reading, place_mm in zip(tested.readings[tested.pressed], tested.xy_mm[tested.pressed], strict=True):
        field.reset()
        ratio = np.vstack([np.tile(tested.readings[0], (BEFORE, 1)), np.tile(reading, (frames, 1))]) / reference_V
        for number, change in enumerate(ratio * np.exp(noise(len(ratio))) - 1.0):
            field.change[:] = change
            field.touched()
            if number in (BEFORE, len(ratio) - 1):
                touch = field.strongest()
                errors_mm.append(float(np.hypot(touch.x_mm - place_mm[0], touch.y_mm - place_mm[1])))
        fused.append(field.stillness.frames)
    errors = np.reshape(errors_mm, (-1, 2))
    rms = np.sqrt((errors**2).mean(axis=0))
    rows = [
        {"what": f"frames: {count}", "localisation_median_mm": median_mm, "localisation_rms_mm": rms_mm}
        for count, median_mm, rms_mm in zip((1, frames), np.median(errors, axis=0).tolist(), rms.tolist(), strict=True)
    ]
    rows[1]["fused_median"] = float(np.median(fused))
    return report(arguments, rows, {"presses": arguments.presses})


if __name__ == "__main__":
    sys.exit(program(__doc__, add_arguments, run))
