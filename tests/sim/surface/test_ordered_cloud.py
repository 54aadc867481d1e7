"""Measured points, in any pose and without order, become the ordered cloud."""

import numpy as np
import pytest
from scipy.spatial import cKDTree
from tests.sim.surface.raw_points import BENDS, Raw

from eitskin_proto.skin.cloud import align_cloud
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.scene.scene import Bend
from eitskin_sim.surface import ordered_cloud, smooth_surface


@pytest.mark.parametrize("bend", list(BENDS.values())[::3], ids=list(BENDS)[::3])
def test_cloud_lies_on_the_true_surface_within_a_twentieth_of_a_millimetre(bend):
    raw = Raw(bend, 30_000)
    result = ordered_cloud.organise(raw.points, raw.corner())
    off, _ = raw.off_and_along(result)
    assert np.sqrt(np.mean(off**2)) < 0.05
    assert result.noise_mm == pytest.approx(0.1, rel=0.15)
    assert result.outliers == pytest.approx(0.01 * result.points, rel=0.2)


@pytest.mark.parametrize("name", ["half a turn, stretched", "skewed"])
def test_evenly_stretched_sheet_gets_every_point_at_its_pixel(name):
    # Arc length is material there. What is left is the outline: 30,000 points place a side within about 0.2 mm.
    raw = Raw(BENDS[name], 30_000)
    _, along = raw.off_and_along(ordered_cloud.organise(raw.points, raw.corner()))
    assert np.sqrt(np.mean(along**2)) < 0.25


def test_pose_and_order_of_the_points_do_not_change_the_cloud():
    raw = Raw(BENDS["skewed"], 20_000)
    first = ordered_cloud.organise(raw.points, raw.corner())
    rng = np.random.default_rng(5)
    turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    moved = rng.permutation(raw.points) @ turn.T + 50.0
    second = ordered_cloud.organise(moved, tuple(np.array(raw.corner()) @ turn.T + 50.0))
    # The points fall into other cubes: the same surface, from the same noise, within that noise.
    assert np.abs(first.cloud_mm - second.cloud_mm).max() < 0.5
    assert np.sqrt(np.mean((first.cloud_mm - second.cloud_mm) ** 2)) < 0.1


def test_rotation_and_translation_carry_the_scan_onto_the_cloud():
    raw = Raw(BENDS["twisted"], 20_000, outliers=0.0)
    result = ordered_cloud.organise(raw.points, raw.corner())
    assert np.allclose(result.rotation @ result.rotation.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(result.rotation) == pytest.approx(1.0, abs=1e-9)
    moved = raw.points @ result.rotation.T + result.translation_mm
    gap = cKDTree(moved).query(result.cloud_mm.reshape(3, -1).T)[0]
    assert np.median(gap) < 0.6  # 20,000 points on 15,000 mm^2 are 0.87 mm apart
    assert np.allclose(align_cloud(result.cloud_mm), result.cloud_mm, atol=1e-9)


@pytest.mark.parametrize(("x", "y", "flips"), [(150, 0, "x"), (150, 100, "xy")])
def test_corner_hint_decides_between_all_four_ways_to_lay_the_grid(x, y, flips):
    raw = Raw(BENDS["skewed"], 20_000)
    straight = ordered_cloud.organise(raw.points, raw.corner())
    turned = ordered_cloud.organise(raw.points, raw.corner(x, y))
    expected = straight.cloud_mm
    expected = expected[:, :, ::-1] if "x" in flips else expected
    expected = expected[:, ::-1, :] if "y" in flips else expected
    assert turned.corner == "given"
    assert np.allclose(turned.cloud_mm, align_cloud(expected), atol=1e-6)


def test_without_a_hint_the_scanner_frame_decides_and_the_result_says_so():
    raw = Raw(BENDS["skewed"], 20_000)
    tilted = (raw.points - raw.shift) @ raw.turn  # back in the sheet's own frame, then tilted by 40 degrees
    angle = np.deg2rad(40)
    tilt = np.array([[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]])
    result = ordered_cloud.organise(tilted @ tilt.T)
    hinted = ordered_cloud.organise(raw.points, raw.corner())
    assert result.corner == "scanner frame"
    assert np.sqrt(np.mean((result.cloud_mm - hinted.cloud_mm) ** 2)) < 0.1


def test_corner_hint_in_the_middle_is_refused_with_both_distances():
    raw = Raw(BENDS["flat"], 5_000)
    with pytest.raises(ordered_cloud.PointCloudError, match="two nearest corners"):
        ordered_cloud.organise(raw.points, raw.corner(75, 50))


def test_holes_up_to_15_mm_are_filled_even_at_the_border():
    raw = Raw(Bend(angle_deg=120), 40_000, holes=((50, 50, 7.3), (0, 60, 7.0), (150, 100, 6.0), (100, 0, 5.0)))
    result = ordered_cloud.organise(raw.points, raw.corner())
    off, along = raw.off_and_along(result)
    assert 10.0 < result.largest_hole_mm < 16.0
    assert np.sqrt(np.mean(off**2)) < 0.05
    assert np.sqrt(np.mean(along**2)) < 0.25


@pytest.mark.parametrize("radius", [9.0])
def test_larger_hole_is_refused_with_its_size(radius):
    raw = Raw(Bend(angle_deg=60), 40_000, holes=((80, 40, radius),))
    with pytest.raises(ordered_cloud.PointCloudError, match=r"hole of (\d+\.\d) mm; at most 15 mm") as caught:
        ordered_cloud.organise(raw.points, raw.corner())
    size = float(str(caught.value).split("hole of ")[1].split(" mm")[0])
    assert size == pytest.approx(2 * radius, abs=2.0)  # pixels of 1.5 mm


def test_part_of_the_sheet_is_refused_with_its_size():
    raw = Raw(Bend(), 30_000)
    local = (raw.points - raw.shift) @ raw.turn
    with pytest.raises(ordered_cloud.PointCloudError, match=r"expected 105 to 225 mm"):
        ordered_cloud.organise(local[local[:, 0] < 80])


def test_scan_in_metres_or_of_nothing_is_refused():
    raw = Raw(Bend(), 5_000)
    with pytest.raises(ordered_cloud.PointCloudError, match="millimetres"):
        ordered_cloud.organise(raw.points / 1000)
    with pytest.raises(ordered_cloud.PointCloudError, match="found 100 finite points, expected at least 1500"):
        ordered_cloud.organise(raw.points[:100])
    with pytest.raises(ordered_cloud.PointCloudError, match="shape"):
        ordered_cloud.organise(raw.points[:, :2])
    rng = np.random.default_rng(1)
    with pytest.raises(ordered_cloud.PointCloudError, match=r"do not show the sheet|expected"):
        ordered_cloud.organise(rng.uniform(0, 100, (5_000, 3)))


def test_arc_length_makes_an_uneven_drawing_even():
    # A cylinder drawn with crowded lines: after redrawing, neighbours along a row are equally far apart.
    u, v = np.linspace(0, 1, 34) ** 1.3, np.linspace(0, 1, 23) ** 0.8
    angle, y = np.meshgrid(np.pi * u, 100 * v)
    even = smooth_surface.by_arc_length(np.stack([48 * np.sin(angle), y, 48 * np.cos(angle)]), (30, 45))
    steps = np.linalg.norm(np.diff(even, axis=2), axis=0)
    assert even.shape == (3, *PAPER.grid.shape)
    assert np.ptp(steps) < 0.01 * steps.mean()
    assert steps.mean() == pytest.approx(2 * 48 * np.sin(np.pi / 90), rel=1e-3)
    cylinder = np.stack([48 * np.sin(angle), y, 48 * np.cos(angle)])
    assert smooth_surface.side_lengths_mm(cylinder) == pytest.approx((48 * np.pi, 100.0), rel=1e-4)
