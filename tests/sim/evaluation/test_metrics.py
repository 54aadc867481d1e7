"""The measures of a map: closed forms, degenerate maps and properties."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from eitskin_proto.skin.skin import PAPER
from eitskin_sim.evaluation import metrics
from eitskin_sim.scene.area import area_map
from eitskin_sim.scene.parts import Touch
from eitskin_sim.scene.shapes import Rect

GRID = PAPER.grid

maps = hnp.arrays(np.float64, GRID.shape, elements=st.floats(0.0, 1.0, width=32))


def block(rows: slice, columns: slice, value: float = 1.0) -> np.ndarray:
    image = np.zeros(GRID.shape)
    image[rows, columns] = value
    return image


def units(*indices: int) -> np.ndarray:
    bits = np.zeros(126)
    bits[list(indices)] = 1.0
    return np.asarray(GRID.map_from_units(bits), dtype=np.float64)


def test_perfect_map_has_every_perfect_score():
    truth = units(20, 80)
    result = metrics.score(truth, truth)
    assert result.cc == pytest.approx(1.0, abs=1e-12)
    assert (result.psnr_db, result.rie, result.localisation_mm, result.exact) == (metrics.PSNR_CAP_DB, 0.0, 0.0, 1.0)
    assert result.touches == 2


def test_psnr_and_rie_agree_with_the_paper_on_its_own_table():
    # Table II, phantom 1, VD2T: PSNR 38.9502 dB and RIE 0.0737 belong together only for peak 1 and about 32 touched
    # pixels of 1350. Build such a map: an error of one size over everything.
    touched = 32
    truth = np.zeros(1350)
    truth[:touched] = 1.0
    error = 0.0737 * math.sqrt(touched / 1350)
    image = (truth + error * np.where(np.arange(1350) % 2, 1.0, -1.0)).reshape(GRID.shape)
    truth = truth.reshape(GRID.shape)
    assert metrics.relative_image_error(image, truth) == pytest.approx(0.0737, rel=1e-12)
    assert metrics.psnr_db(image, truth) == pytest.approx(38.9502, abs=0.1)


def test_correlation_has_the_closed_form_of_two_overlapping_sets():
    # Two indicator maps of n pixels each that share k of N: CC = (k - n^2/N) / (n - n^2/N).
    first, second = block(slice(0, 4), slice(0, 10)), block(slice(0, 4), slice(5, 15))
    n, k, total = 40, 20, 1350
    expected = (k - n * n / total) / (n - n * n / total)
    assert metrics.correlation(first, second) == pytest.approx(expected, rel=1e-12)


@given(maps, maps, st.floats(0.01, 100.0), st.floats(-10.0, 10.0))
@settings(max_examples=50, deadline=None)
def test_correlation_is_symmetric_bounded_and_blind_to_scale_and_offset(a, b, scale, offset):
    value = metrics.correlation(a, b)
    assert -1.0 <= value <= 1.0
    assert metrics.correlation(b, a) == pytest.approx(value, abs=1e-12)
    if a.std() > 1e-3:  # an offset swallows contrasts below its own rounding
        assert metrics.correlation(scale * a + offset, b) == pytest.approx(value, abs=1e-9)


@given(maps, maps)
@settings(max_examples=50, deadline=None)
def test_psnr_and_rie_are_the_same_error_in_two_scales(image, truth):
    size = np.linalg.norm(truth)
    rie, psnr = metrics.relative_image_error(image, truth), metrics.psnr_db(image, truth)
    if size > 1e-3 and rie > 0.0 and psnr < metrics.PSNR_CAP_DB:
        assert psnr == pytest.approx(-10 * math.log10((rie * size) ** 2 / image.size), abs=1e-9)


def test_untouched_truth_is_scored_without_dividing_by_zero():
    empty, ghost = np.zeros(GRID.shape), units(60)
    right, wrong = metrics.score(empty, empty), metrics.score(ghost, empty)
    assert (right.cc, right.rie, right.localisation_mm, right.exact) == (1.0, 0.0, 0.0, 1.0)
    assert (wrong.cc, wrong.rie, wrong.exact) == (0.0, math.inf, 0.0)
    assert wrong.localisation_mm == metrics.lost_mm(PAPER.grid)


def test_missed_and_ghost_touches_both_cost():
    two = block(slice(5, 8), slice(5, 8)) + block(slice(20, 23), slice(30, 33))
    one = block(slice(5, 8), slice(5, 8))
    away = GRID.pitch_mm * math.hypot(15, 25)
    assert metrics.localisation_error_mm(one, two) == pytest.approx(away / 4, rel=1e-9)
    assert metrics.localisation_error_mm(two, one) == pytest.approx(away / 4, rel=1e-9)


def test_one_wrong_unit_of_five_is_not_exact():
    assert metrics.is_exact(units(3, 17, 60), units(3, 17, 60))
    assert not metrics.is_exact(units(3, 17, 61), units(3, 17, 60))
    soft = 0.6 * units(3, 17, 60) + 0.2
    assert metrics.is_exact(soft, units(3, 17, 60))


def test_area_map_is_exact_within_a_pixel_and_not_beyond():
    truth = block(slice(10, 13), slice(10, 13)) + block(slice(20, 23), slice(30, 33))
    assert metrics.is_exact(np.roll(truth, 1, axis=1), truth, labels="area")
    assert not metrics.is_exact(np.roll(truth, 2, axis=1), truth, labels="area")
    assert not metrics.is_exact(block(slice(10, 13), slice(10, 13)), truth, labels="area")


def test_two_point_distance_is_between_borders_and_below_a_pixel_in_resolution():
    # 27 empty pixels of 10/3 mm between two touches are the paper's 90 mm.
    image = block(slice(10, 13), slice(3, 6)) + block(slice(10, 13), slice(33, 36))
    assert metrics.two_point_distance_mm(image) == pytest.approx(90.0, rel=1e-12)
    assert metrics.score(image, image).distance_error == 0.0
    # A pixel a quarter covered beside a full one moves the crossing of one half by 1/6 of a pitch.
    image[10:13, 6] = 0.25
    assert metrics.two_point_distance_mm(image) == pytest.approx(90.0 - GRID.pitch_mm * (2 / 3 - 1 / 2), rel=1e-9)


@pytest.mark.parametrize(("x", "y"), [(0.0, 0.0), (0.9, 1.6), (1.7, 2.4), (3.2, 0.1)])
def test_place_of_a_touch_is_its_centre_wherever_it_lies_on_the_grid(x, y):
    truth = area_map([Touch((Rect(50.0 + x, 40.0 + y, 60.0 + x, 50.0 + y),))])
    assert metrics.touch_centres_mm(truth) == pytest.approx(np.array([[55.0 + x, 45.0 + y]]), abs=1e-9)


def test_rim_between_two_touches_goes_to_the_nearer_and_none_is_counted_twice():
    image = block(slice(10, 13), slice(10, 13)) + block(slice(10, 13), slice(15, 18))
    image[10:13, 13] = image[10:13, 14] = 0.4
    centres = metrics.touch_centres_mm(image)
    expected = GRID.pitch_mm * np.array(
        [(10.5 + 11.5 + 12.5 + 0.4 * 13.5) / 3.4, (15.5 + 16.5 + 17.5 + 0.4 * 14.5) / 3.4]
    )
    assert centres[:, 0] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (np.zeros((45, 30)), "shape"),
        (np.full(GRID.shape, np.nan), "finite"),
        (np.full(GRID.shape, np.inf), "finite"),
    ],
)
def test_malformed_maps_are_refused(image, message):
    with pytest.raises(ValueError, match=message):
        metrics.score(image, np.zeros(GRID.shape))
