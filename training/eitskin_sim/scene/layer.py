"""The deviation of the layer's conductivity from the nominal one, at any point of the flat sheet.

::

    sigma(x) = conductivity_S_per_m * exp(log_conductivity(x)) * (local area stretch)^-gauge_factor

A smooth field is a sum of cosines whose wave vectors are normal draws of deviation 1 / l along x and along y::

    f(x) = rms sqrt(2 / N) sum_n cos(k_n . x + phase_n)       <f(x) f(y)> = rms^2 exp(-|x - y|^2 / (2 l^2))

Mean, variance and correlation are those over seeds: one draw on a sheet not much larger than l has a mean of its own,
and a field of infinite l is a constant.
"""

from typing import Final

import numpy as np

from eitskin_sim.arrays import Array
from eitskin_sim.scene.parts import LaterChanges, Sheet, SmoothField

WAVES: Final = 64
"""N: their sum's kurtosis is 2 % below that of a normal draw."""

FIELD_SEED: Final = 16_001
TILT_SEED: Final = 16_002
"""Both keep draws apart from all others of the same seed."""

POINTS_PER_BLOCK: Final = 1 << 14
"""Points of a block: its cosines stay in the cache."""


def log_conductivity(sheet: Sheet, xy_mm: Array, late: bool = True) -> Array:
    """Return (...,) the logarithm of conductivity over the nominal one at flat points (..., 2), before any stretch.

    Args:
        sheet: The layer.
        xy_mm: Flat points.
        late: With what came after the reference was taken.
    """
    xy = np.asarray(xy_mm, dtype=np.float64)
    found = np.zeros(xy.shape[:-1])
    if sheet.field is not None:
        found += smooth_field(sheet.field, xy)
    if late and sheet.late is not None:
        found += np.log(sheet.late.factor) + _tilt(sheet.late, sheet.size_mm, xy)
        if sheet.late.field is not None:
            found += smooth_field(sheet.late.field, xy)
    return found


def smooth_field(field: SmoothField, xy_mm: Array) -> Array:
    """Return (...,) the values of a field at flat points (..., 2)."""
    rng = np.random.default_rng([FIELD_SEED, field.seed])
    waves = rng.standard_normal((WAVES, 2)) / field.correlation_mm
    phases = rng.uniform(0.0, 2.0 * np.pi, WAVES)
    xy = np.asarray(xy_mm, dtype=np.float64)
    points, found = xy.reshape(-1, 2), np.empty(xy[..., 0].size)
    for start in range(0, len(points), POINTS_PER_BLOCK):
        block = slice(start, start + POINTS_PER_BLOCK)
        # By columns and not by a matrix product: a point's value must not depend on which points come with it.
        at = points[block, :1] * waves[:, 0] + points[block, 1:] * waves[:, 1] + phases
        found[block] = np.cos(at).sum(axis=1)
    return np.asarray(field.rms * np.sqrt(2.0 / WAVES) * found).reshape(xy.shape[:-1])


def _tilt(late: LaterChanges, size_mm: tuple[float, float], xy_mm: Array) -> Array:
    """Return (...,) a plane of mean zero and rms ``gradient_rms`` over the sheet, its direction drawn from the seed."""
    turn = np.random.default_rng([TILT_SEED, late.seed]).uniform(0.0, 2.0 * np.pi)
    across = (xy_mm / np.array(size_mm) - 0.5) @ np.array([np.cos(turn), np.sin(turn)])
    return np.asarray(late.gradient_rms * np.sqrt(12.0) * across)


def gauge(sheet: Sheet, metric: Array) -> Array:
    """Return (...,) what stretching makes of conductivity, (local area stretch)^-k, where the metric is (..., 3)."""
    E, F, G = np.moveaxis(np.asarray(metric, dtype=np.float64), -1, 0)
    return np.asarray((E * G - F**2) ** (-0.5 * sheet.gauge_factor))


def is_uneven(sheet: Sheet) -> bool:
    """Return whether a layer's conductivity is anywhere, or can become, another than the nominal one."""
    return bool(sheet.gauge_factor) or sheet.field is not None or sheet.late is not None


def relative_conductivity(sheet: Sheet, xy_mm: Array, metric: Array) -> Array:
    """Return (...,) conductivity over the nominal one at flat points (..., 2) of metric (..., 3)."""
    return np.asarray(np.exp(log_conductivity(sheet, xy_mm)) * gauge(sheet, metric))
