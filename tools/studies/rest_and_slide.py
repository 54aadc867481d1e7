"""How much nearer a touch is for the frames before: a press at rest on a taught sheet, and a touch that slides.

The simulated sheet of docs/examples/press.json is taught single readings with the noise of a gelatin sheet: rows
differ, five components have much of it, and all rows drift together. Other presses rest, each after untouched frames.
Then a 10 mm touch slides over the sheet of bundle free, with 50 dB of noise, and is tracked. Last, physics sees every
tenth frame of the same slide, alone and with where its earlier verdicts expect the touch.
"""

import argparse
import sys
from functools import lru_cache
from typing import Any, Final

from taught_shapes import SCENE, presses  # type: ignore[import-not-found]  # beside this script

from eitskin_tools.bench.harness import program, report

SIGNAL, ROW_SPREAD, SHARED, COMPONENTS = 1.2, 0.75, 0.44, 5
"""Of the gelatin: median change of a row by a press over the median noise; standard deviation of the logarithm of
rows' noise; the part of its variance that so many components have."""

DRIFT: Final = 0.39 / 10_000**0.5
"""Standard deviation of the step of all rows from frame to frame, over the median noise: 0.39 in 50 s."""

BEFORE, REST = 100, 40
"""Untouched frames before a press; frames at rest before and after a slide."""

SPEED_MM_S, RATE_HZ, SLIDE = 50.0, 200, 80
"""Of the slide, the last in frames."""

CHECKED: Final = 10
"""Frames from one that physics sees to the next."""

WAY: Final = (0.92, 0.39)
"""Its direction."""

NOISE: Final = 10**-2.5
DRAWS: Final = 32
"""Of the noise of a slide."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--presses", type=int, default=60, metavar="N", help="taught and tested presses (default 60)")
    parser.add_argument("--frames", type=int, default=50, metavar="N", help="frames of a press (default 50)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Measure both and report."""
    slides = [row for contrast in (2.0, 50.0) for row in (*slide(contrast), *checked_slide(contrast))]
    return report(arguments, [*rest(arguments.presses, arguments.frames), *slides], {})


def rest(count: int, frames: int) -> list[dict[str, Any]]:
    """Return how near a taught sheet places presses, by one frame and by several."""
    import numpy as np

    from eitskin.model.taught import TaughtField
    from eitskin_proto.sensor.noise_law import noise_of
    from eitskin_sim.scene.scene import load_scene
    from eitskin_tools.teach.teaching import teach_shapes

    scene, rng = load_scene(SCENE), np.random.default_rng(3)
    taught, tested = (presses(scene, count, seed=seed, noise=0.0) for seed in (0, 1000))
    median = np.median(np.abs(taught.readings[taught.pressed] / taught.readings[0] - 1.0)) / SIGNAL
    sd = median * np.exp(ROW_SPREAD * rng.standard_normal(104))
    mix = rng.standard_normal((COMPONENTS, 104))
    mix *= np.sqrt(SHARED / (mix**2).sum(axis=0)) * sd

    def noise(count: int) -> Any:
        own = np.sqrt(1.0 - SHARED) * sd * rng.standard_normal((count, 104))
        drift = DRIFT * median * rng.standard_normal((count, 1)).cumsum(axis=0)
        return np.exp(own + rng.standard_normal((count, COMPONENTS)) @ mix + drift)

    taught.readings[:] *= noise(len(taught.readings))
    (found,) = teach_shapes({"flat": taught}, None, 0.01).values()
    untouched = tested.readings[0] * noise(BEFORE)
    spread, shared = noise_of(untouched)
    field, reference_V, errors_mm = TaughtField([found.arrays], found.skin.grid), untouched.mean(axis=0), []
    field.use_reference(reference_V, spread, shared, BEFORE)
    for reading, place_mm in zip(tested.readings[tested.pressed], tested.xy_mm[tested.pressed], strict=True):
        field.reset()
        clean = np.vstack([np.tile(tested.readings[0], (BEFORE, 1)), np.tile(reading, (frames, 1))])
        for number, change in enumerate(clean * noise(len(clean)) / reference_V - 1.0):
            field.change[:] = change
            field.touched()
            if number in (BEFORE, len(clean) - 1):
                touch = field.strongest()
                errors_mm.append(np.hypot(touch.x_mm - place_mm[0], touch.y_mm - place_mm[1]))
    names = ("press at rest, one frame", f"press at rest, {frames} frames")
    return [_row(name, np.array(errors_mm[at::2])) for at, name in enumerate(names)]


@lru_cache(maxsize=2)
def sliding(contrast: float) -> tuple[Any, Any, Any]:
    """Return (104,) V of the untouched sheet, (n, 2) mm where a touch is frame by frame, and (n, 104) dV of it."""
    import numpy as np

    from eitskin_sim.fem.solve import solve_scene
    from eitskin_sim.scene.scene import parse_scene

    flat_V = solve_scene(parse_scene({"touches": []})).voltages
    step = np.concatenate([np.zeros(REST), np.arange(SLIDE), np.full(REST, SLIDE - 1)])
    places_mm = np.array([40.0, 35.0]) + np.outer(step * SPEED_MM_S / RATE_HZ, WAY)
    solved = {}
    for x, y in np.unique(places_mm, axis=0).tolist():
        touch = {"rect_mm": [x - 5.0, y - 5.0, x + 5.0, y + 5.0], "contrast": contrast}
        solved[x, y] = solve_scene(parse_scene({"touches": [touch]})).voltages / flat_V - 1.0
    return flat_V, places_mm, np.array([solved[x, y] for x, y in places_mm.tolist()])


def network_on_flat_sheet() -> tuple[Any, Any, Any]:
    """Return bundle free, its network's buffers, and what infers."""
    from eitskin.model.buffers import Buffers
    from eitskin.model.bundle import load_bundle
    from eitskin.model.engine import engines
    from eitskin.model.geometry import GeometryGraph

    bundle = load_bundle("free")
    buffers = Buffers(bundle, None)
    buffers.use_geometry(GeometryGraph(bundle).geometry(None, None, 0))
    return bundle, buffers, engines(bundle, buffers, alone=True)[0]


def slide(contrast: float) -> list[dict[str, Any]]:
    """Return how near a sliding touch is, frame by frame and tracked, and by how much it is late."""
    import numpy as np

    from eitskin.model.stillness import Stillness
    from eitskin.touches.moments import TouchFinder
    from eitskin.touches.surface import Surface
    from eitskin.touches.touch import LAYOUT, unpack_touches
    from eitskin.touches.watch import TouchWatch

    (bundle, buffers, engine), rng = network_on_flat_sheet(), np.random.default_rng(1)
    grid, (flat_V, places_mm, clean) = bundle.skin.grid, sliding(contrast)
    surface = Surface(grid.flat_cloud_mm(), grid)

    def shown(*, tracked: bool) -> Any:
        stillness, watch, found, which = Stillness(), TouchWatch(grid), [], 0
        stillness.use_reference(flat_V, NOISE * np.abs(flat_V), 1000)
        for number, change in enumerate(clean + NOISE * rng.standard_normal(clean.shape)):
            stillness.alone = watch.tracker.moves or not tracked
            if stillness.take(change.astype(np.float32)):
                buffers.change[0], which = stillness.mean, number
                engine.infer()
            if tracked:
                packed = watch.update(buffers.map[0], which, surface, 5000 * number, stillness.frames)
                found.append(unpack_touches(packed[0], LAYOUT.size, *packed[1:]).touches[0].centre_mm)
            else:
                found.append(TouchFinder(grid).find(buffers.map[0]).rows[0][:2])
        return (np.array(found) - places_mm)[REST + 20 : REST + SLIDE]

    return [
        _slid(f"contrast {contrast:g}, {name}", [shown(tracked=tracked) for _ in range(DRAWS)])
        for name, tracked in (("frame by frame", False), ("tracked", True))
    ]


def checked_slide(contrast: float) -> list[dict[str, Any]]:
    """Return how near physics has a sliding touch, by one frame and with where its earlier verdicts expect it."""
    import numpy as np

    from eitskin_sim.verification.residual import Noise
    from eitskin_tools.evaluation.verified.solver import MapVerifier
    from eitskin_tools.verifier.followed import FollowedTouches

    (bundle, buffers, engine), rng = network_on_flat_sheet(), np.random.default_rng(1)
    grid, (flat_V, places_mm, clean) = bundle.skin.grid, sliding(contrast)
    verifier = MapVerifier(flat_V, Noise("measured", measured=np.full(104, NOISE)), "area", "raise", bundle.skin)
    verifier.shapes.deform(grid.flat_cloud_mm())
    apart: list[list[Any]] = [[], []]
    for _ in range(DRAWS):
        followed = FollowedTouches()
        for number in range(REST, REST + SLIDE, CHECKED):
            change = clean[number] + NOISE * rng.standard_normal(104)
            buffers.change[0] = change
            engine.infer()
            alone: Any = verifier.verify(flat_V * (1.0 + change), buffers.map[0].reshape(grid.shape), 2.0).touches
            both = alone, followed.follow(alone, 5000 * number)
            for found, touches in zip(apart, both, strict=True) if number >= REST + 20 else ():
                found.append([touches[0].centre_mm - places_mm[number]])
    names = "physics, frame by frame", "physics, followed"
    return [_slid(f"contrast {contrast:g}, {name}", found) for name, found in zip(names, apart, strict=True)]


def _slid(name: str, apart_mm: list[Any]) -> dict[str, Any]:
    """Return a row of (n, 2) distances of each of some slides."""
    import numpy as np

    every = np.concatenate(apart_mm)
    late_ms = -1e3 / SPEED_MM_S * float((every @ WAY).mean())
    return {**_row(f"slide, {name}", np.hypot(*every.T)), "late_ms": late_ms}


def _row(name: str, errors_mm: Any) -> dict[str, Any]:
    import numpy as np

    rms_mm = float(np.sqrt((errors_mm**2).mean()))
    return {"what": name, "localisation_median_mm": float(np.median(errors_mm)), "localisation_rms_mm": rms_mm}


if __name__ == "__main__":
    sys.exit(program(__doc__, add_arguments, run))
