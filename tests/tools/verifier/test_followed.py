"""Verified touches that move: nearer than each frame alone, not late, and free again where they jump or rest."""

import dataclasses

import numpy as np
import pytest

from eitskin_sim.verification.shape_verdict import ShapeTouch
from eitskin_tools.verifier.followed import FollowedTouches

EVERY_US = 50_000
SPEED_MM_S = np.array([40.0, 30.0])
TOUCH = ShapeTouch(
    shape="rectangle", centre_mm=(0.0, 0.0), centre_error_mm=(0.6, 0.6), size_mm=(10.0, 10.0),
    size_error_mm=(1.0, 1.0), angle_deg=0.0, area_mm2=100.0, area_error_mm2=1.0, contrast=2.0,
    contrast_range=(1.5, 3.0), border_mm=0.0, strength_mm2=69.0, strength_error_mm2=1.0, area_range_mm2=(80.0, 120.0),
    size_contrast_correlation=-0.9, angle_error_deg=None,
)  # fmt: skip


def touch_at(place_mm):
    return dataclasses.replace(TOUCH, centre_mm=tuple(place_mm))


def test_a_touch_that_moves_is_nearer_for_the_verdicts_before_and_not_late():
    rng, alone, together = np.random.default_rng(4), [], []
    for _ in range(40):
        followed = FollowedTouches()
        for number in range(20):
            place = np.array([20.0, 20.0]) + SPEED_MM_S * number * EVERY_US * 1e-6
            noise = 0.6 * rng.standard_normal(2)
            (found,) = followed.follow([touch_at(place + noise)], number * EVERY_US)
            if number > 3:
                alone.append(noise)
                together.append(np.array(found.centre_mm) - place)
    assert np.mean(np.square(together)) < 0.7 * np.mean(np.square(alone))
    assert abs(np.mean(np.array(together) @ SPEED_MM_S)) / 50.0**2 < 2e-3, "2 ms late"


def test_two_touches_that_move_are_not_exchanged_and_a_new_one_is_where_its_frame_has_it():
    followed = FollowedTouches()
    for number in range(5):
        found = followed.follow(
            [touch_at((20.0 + number, 30.0)), touch_at((60.0, 30.0 + number))][:: 1 - 2 * (number % 2)],
            (number + 1) * EVERY_US,
        )
    assert sorted(one.centre_mm for one in found) == [
        pytest.approx((24.0, 30.0), abs=0.05),
        pytest.approx((60.0, 34.0), abs=0.05),
    ]
    found = followed.follow([touch_at((100.0, 80.0))], 6 * EVERY_US)
    assert found[0].centre_mm == (100.0, 80.0)


@pytest.mark.parametrize(("place", "passed_us", "fused"), [((24.0, 36.0), EVERY_US, 1), ((21.0, 30.0), EVERY_US, 4),
                                                          ((21.0, 30.0), -EVERY_US, 1)])  # fmt: skip
def test_a_jump_a_mean_and_a_clock_that_began_again_are_taken_as_they_are(place, passed_us, fused):
    followed = FollowedTouches()
    for number in range(8):
        followed.follow([touch_at((20.0, 30.0))], 10**9 + number * EVERY_US)
    (found,) = followed.follow([touch_at(place)], 10**9 + 7 * EVERY_US + passed_us, fused)
    assert found.centre_mm == place
