"""Where material lies under a scan: what a shape says of it, held against deformations that were not learned from."""

from dataclasses import replace

import numpy as np
import pytest

from eitskin_proto.skin.skin import PAPER
from eitskin_sim.scene.bend import bend_metric
from eitskin_sim.scene.family import Family, draw
from eitskin_sim.scene.nominal import nominal_sheet
from eitskin_sim.scene.touch_table import Array
from eitskin_sim.surface.measured_cloud import measured_cloud
from eitskin_sim.surface.predict import fit_cloud
from eitskin_sim.surface.smoothed import Scan, smoothed
from eitskin_sim.verification.sheet.usual_waves import UsualWaves, usual_waves
from eitskin_sim.verification.sheet.waves import waves_of

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
        left.append(np.sum((even - usual.waves.moved(scan.surface.metric, lying.mean)(usual.at)) ** 2))
        stated.append(np.sum((lying.ways / usual.waves.sd[:, None]) ** 2))
    return np.array(apart), np.array(left), np.array(stated)


def scanned(number: int, family: Family) -> Scan:
    bend = draw(family, number + 1, SEED)[number]
    return smoothed(fit_cloud(measured_cloud(bend, np.random.default_rng(number))), 0.1)


def test_a_shape_says_where_its_material_lies_and_bumps_that_it_lies_anywhere(usual: UsualWaves) -> None:
    """Uneven stretch beside, which no scan shows."""
    apart, left, stated = errors(usual, "A", 10)
    assert left.sum() < 0.4 * apart.sum()
    _, _, bumped = errors(usual, "B", 5)
    assert np.median(bumped) > 3.0 * np.median(stated)


def test_what_nothing_says_is_centred_and_wide(usual: UsualWaves) -> None:
    anyhow = usual.anyhow()
    assert not anyhow.mean.any()
    known = usual.under(scanned(0, "A"))
    assert np.sum(known.ways**2) < np.sum(anyhow.ways**2)


@pytest.mark.parametrize("axis", [0, 1])
def test_mirrored_amplitudes_move_the_mirrored_material(axis: int) -> None:
    waves, rng = waves_of(PAPER), np.random.default_rng(4)
    amplitudes = 0.3 * waves.sd * rng.standard_normal(len(waves.sd))
    size = np.array(PAPER.outline.size_mm)
    at = rng.uniform(0.0, size, (50, 2))

    def metric(xy_mm: Array) -> Array:
        x, y = (xy_mm / size).T
        return np.stack([1.2 + 0.1 * x + 0.05 * y * y, 0.05 * x * y, 1.0 - 0.1 * y + 0.05 * x], axis=-1)

    def turned(xy_mm: Array) -> Array:
        there = xy_mm.copy()
        there[:, axis] = size[axis] - there[:, axis]
        return metric(there) * np.array([1.0, -1.0, 1.0])

    there = at.copy()
    there[:, axis] = size[axis] - there[:, axis]
    found = waves.moved(turned, waves.mirrored(axis) * amplitudes)(at)
    assert found == pytest.approx(waves.moved(metric, amplitudes)(there) * np.array([1.0, -1.0, 1.0]), abs=1e-9)
