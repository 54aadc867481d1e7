"""The member of a skin's family that a scan shows: nearer than the scan where that is noisy, none beyond the family."""

from dataclasses import replace

import numpy as np
import pytest

from eitskin_proto.skin.skin import PAPER
from eitskin_sim.arrays import Array
from eitskin_sim.scene.bend import bend_metric
from eitskin_sim.scene.family import draw
from eitskin_sim.scene.nominal import nominal_sheet
from eitskin_sim.scene.parts import Bend
from eitskin_sim.surface.measured_cloud import measured_cloud
from eitskin_sim.surface.predict import fit_cloud
from eitskin_sim.surface.smoothed import smoothed
from eitskin_sim.verification.metric_family import MetricFamily, logarithm, metric_family, places_of
from eitskin_sim.verification.scanned_member import member_of
from eitskin_sim.verification.usual_waves import ScannedShape, usual_waves
from eitskin_sim.verification.waves import waves_of

SEED = 7
"""Names deformations that the family was not made of."""


def scanned(bend: Bend, noise_mm: float) -> ScannedShape:
    scan = smoothed(fit_cloud(measured_cloud(bend, np.random.default_rng(3), noise_mm)), noise_mm)
    return ScannedShape(scan, waves_of(PAPER), usual_waves(PAPER).under(scan))


def off(shape: ScannedShape | MetricFamily, bend: Bend) -> float:
    """Return the root mean square by which the logarithm of a shape's likeliest metric is off the true one."""
    at = places_of(PAPER)
    found = logarithm(shape.metric(np.zeros(shape.stretch.shape[1]))(at))
    return float(np.sqrt(np.mean((found - logarithm(bend_metric(bend, nominal_sheet(PAPER))(at))) ** 2)))


@pytest.mark.parametrize(("noise_mm", "share"), [(0.1, 1.05), (1.0, 0.8)])
def test_the_member_is_as_near_to_the_sheet_as_its_scan_and_nearer_where_that_is_noisy(
    noise_mm: float, share: float
) -> None:
    """But for uneven stretch, which no scan shows."""
    errors = []
    for drawn in draw("A", 10, SEED):
        bend = replace(drawn, nonuniformity=0.0)
        shape = scanned(bend, noise_mm)
        if (member := member_of(metric_family(), shape)) is not None:
            errors.append((off(member, bend), off(shape, bend)))
    of_members, of_scans = np.mean(np.square(errors), axis=0)
    assert len(errors) >= 3
    assert of_members < share**2 * of_scans


def test_a_member_may_be_off_by_what_its_scan_leaves_open() -> None:
    """Amplitudes of true sheets, whose uneven stretch goes either way, scatter by about one standard deviation."""
    members = [(member_of(metric_family(), scanned(bend, 0.1)), bend) for bend in draw("A", 12, SEED)]
    every = [member.amplitudes(bend)[-10:] for member, bend in members if member is not None]  # the least known
    assert 0.3 < np.sqrt(np.mean(np.square(every))) < 2.0


def test_a_scan_with_a_dent_shows_no_member_of_the_family() -> None:
    assert member_of(metric_family(), scanned(Bend(angle_deg=40.0), 0.1)) is not None
    assert member_of(metric_family(), scanned(Bend(angle_deg=40.0, bumps_mm=((70.0, 50.0, -10.0, 12.0),)), 0.1)) is None


def test_a_family_about_other_amplitudes_has_the_same_metrics() -> None:
    family, rng, at = metric_family(), np.random.default_rng(1), places_of(PAPER)
    count = family.stretch.shape[1]
    middle, z = rng.normal(0.0, 0.3, (2, count))
    ways = np.eye(count) + rng.normal(0.0, 0.01, (count, count))
    other = family.about(middle, ways)

    def close(one: Array, another: Array) -> None:
        np.testing.assert_allclose(one, another, atol=1e-9)

    close(other.metric(z)(at), family.metric(middle + ways @ z)(at))
    close(middle + ways @ other.drawn.T[:, 0], family.drawn[0])
    bend = family.bends[0]
    assert np.linalg.norm(other.amplitudes(bend) - other.drawn[0]) < 0.1 * np.linalg.norm(other.drawn[0])
