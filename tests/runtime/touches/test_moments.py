"""Centre, area and axes against closed forms, the sheet's mirrors, and maps that nobody should send."""

import numpy as np
import pytest

from eitskin.touches.moments import MOST_TOUCHES, TouchFinder
from eitskin.touches.pieces import HALF, SADDLE, pieces

from .scripted import DX, DY, GRID, box, ellipse, gaussian, square

RNG = np.random.default_rng(0)


@pytest.fixture(scope="module")
def finder():
    return TouchFinder(GRID)


def only(found):
    assert found.count == 1
    return found.numbers[:, 0]


@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.7, 0.0), (1.1, 2.9), (1.67, 1.67)])
def test_a_square_of_whole_pixels_has_its_place_and_area_exactly_wherever_it_lies(finder, shift):
    x, y = 50.0 + shift[0], 40.0 + shift[1]
    found = only(finder.find(square(x, y)))
    assert found[:2] == pytest.approx((x, y), abs=1e-9)
    assert found[5] == pytest.approx(100.0, abs=1e-9)
    assert found[6] == pytest.approx(1.0)


def test_axes_are_right_on_average_over_where_a_touch_lies(finder):
    """The p^2 / 12 that is taken off is what pixels add on average: for one 10 mm square it errs by p^2 / 6 at most."""
    sides, discs = [], []
    for _ in range(300):
        x, y = RNG.uniform((50, 40), (50 + DX, 40 + DY))
        sides.append(only(finder.find(square(x, y)))[2:4] ** 2 / 16)
    sides = np.array(sides)
    assert sides.mean() == pytest.approx(100 / 12, rel=0.02)
    assert np.abs(sides - 100 / 12).max() <= DX**2 / 6 + 1e-9
    for _ in range(40):
        x, y = RNG.uniform((50, 40), (50 + DX, 40 + DY))
        discs.append(only(finder.find(ellipse(x, y, 5.0, 5.0)))[2:4])
    assert np.mean(discs) == pytest.approx(10.0, rel=0.02)


@pytest.mark.parametrize("lean", [1e-16, 1e-9, 1e-7, 1e-5])
def test_an_angle_is_below_pi_in_a_message_too(finder, lean):
    leaning = np.zeros(GRID.shape)
    leaning[14:16, 10:20] = 1.0
    leaning[14, 15:] += lean  # the axis turns against the clock by next to nothing
    angle = only(finder.find(leaning))[4]
    assert 0.0 <= float(np.float32(angle)) < np.pi
    assert np.sin(angle) == pytest.approx(0.0, abs=1e-5)


@pytest.mark.parametrize("angle", [0.3, 1.2, 2.5])
def test_an_ellipse_lies_as_it_lies(finder, angle):
    found = only(finder.find(ellipse(70.0, 50.0, 20.0, 8.0, angle)))
    assert found[2:4] == pytest.approx((40.0, 16.0), rel=0.01)
    assert found[4] == pytest.approx(angle, abs=0.01)
    assert found[5] == pytest.approx(np.pi * 160.0, rel=0.005)


def test_a_soft_touch_has_its_place(finder):
    for _ in range(20):
        x, y = RNG.uniform((40, 40), (60, 60))
        assert only(finder.find(gaussian(x, y, 5.0)))[:2] == pytest.approx(
            (x, y), abs=0.4
        )  # cut off right around the half height


def test_touches_10_mm_apart_are_two_though_the_map_joins_them(finder):
    """What lies right between two touches belongs to both by equal parts."""
    middle = 15.5 * DX
    bridge = 0.74 * box(middle - 5, 45.0, middle + 5, 55.0)
    bridge -= 0.05 * box(middle - DX / 2, 45.0, middle + DX / 2, 55.0)
    image = np.maximum.reduce([square(middle - 10, 50.0), square(middle + 10, 50.0), bridge])
    found = finder.find(image).numbers
    assert found.shape[1] == 2
    assert found[0].sum() == pytest.approx(2 * middle, abs=1e-9)  # mirror images of each other
    assert found[5, 0] == pytest.approx(found[5, 1])
    shallow = np.maximum(image, (1.01 - SADDLE) * box(middle - 10, 45.0, middle + 10, 55.0))
    assert finder.find(shallow).count == 1


def test_pieces_are_those_of_scipy_where_no_saddle_divides_them():
    ndimage = pytest.importorskip("scipy.ndimage", reason="it labels pieces independently")
    for _ in range(500):
        rows, columns = RNG.integers(1, 12, 2)
        image = np.minimum(RNG.random((rows, columns)) * RNG.choice([0.6, 0.8, 1.0]), HALF + SADDLE - 0.01)
        at, of, count = pieces(np.pad(image, 1).ravel(), columns + 2)
        labels, expected = ndimage.label(np.pad(image, 1) >= HALF)
        got = np.zeros(labels.size, dtype=int)
        got[at] = of + 1
        assert count == expected
        assert (got.reshape(labels.shape) == labels).all()


HOSTILE = {
    "ones": np.ones(GRID.shape),
    "checkerboard": np.indices(GRID.shape).sum(axis=0) % 2.0,
    "noise": np.random.default_rng(1).random(GRID.shape),
    "uneven": 0.5 + 0.5 * np.random.default_rng(2).random(GRID.shape),
    "large": np.full(GRID.shape, 1e30),
    "not a number": np.full(GRID.shape, np.nan),
    "one infinite": np.where(np.arange(1350).reshape(GRID.shape) == 700, np.inf, 0.3),
    "below zero": -np.ones(GRID.shape),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_maps_give_few_and_finite_touches(finder, name):
    found = finder.find(HOSTILE[name])
    assert found.count <= MOST_TOUCHES
    assert np.isfinite(found.numbers).all()
    assert (found.numbers[5] >= 0).all()
    assert ((found.numbers[4] >= 0) & (found.numbers[4] < np.pi)).all()
    if name == "checkerboard":
        assert (found.count, found.more) == (MOST_TOUCHES, 675 - MOST_TOUCHES)


def test_the_largest_are_listed_where_there_are_too_many(finder):
    image = np.zeros(GRID.shape)
    image[1::3, 1::3] = 0.7
    image[4, 4:6] = image[25, 40:42] = 1.0
    found = finder.find(image)
    assert found.count == MOST_TOUCHES
    assert found.more == 150 - MOST_TOUCHES
    assert np.sort(found.numbers[5])[-2:] == pytest.approx(2 * GRID.pixel_mm2)
