"""Estimates the displacement of the material under a scan's points from the shape, with its uncertainty.

Deformations of the skin's family are drawn, scanned without noise and mirrored, and the waves are found that turn the
metric of each cloud into the sheet's own. Twist and skew displace the material and also shape the sheet, so the waves
are a Gaussian process of the scan's shape. Its leave-one-out error stays unknown; so does uneven stretch, which a scan
does not show. A shape unlike the drawn ones has a larger error. Bumps show as a metric that no drawn shape has: the
displacement's uncertainty then grows with them.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.arrays import Array
from eitskin_sim.fem.mesh import Metric
from eitskin_sim.scene.bend import bend_metric
from eitskin_sim.scene.family import draw
from eitskin_sim.scene.nominal import nominal_sheet
from eitskin_sim.surface.measured_cloud import measured_cloud
from eitskin_sim.surface.predict import fit_cloud
from eitskin_sim.surface.smoothed import Scan
from eitskin_sim.verification import constants as c
from eitskin_sim.verification.waves import Waves, waves_of


@dataclass(frozen=True, slots=True, eq=False)
class MaterialPrior:
    """The material's displacement under a scan's points."""

    mean: Array
    """(w,) amplitudes of the waves that are likeliest."""
    ways: Array
    """(w, w) amplitudes for one standard deviation of every way in which it may lie elsewhere, the widest first."""
    at_rest: Array
    """(w, w) the same for what the sheet reads untouched, which is believed whatever it says: loose material would
    explain too much, so bumps count no more than a shape unlike those drawn."""


@dataclass(frozen=True, slots=True, eq=False)
class ScannedShape:
    """The shape of a scan: its surface, with the material displaced."""

    scan: Scan
    waves: Waves
    material: MaterialPrior

    @property
    def stretch(self) -> Array:
        """(w, k) stretches by each amplitude: those of the waves."""
        return self.material.ways

    def metric(self, amplitudes: Array) -> Metric:
        """Return the metric at (k,) amplitudes."""
        return self.waves.moved(self.scan.surface.metric)(self.material.mean + self.material.ways @ amplitudes)

    def rates(self, amplitudes: Array, metric: Metric, xy_mm: Array) -> tuple[Array, Array, Array]:
        """Return the derivatives of E, F and G by amplitudes, and by the scan's noise, with what it may be."""
        own = np.array(self.waves.rates(metric, xy_mm)) @ self.material.ways
        return own, self.scan.rates(xy_mm), self.scan.unsure

    def at_rest(self) -> "ScannedShape":
        """Return the shape whose material is as loose as what the untouched sheet reads may tell."""
        ways = self.material.at_rest
        return self if ways is self.material.ways else replace(self, material=replace(self.material, ways=ways))


@dataclass(frozen=True, slots=True, eq=False)
class UsualWaves:
    """A model of the material's displacement, from the shapes of a skin's deformations."""

    waves: Waves
    at: Array
    """(n, 2) places where a metric is looked at."""
    middle: Array
    """(3 n,) of the metrics drawn."""
    parts: Array
    """(3 n, p) principal components."""
    scale: Array
    """(p,) by which their scores are multiplied."""
    scores: Array
    """(d, p) of the deformations."""
    inverse: Array
    """(d, d) of their covariance."""
    weights: Array
    """(d, w) of the waves, each over its spread."""
    usual: Array
    """(w, w) covariance of them all,"""
    left: Array
    """(w, w) and of what the shape does not say."""

    def under(self, scan: Scan) -> MaterialPrior:
        """Return the material's displacement under a scan."""
        shown = _features(scan.surface.metric, self.at) - self.middle
        beyond = shown - self.parts @ (self.parts.T @ shown)
        bumps = max(float(beyond @ beyond - self._noise(scan)) / len(beyond), 0.0)
        near = _kernel((self.scale * (shown @ self.parts))[None], self.scores)[0]
        unlike = float(np.clip(1.0 - near @ self.inverse @ near, 0.0, 1.0))
        covariance, unlike_shape = unlike * self.usual + self.left, c.WAVE_SD_SHARE_OF_UNLIKE_SHAPE**2
        alone = c.WAVE_SD_SHARE_ALWAYS**2 + unlike * unlike_shape + bumps / c.BUMPS_RMS_OF_FREE_MATERIAL**2
        wide = self._ways(covariance, alone)
        at_rest = wide if alone <= unlike_shape else self._ways(covariance, unlike_shape)
        return MaterialPrior(self.waves.sd * (near @ self.weights), wide, at_rest)

    def _ways(self, covariance: Array, alone: float) -> Array:
        size, way = np.linalg.eigh(covariance + alone * np.eye(len(covariance)))
        return np.asarray(self.waves.sd[:, None] * way * np.sqrt(size))[:, ::-1]

    def _noise(self, scan: Scan) -> float:
        """Return the sum of squares beyond the components by which a scan is unsure."""
        E, _, G = scan.surface.metric(self.at).T
        by_E, by_F, by_G = scan.rates(self.at)
        unsure = np.concatenate([by_E / E[:, None], by_F, by_G / G[:, None]]) @ scan.unsure
        return float(np.sum(unsure**2) - np.sum((self.parts.T @ unsure) ** 2))


@lru_cache(maxsize=4)
def usual_waves(skin: Skin = PAPER) -> UsualWaves:
    """Return the model that estimates displacements from the shapes of a skin's deformations."""
    sheet, waves = nominal_sheet(skin), waves_of(skin)
    x, y = ((np.arange(n) + 0.5) * extent / n for n, extent in zip(c.METRIC_PLACES, skin.outline.size_mm, strict=True))
    at = np.stack([one.ravel() for one in np.meshgrid(x, y)], axis=-1)
    shown, found = [], []
    for bend in draw("A", c.USUAL_WAVES_DRAWS, c.USUAL_WAVES_SEED, skin, apart=False):
        scanned = fit_cloud(measured_cloud(bend, None, skin=skin), skin.grid).metric
        moved = waves.moved(scanned)
        either = [
            _amplitudes(waves, moved, bend_metric(replace(bend, nonuniformity=uneven), sheet)(at), at)
            for uneven in (bend.nonuniformity, -bend.nonuniformity)  # which have the same scan
        ]
        for mirrors in ((), (0,), (1,), (0, 1)):
            shown.append(_mirrored(_features(scanned, at), mirrors))
            found.append(np.array(either) * np.prod([waves.mirrored(axis) for axis in mirrors], axis=0))
    features, (one, other) = np.array(shown), np.moveaxis(np.array(found), 1, 0)
    values, uneven = (one + other) / 2.0, (one - other) / 2.0
    middle = features.mean(axis=0)
    _, size, way = np.linalg.svd(features - middle, full_matrices=False)
    parts, spread = way[: c.METRIC_COMPONENTS].T, size[: c.METRIC_COMPONENTS] / np.sqrt(len(features))
    scale = np.asarray(spread / (spread**2 + c.METRIC_NOISE_RMS**2), dtype=np.float64)
    scores = scale * ((features - middle) @ parts)
    covariance = _kernel(scores, scores) + c.SHAPE_KERNEL_NUGGET * np.eye(len(scores))
    inverse = np.asarray(np.linalg.inv(covariance), dtype=np.float64)
    weights = inverse @ values
    missed = weights / np.diag(inverse)[:, None]  # of each, by all others
    usual, left = ((each.T @ each + uneven.T @ uneven) / len(each) for each in (values, missed))
    return UsualWaves(waves, at, middle, parts, scale, scores, inverse, weights, usual, left)


def _amplitudes(waves: Waves, moved: Callable[[Array], Metric], true: Array, at: Array) -> Array:
    """Return (w,) amplitudes, over their spreads, that turn the metric of a scan into the (n, 3) of a sheet."""
    total = np.zeros(len(waves.sd))
    for _ in range(c.USUAL_WAVES_STEPS):
        metric = moved(waves.sd * total)
        rates = np.concatenate(waves.rates(metric, at)) * waves.sd
        left = (true - metric(at)).T.ravel()
        total = total + np.linalg.solve(rates.T @ rates + 1e-3 * np.eye(len(total)), rates.T @ left)
    return total


def _features(metric: Metric, at: Array) -> Array:
    """Return (3 n,) what a metric shows at (n, 2) places: log E, F, log G."""
    E, F, G = metric(at).T
    return np.concatenate([np.log(E), F, np.log(G)])


def _mirrored(features: Array, mirrors: tuple[int, ...]) -> Array:
    """Return (3 n,) features of a shape mirrored along some axes."""
    fields = features.reshape(3, *c.METRIC_PLACES[::-1])
    turned = np.flip(fields, axis=tuple(2 - axis for axis in mirrors))
    return np.asarray(turned * np.array([1.0, (-1.0) ** len(mirrors), 1.0])[:, None, None]).ravel()


def _kernel(one: Array, other: Array) -> Array:
    """Return (a, b) how alike the shapes of (a, p) and (b, p) scores are."""
    apart = np.sum(one**2, axis=1)[:, None] + np.sum(other**2, axis=1) - 2.0 * one @ other.T
    return np.asarray(np.exp(-np.maximum(apart, 0.0) / (2.0 * c.SHAPE_KERNEL_LENGTH**2)))
