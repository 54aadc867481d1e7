"""Poses by closed forms: quarter turns, tables of quaternions, rigid motions; and what is refused."""

import math

import numpy as np
import pytest

from eitskin.robot.pose import Pose
from eitskin.touches.touch import Touch

HALF = math.sqrt(0.5)
QUARTER_ABOUT_Z = [HALF, 0.0, 0.0, HALF]


def test_a_quarter_turn_about_z_takes_x_to_y_and_y_to_minus_x():
    pose = Pose.of(quaternion_wxyz=QUARTER_ABOUT_Z, translation_mm=[10.0, 20.0, 30.0])
    np.testing.assert_allclose(pose.place([[1.0, 0.0, 0.0], [0.0, 2.0, 0.0]]), [[10, 21, 30], [8, 20, 30]], atol=1e-12)
    np.testing.assert_allclose(pose.direction([1.0, 0.0, 0.0]), [0.0, 1.0, 0.0], atol=1e-12)


@pytest.mark.parametrize("seed", range(8))
def test_a_quaternion_and_the_matrix_that_it_means_are_one_rotation(seed):
    rng = np.random.default_rng(seed)
    axis = rng.standard_normal(3)
    axis /= np.linalg.norm(axis)
    angle = rng.uniform(-np.pi, np.pi) if seed else np.pi  # half a turn has no real part
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    rodrigues = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    quaternion = [np.cos(angle / 2), *(np.sin(angle / 2) * axis)]
    of_quaternion, of_matrix = Pose.of(quaternion_wxyz=quaternion), Pose.of(rotation=rodrigues.tolist())
    np.testing.assert_allclose(of_quaternion.rotation, rodrigues, atol=1e-12)
    np.testing.assert_allclose(of_matrix.rotation, rodrigues, atol=1e-12)


def test_a_touch_is_moved_and_all_else_of_it_stays():
    touch = Touch(
        3, 0, 1.5, (4.0, 5.0), (10.0, 8.0), 0.1, 80.0, 0.9, None, None, (1.0, 0.0, 2.0), (0.0, 0.0, 1.0), 81.0
    )
    tilted = Pose.of(rotation=[[1, 0, 0], [0, 0, -1], [0, 1, 0]], translation_mm=[100, 0, 0]).touch(touch)
    assert tilted.place_mm == pytest.approx((101.0, -2.0, 0.0))
    assert tilted.normal == pytest.approx((0.0, -1.0, 0.0))
    assert (tilted.id, tilted.centre_mm, tilted.surface_mm2) == (3, (4.0, 5.0), 81.0)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, -1]]}, "determinant -1, expected \\+1: it is a mirror"),
        ({"rotation": [[1, 0, 0], [0, 1, 0], [0, 0.1, 1]]}, "off the unit matrix by 0.1"),
        ({"rotation": [[2, 0, 0], [0, 2, 0], [0, 0, 2]]}, "an entry of 2, expected -1 to 1"),
        ({"rotation": [[0, 0, 0], [0, 0, 0], [0, 0, 0]]}, "not a rotation"),
        ({"rotation": [[1, 0], [0, 1]]}, "expected 3 x 3 finite numbers, found 2 x 2"),
        ({"rotation": [[1, 0, 0], [0, 1], [0, 0, 1]]}, "found something else"),
        ({"quaternion_wxyz": [1, 1, 0, 0]}, "the length 1.414, expected 1"),
        ({"quaternion_wxyz": [0, 0, 0, 0]}, "the length 0, expected 1"),
        ({"quaternion_wxyz": "wxyz"}, "found something else"),
        ({"quaternion_wxyz": [math.nan, 0, 0, 0]}, "found one that is not"),
        ({"translation_mm": [0, 0, math.inf]}, "found one that is not"),
        ({"translation_mm": [0, 0, 1e300]}, "expected mm of at most"),
        ({"translation_mm": 5}, "found one"),
        ({"rotation": np.eye(3), "quaternion_wxyz": [1, 0, 0, 0]}, "expected one of them"),
    ],
)
def test_what_is_no_pose_is_refused_in_a_line(given, said):
    with pytest.raises(ValueError, match=said) as raised:
        Pose.of(**given)
    assert "\n" not in str(raised.value)
