"""The model's error at a scanned bend, as a covariance from simulation.

A scan shows the surface, not the material in it: uneven stretch, the scan's noise, age and scale change the untouched
sheet's voltages by many times a frame's noise. These parameters are not worth estimating. So the error of the model is
drawn (the approximation error of Kaipio and Somersalo): bends of the skin's own deformations, scanned as the skin says,
predicted from their scans and solved as they truly are ::

    e = log(V_true(bend) / V_model(scan))        (104,), both with the same gauge factor, which is drawn too

Its covariance has a few large directions and a remainder, and is shrunk towards its diagonal. Errors are not Gaussian,
so it is enlarged until it covers most held-out errors, and until most gauge factors estimated from single held-out
bends are within their stated errors, because bends are recorded to find the gauge factor.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final

import numpy as np
from scipy.stats import chi2

from eitskin_proto.skin.grid import Grid
from eitskin_proto.skin.parts import Range
from eitskin_proto.skin.skin import Skin
from eitskin_sim.arrays import Array
from eitskin_sim.calibration import solved
from eitskin_sim.fem.forward import assemble
from eitskin_sim.fem.meshing import scene_mesh
from eitskin_sim.scene.bend import bend_metric
from eitskin_sim.scene.family import draw, scaled
from eitskin_sim.scene.nominal import nominal_scene
from eitskin_sim.scene.parts import Bend, Sheet
from eitskin_sim.surface.measured_cloud import measured_cloud
from eitskin_sim.surface.predict import FittedSurface, fit_cloud, noise_tangents

DRAWS: Final = 120
SEED: Final = 23_011
FOLDS: Final = 4
MAX_DIRECTIONS: Final = 12
"""Directions of their own."""

SHRINKAGE: Final = 0.3
"""Share of the covariance that is taken from its diagonal: fewer draws than would tell all of it."""

MIN_GAUGE_RESPONSE: Final = 0.05
"""Bends whose voltages follow the gauge factor less, on average, tell nothing of it."""

MIN_EXPLAINED_SHARE: Final = 0.95
"""Share of unseen errors that must be within what the covariance allows."""


@dataclass(frozen=True, slots=True, eq=False)
class BendError:
    """The error of the model of a scanned bend."""

    mean: Array
    """(104,) of the logarithm of the ratio to the flat sheet."""
    covariance: Array
    """(104, 104)"""
    steeper: float = 0.0
    """By which share voltages follow a gauge factor more than the scanned bend's model says; scans show too much."""
    largest: float = 1.0
    """Of all draws the largest squared distance a row by this covariance, at least 1: a bend may be as far off."""


@dataclass(frozen=True, slots=True)
class ScanError:
    """The properties of a scan whose model's error is estimated, so that similar bends are drawn."""

    strain: float
    """Rms of the strain that it shows; a drawn bend that is stretched more is scaled down to it."""
    noise_mm: float
    """Of its points."""


@lru_cache(maxsize=8)
def bend_error(skin: Skin, like: ScanError | None = None) -> BendError:
    """Return the error of a skin's scanned bends; 0.2 CPU-s a draw.

    Args:
        skin: Its deformations, and how it is scanned.
        like: Of one scan; None is for any bend of the skin.
    """
    return error_of(*drawn_errors(skin, DRAWS, like))


def scan_error(cloud_mm: Array, surface: FittedSurface, grid: Grid) -> ScanError:
    """Return a scan's own error, from the scan (3, rows, columns) and the surface through it."""
    xy = grid.pixel_centres_mm().reshape(-1, 2)
    off = np.asarray(cloud_mm).reshape(3, -1).T - surface.points(xy)
    noise_mm = float(np.sqrt(np.mean(off**2)))
    # of the two lengths and, twice, of the shear: what the scan's noise adds to the square of a strain
    added = 1.5 * sum(float(np.mean(np.sum((noise_mm * one) ** 2, axis=1))) for one in noise_tangents(xy, grid))
    return ScanError(float(np.sqrt(max(strain_of(surface.metric(xy)) ** 2 - added, 0.0))), noise_mm)


def strain_of(metric: Array) -> float:
    """Return the rms strain of metrics (n, 3): 0 of the flat sheet."""
    along, shear, across = (metric - [1.0, 0.0, 1.0]).T / 2.0
    return float(np.sqrt(np.mean(along**2 + 2.0 * shear**2 + across**2)))


def error_of(errors: Array, slopes: Array, gauges: Array) -> BendError:
    """Return the distribution of the next error from drawn ones.

    Args:
        errors: (draws, 104) of the logarithm.
        slopes: (draws, 104) by the gauge factor.
        gauges: (draws,) the gauge factors.
    """
    steeper = _steeper(errors, gauges[:, None] * slopes)
    errors = errors - steeper * gauges[:, None] * slopes
    fold = np.arange(len(errors)) % FOLDS
    judged = [_distances(errors[fold != k], errors[fold == k], slopes[fold == k]) for k in range(FOLDS)]
    apart, gauge = (np.concatenate(part) for part in zip(*judged, strict=True))
    scale = max(float(np.quantile(apart, MIN_EXPLAINED_SHARE)), 1.0)
    if gauge.size:
        scale = max(scale, float(np.quantile(gauge, MIN_EXPLAINED_SHARE) / chi2.ppf(MIN_EXPLAINED_SHARE, 1)))
    mean, covariance = _moments(errors)
    return BendError(mean, scale * covariance, steeper, max(float(apart.max()) / scale, 1.0))


def drawn_errors(skin: Skin, draws: int, like: ScanError | None = None) -> tuple[Array, Array, Array]:
    """Return (draws, 104) errors of the model of drawn bends, slopes by the gauge factor, and (draws,) its values."""
    generator, doubts = np.random.default_rng([SEED, 1]), skin.may_be_off
    scene = nominal_scene(skin, element_size_mm=solved.ELEMENT_MM)
    mesh = scene_mesh(scene)
    errors, slopes, gauges = [], [], []
    for bend in _bends(skin, draws, scene.sheet, like):
        seen = scaled(bend, 1.0 - _within(generator, doubts.scan_stale))
        noise = _within(generator, doubts.scan_noise_mm) if like is None else like.noise_mm
        cloud = measured_cloud(seen, generator, noise, skin).astype(np.float64)
        cloud *= float(doubts.scan_scale.draw(generator, 1)[0])
        sheet = replace(scene.sheet, gauge_factor=float(skin.layer.gauge_factor.draw(generator, 1)[0]))
        more = replace(sheet, gauge_factor=sheet.gauge_factor + 1.0)
        true, shown = bend_metric(bend, sheet), fit_cloud(cloud, skin.grid).metric
        read = [
            np.abs(assemble(mesh, of, scene.electrodes, metric).factorise().voltages())
            for of, metric in ((sheet, true), (sheet, shown), (more, shown))
        ]
        errors.append(np.log(read[0] / read[1]))
        slopes.append(np.log(read[2] / read[1]))
        gauges.append(sheet.gauge_factor)
    return np.array(errors), np.array(slopes), np.array(gauges)


def _bends(skin: Skin, draws: int, sheet: Sheet, like: ScanError | None) -> tuple[Bend, ...]:
    drawn = draw("A", draws, SEED, skin)
    if like is None:
        return drawn
    xy = skin.grid.pixel_centres_mm().reshape(-1, 2)
    strains = [max(strain_of(bend_metric(one, sheet)(xy)), 1e-9) for one in drawn]
    return tuple(scaled(one, min(1.0, like.strain / own)) for one, own in zip(drawn, strains, strict=True))


def _within(generator: np.random.Generator, bounds: Range) -> float:
    return float(generator.uniform(*bounds))


def _steeper(errors: Array, by_gauge: Array) -> float:
    """Return the factor with which what the gauge does explains errors best, by their own covariance."""
    mean, covariance = _moments(errors)
    weighed = np.linalg.solve(covariance, by_gauge.T).T
    size = float(np.sum(weighed * by_gauge))
    return float(np.sum(weighed * (errors - mean))) / size if size else 0.0


def _moments(errors: Array) -> tuple[Array, Array]:
    """Return the mean and the covariance: large directions, and the same rest in all others."""
    mean = errors.mean(axis=0)
    _, size, directions = np.linalg.svd(errors - mean, full_matrices=False)
    variance = size**2 / (len(errors) - 1)
    kept = min(MAX_DIRECTIONS, len(errors) // 3)
    rest = max(float(variance[kept:].sum()) / (errors.shape[1] - kept), 1e-12)
    large = np.maximum(variance[:kept] - rest, 0.0)
    covariance = (directions[:kept].T * large) @ directions[:kept] + rest * np.eye(errors.shape[1])
    return mean, np.asarray((1.0 - SHRINKAGE) * covariance + SHRINKAGE * np.diag(np.diag(covariance)))


def _distances(known: Array, unseen: Array, slopes: Array) -> tuple[Array, Array]:
    """Return squared distances, by the covariance of other errors, of unseen ones a row, and of the gauge they give."""
    mean, covariance = _moments(known)
    off = unseen - mean
    weighed = np.linalg.solve(covariance, off.T).T
    stretched = np.abs(slopes.mean(axis=1)) > MIN_GAUGE_RESPONSE
    along = np.sum(slopes * weighed, axis=1)[stretched]
    size = np.einsum("ni,ni->n", slopes, np.linalg.solve(covariance, slopes.T).T)[stretched]
    return np.einsum("ni,ni->n", off, weighed) / off.shape[1], along**2 / size
