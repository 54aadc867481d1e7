"""Clouds that cannot be of this sheet; hundreds of drawn deformations that can are in tests/sim/surface."""

import numpy as np
import pytest

from eitskin_proto.skin.cloud import flat_cloud
from eitskin_proto.skin.sheet_cloud import check_sheet


def cylinder(angle_deg, stretch=1.0):
    """Return a sheet rolled about y, its front inside for a positive angle."""
    flat = flat_cloud()
    along = stretch * (flat[0] - 75.0)
    curvature = np.deg2rad(angle_deg) / (150.0 * stretch)
    return np.stack([np.sin(curvature * along) / curvature, flat[1], (1.0 - np.cos(curvature * along)) / curvature])


def noisy(cloud, sigma_mm, seed=0):
    return cloud + sigma_mm * np.random.default_rng(seed).standard_normal(cloud.shape)


def moved(cloud):
    turn, _ = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    return np.einsum("ij,jrc->irc", turn, cloud) + np.array([200.0, -90.0, 400.0]).reshape(3, 1, 1)


@pytest.mark.parametrize("sigma_mm", [0.0, 0.1, 0.2])
@pytest.mark.parametrize("cloud", [flat_cloud(), cylinder(90.0), cylinder(180.0, 1.2), moved(cylinder(120.0))])
def test_sheets_pass_without_a_word_in_any_pose(cloud, sigma_mm):
    given = noisy(cloud, sigma_mm)
    found, doubts = check_sheet(given)
    assert doubts == ()
    assert found.dtype == np.float64
    assert np.array_equal(found, given)


def snake(cloud):
    turned = cloud.copy()
    turned[:, ::2] = cloud[:, ::2, ::-1]
    return turned


def exchanged(cloud):
    """Return the sheet with x along the rows, drawn anew with 30 x 45 points."""
    rows, columns = np.meshgrid(np.linspace(0, 44, 30), np.linspace(0, 29, 45), indexing="ij")
    return cloud[:, np.rint(columns).astype(int), np.rint(rows).astype(int)]


def with_outlier(cloud):
    wrong = cloud.copy()
    wrong[:, 12, 20] += [0.0, 3.0, 5.0]
    return wrong


WRONG = {
    "double size": (
        lambda cloud: 2.0 * cloud,
        r"300 mm along x and 200 mm along y, expected 120 to 240 and 75 to 140",
    ),
    "half size": (lambda cloud: 0.5 * cloud, "75 mm along x"),
    "inches": (lambda cloud: cloud / 25.4, "in mm"),
    "noise of a millimetre": (
        lambda cloud: noisy(cloud, 1.0),
        r"\(rms\) off a smooth surface, expected at most 0.5 mm",
    ),
    "nothing but noise": (lambda cloud: noisy(0.0 * cloud, 40.0), "mm along x"),
    "one point away": (with_outlier, "mm off its neighbours"),
    "rows and columns exchanged": (exchanged, "are they exchanged"),
    "read column by column": (lambda cloud: cloud.swapaxes(1, 2).reshape(3, 30, 45), "expected"),
    "every other row reversed": (snake, "expected"),
    "rows in any order": (lambda cloud: cloud[:, np.random.default_rng(2).permutation(30)], "expected"),
    "two rows in each other's place": (lambda cloud: cloud[:, [0, 2, 1, *range(3, 30)]], "are 6.67 mm apart"),
    "a column twice": (lambda cloud: cloud[:, :, [0, *range(44)]], "columns 0 and 1 are 0 mm apart"),
    "one axis missing": (lambda cloud: cloud * np.array([1.0, 0.0, 1.0]).reshape(3, 1, 1), "mm along y"),
    "one place": (lambda cloud: 0.0 * cloud, "0 mm along x"),
    "sheared": (lambda cloud: cloud + np.array([1.2, 0, 0]).reshape(3, 1, 1) * flat_cloud()[1], "expected"),
}


@pytest.mark.parametrize("name", WRONG)
@pytest.mark.parametrize("angle_deg", [1.0, 150.0])
def test_what_no_sheet_can_be_is_refused_with_what_was_found_and_expected(name, angle_deg):
    make, text = WRONG[name]
    with pytest.raises(ValueError, match=text) as caught:
        check_sheet(make(cylinder(angle_deg)))
    assert "\n" not in str(caught.value)


def test_axes_in_another_order_are_named_with_the_call_that_orders_them():
    with pytest.raises(ValueError, match=r"found \(30, 45, 3\): axes are exchanged; give cloud.transpose\(2, 0, 1\)"):
        check_sheet(flat_cloud().transpose(1, 2, 0))
    with pytest.raises(ValueError, match=r"found \(1350, 3\): unordered points\? .*eitskin surface"):
        check_sheet(flat_cloud().reshape(3, -1).T)


def test_what_is_doubtful_is_said_and_used():
    assert "points are 0.3" in check_sheet(noisy(cylinder(90.0), 0.35))[1][0]
    one = cylinder(90.0)
    one[2, 10, 10] += 1.8
    assert check_sheet(one)[1][0].startswith("a point of the cloud is 1.8 mm off its neighbours")
