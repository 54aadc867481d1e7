"""Where material lies under a scan: what a shape says of it, held against deformations that were not learned from."""

from dataclasses import replace

import numpy as np
import pytest

from eitskin_proto.skin.skin import PAPER
from eitskin_sim.arrays import Array
from eitskin_sim.fem.mesh import Metric
from eitskin_sim.scene.bend import bend_metric
from eitskin_sim.scene.family import Family, draw
from eitskin_sim.scene.nominal import nominal_sheet
from eitskin_sim.surface.measured_cloud import measured_cloud
from eitskin_sim.surface.predict import fit_cloud
from eitskin_sim.surface.smoothed import Scan, smoothed
from eitskin_sim.verification.usual_waves import UsualWaves, usual_waves
from eitskin_sim.verification.waves import waves_of

SEED = 7
"""Names deformations that the process did not see."""


@pytest.fixture(scope="module")
def usual() -> UsualWaves:
    return usual_waves(PAPER)


def errors(usual: UsualWaves, family: Family, count: int) -> tuple[Array, Array, Array]:
    """Return (d,) squares: of even metrics beside those of scans, beside the likeliest, and waves that are stated."""
    apart, left, stated = [], [], []
    for number, bend in enumerate(draw(family, count, SEED)):
        scan = scanned(number, family)
        even = bend_metric(replace(bend, nonuniformity=0.0), nominal_sheet(PAPER))(usual.at)
        lying = usual.under(scan)
        apart.append(np.sum((even - scan.surface.metric(usual.at)) ** 2))
        left.append(np.sum((even - usual.waves.moved(scan.surface.metric)(lying.mean)(usual.at)) ** 2))
        stated.append(np.sum((lying.ways / usual.waves.sd[:, None]) ** 2))
    return np.array(apart), np.array(left), np.array(stated)


def scanned(number: int, family: Family) -> Scan:
    bend = draw(family, number + 1, SEED)[number]
    return smoothed(fit_cloud(measured_cloud(bend, np.random.default_rng(number))), 0.1)


def test_a_shape_says_where_its_material_lies_and_bumps_that_it_lies_anywhere(usual: UsualWaves) -> None:
    """Uneven stretch beside, which no scan shows."""
    apart, left, stated = errors(usual, "A", 6)
    assert left.sum() < 0.4 * apart.sum()
    _, _, bumped = errors(usual, "B", 3)
    assert np.median(bumped) > 3.0 * np.median(stated)


def flat_metric(xy_mm: Array) -> Array:
    return np.tile([1.0, 0.0, 1.0], (len(xy_mm), 1))


def uneven_metric(xy_mm: Array) -> Array:
    x, y = xy_mm.T / 100.0
    return np.stack([1.2 + 0.1 * x + 0.05 * x * y, 0.1 * x - 0.2 * y, 0.9 + 0.1 * y + 0.05 * x], axis=-1)


@pytest.mark.parametrize("metric", [flat_metric, uneven_metric])
def test_waves_keep_the_border_and_their_rates_are_quotients(metric: Metric) -> None:
    waves = waves_of()
    ends = ([[0.0, 30.0], [150.0, 70.0]], [[20.0, 0.0], [90.0, 100.0]])
    for axis, edge in enumerate(ends):
        assert np.abs(waves.along(axis, np.array(edge))[0]).max() < 1e-12
    at = np.array([[33.0, 21.0], [101.0, 77.0]])
    rates = np.array(waves.rates(metric, at))
    for number in (1, 5, 17, 18, 20, 29):
        step = np.zeros(len(waves.sd))
        step[number] = 1e-4
        quotient = (waves.moved(metric)(step)(at) - waves.moved(metric)(-step)(at)) / 2e-4
        assert np.allclose(rates[:, :, number].T, quotient, atol=2e-5)


def test_a_material_that_lies_elsewhere_has_the_metric_of_the_points_that_it_lies_under() -> None:
    """The moved metric measures a short way as the metric does between where its ends lie."""
    waves, rng = waves_of(), np.random.default_rng(3)
    amplitudes = 0.02 * rng.standard_normal(len(waves.sd))

    def lies(at: Array) -> Array:
        parts = np.split(amplitudes, [6 * 3])
        return at + np.stack([waves.along(axis, at)[0] @ part for axis, part in enumerate(parts)], axis=-1)

    at, way = np.array([[40.0, 30.0], [110.0, 64.0]]), 1e-4 * rng.standard_normal((2, 2))
    length = [
        np.einsum("kc,kc->k", metric(where), np.stack([w[:, 0] ** 2, 2.0 * w[:, 0] * w[:, 1], w[:, 1] ** 2], axis=-1))
        for metric, where, w in (
            (waves.moved(uneven_metric)(amplitudes), at, way),
            (uneven_metric, lies(at), lies(at + way) - lies(at)),
        )
    ]
    assert length[0] == pytest.approx(length[1], rel=1e-4)
