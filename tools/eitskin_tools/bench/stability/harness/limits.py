"""What explains a break point: how much of a touch is left beside noise, or beside a change that is no touch.

Three figures, all from the forward model and none from the solver that broke::

    drowned     rows in which the disturbance is larger than what the touch changes, of 104
    patterns    singular values of the unit operator that stand above the noise: how many numbers the data still hold
    d'          || (V - V without its smallest touch) / sigma ||: an ideal observer who knows all else tells the two
                apart with an error of Phi(-d'/2); below 2 nobody can, far above 2 the break is the solver's own
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from eitskin_sim.scene.parts import Scene
from eitskin_sim.solvers.operators import SATURATED
from eitskin_tools.bench.stability.harness.samples import Sample, voltages_of

Array = npt.NDArray[np.float64]


def touch_change(sample: Sample) -> Array:
    """Return (104,) dV that the touch alone makes, against the flat reference."""
    return np.asarray((sample.voltages - sample.sheet.untouched) / sample.flat)


def rms(values: Array) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def explain_noise(samples: Sequence[Sample], spread: Callable[[Sample], Array]) -> str:
    """Return drowned rows, patterns and d' of noise of known spread (104,) V, medians over the samples."""
    drowned, patterns, distance = [], [], []
    for sample in samples:
        sigma = spread(sample)
        drowned.append(np.count_nonzero(sigma > np.abs(sample.voltages - sample.sheet.untouched)))
        whitened = (np.abs(sample.sheet.untouched) / sigma)[:, None] * sample.sheet.operators("units").relative_jacobian
        patterns.append(np.count_nonzero(SATURATED * np.linalg.svd(whitened, compute_uv=False) > 1.0))
        distance.append(float(np.linalg.norm((sample.voltages - voltages_of(without_smallest(sample.scene))) / sigma)))
    return (
        f"noise exceeds the touch's own change in {np.median(drowned):.0f} of 104 rows, "
        f"{np.median(patterns):.0f} of 104 patterns stand above it; "
        f"an ideal observer misses the smallest touch with d' = {np.median(distance):.3g}"
    )


@lru_cache(maxsize=256)
def without_smallest(scene: Scene) -> Scene:
    """Return a scene without the touch of the smallest area."""
    if not scene.touches:
        return scene
    areas = [sum(shape.area_mm2 for shape in touch.shapes) for touch in scene.touches]
    least = int(np.argmin(areas))
    return replace(scene, touches=tuple(t for i, t in enumerate(scene.touches) if i != least))


def nuisance(samples: Sequence[Sample], disturbed: Sequence[Sample]) -> tuple[float, float]:
    """Return the rms dV of a disturbance on the untouched sheets, and how many times the touches' rms dV that is.

    Args:
        samples: Touched, undisturbed.
        disturbed: Their untouched twins, disturbed.
    """
    change = [rms((d.read - s.sheet.untouched) / s.flat) for s, d in zip(samples, disturbed, strict=True)]
    touch = [rms(touch_change(s)) for s in samples]
    return float(np.median(change)), float(np.median(np.array(change) / np.array(touch)))


def explain_change(samples: Sequence[Sample], disturbed: Sequence[Sample]) -> str:
    """Return what a disturbance does to dV with nothing touched, beside what the touches do."""
    change, share = nuisance(samples, disturbed)
    return f"alone it changes dV by {change:.3g} rms, {share:.3g} times what the touches change"
