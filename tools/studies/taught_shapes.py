"""How well presses are placed in shapes of the sheet in which it was taught, and in which it was not.

The simulated sheet of docs/examples/press.json, flat and rolled, and stretched as it is rolled. Presses are taught in
one or several shapes, and others tested in each. Readings are single, with noise, and the reference is the flat sheet.
V_pred is of the nominal sheet at the exact bend.
"""

import argparse
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from eitskin_tools.bench.harness import program, report
from eitskin_tools.errors import UsageError

SCENE: Final = Path(__file__).parents[2] / "docs/examples/press.json"

ANGLES_DEG: Final = (0, 60, 90, 120)
"""In which it is tested."""

TAUGHT_DEG: Final = ((0,), (0, 60, 120))
"""In which it is taught."""

STRETCH: Final = 0.18
"""Of its length, when it is rolled by 180 degrees; it grows with the angle's square."""

NOISE: Final = 0.003
"""Of a reading."""

BORDER_MM: Final = 12.0
"""Presses are this far from the border."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--presses", type=int, default=60, metavar="N", help="presses of each shape (default 60)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Teach, test and report."""
    import numpy as np

    from eitskin.model.taught import TaughtField
    from eitskin_sim.fem.solve import solve_scene
    from eitskin_sim.scene.parts import Scene
    from eitskin_sim.scene.scene import load_scene
    from eitskin_tools.teach.teaching import teach_shapes

    if arguments.presses < 16:
        raise UsageError("--presses must be at least 16: a median needs values")
    scene = load_scene(SCENE)
    bent = {angle: replace(scene, bend=bend(angle)) for angle in ANGLES_DEG}
    teaching = {angle: presses(bent[angle], arguments.presses, seed=angle) for angle in {*sum(TAUGHT_DEG, ())}}
    testing = {angle: presses(bent[angle], arguments.presses, seed=1000 + angle) for angle in ANGLES_DEG}
    reference_V = teaching[0].readings[~teaching[0].pressed].mean(axis=0)
    flat_V = solve_scene(Scene()).voltages
    predicted = {
        angle: np.log(solve_scene(Scene(bend=bend(angle))).voltages / flat_V).astype(np.float32) for angle in ANGLES_DEG
    }
    rows: list[dict[str, Any]] = []
    for taught in TAUGHT_DEG:
        found = teach_shapes({str(angle): teaching[angle] for angle in taught}, None, 0.01)
        arrays, skin = [one.arrays for one in found.values()], next(iter(found.values())).skin
        for with_prediction in (False, True) if len(taught) == 1 else (False,):
            field = TaughtField(arrays, skin.grid, list(found))
            field.use_reference(reference_V)
            for angle in ANGLES_DEG:
                if with_prediction:
                    field.use_prediction(predicted[angle])
                what = f"taught {taught}{' with V_pred' if with_prediction else ''}, tested {angle} deg"
                rows.append({"what": what, **judged(field, testing[angle], reference_V)})
    return report(arguments, rows, {"presses": arguments.presses})


def bend(angle_deg: float) -> Any:
    """Return a roll of the sheet, which stretches it."""
    from eitskin_sim.scene.parts import Bend

    turn = angle_deg / 180.0
    along = 1.0 + STRETCH * turn**2
    return Bend(angle_deg=angle_deg, stretch_along=along, stretch_across=along**-0.25, nonuniformity=0.1 * turn)


def presses(scene: Any, count: int, seed: int, noise: float = NOISE) -> Any:
    """Return readings of a scene's first touch at ``count`` random places, each behind an untouched reading."""
    import numpy as np

    from eitskin_proto.sensor.row_table import ADJACENT_104
    from eitskin_sim.fem.solve import solve_scene
    from eitskin_sim.scene.shapes import Disc
    from eitskin_tools.teach.presses import Presses

    rng, size_mm = np.random.default_rng(seed), scene.sheet.size_mm
    xy_mm = np.full((2 * count, 2), np.nan)
    xy_mm[1::2] = rng.uniform(BORDER_MM, np.array(size_mm) - BORDER_MM, (count, 2))
    touch = scene.touches[0]
    volts = np.empty((2 * count, 104))
    volts[::2] = solve_scene(replace(scene, touches=())).voltages
    for row, (x, y) in enumerate(xy_mm[1::2]):
        one = replace(touch, shapes=(Disc(float(x), float(y), touch.shapes[0].radius_mm),))
        volts[2 * row + 1] = solve_scene(replace(scene, touches=(one,))).voltages
    volts *= np.exp(noise * rng.standard_normal(volts.shape))
    return Presses(volts, xy_mm, size_mm, "rectangle", ADJACENT_104, is_change=False)


def judged(field: Any, tested: Any, reference_V: Any) -> dict[str, Any]:
    """Return how a field places presses whose readings are held against a reference."""
    import numpy as np

    errors_mm, touched, shapes = [], {True: 0, False: 0}, Counter[str]()
    for reading, place_mm, pressed in zip(tested.readings, tested.xy_mm, tested.pressed, strict=True):
        field.change[:] = reading / reference_V - 1.0
        touched[bool(pressed)] += field.look() > field.threshold
        shapes[field.shape] += 1
        if pressed:
            touch = field.strongest()
            errors_mm.append(float(np.hypot(touch.x_mm - place_mm[0], touch.y_mm - place_mm[1])))
    count = len(errors_mm)
    return {
        "localisation_median_mm": float(np.median(errors_mm)),
        "missed": 1.0 - touched[True] / count,
        "false_touches": touched[False] / count,
        "shapes": ", ".join(f"{name} {number}" for name, number in shapes.most_common()),
    }


if __name__ == "__main__":
    sys.exit(program(__doc__, add_arguments, run))
