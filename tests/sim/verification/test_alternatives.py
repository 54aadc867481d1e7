"""Other touches that may explain a frame better: usual contrasts, two in place of one, and one body."""

import numpy as np
import pytest
from tests.sim.verification.frames import ELL, NOTHING, SQUARE, changed, frame_of, shares_of

from eitskin_sim.scene.touch_table import ELLIPSE, RECTANGLE
from eitskin_sim.verification import alternatives
from eitskin_sim.verification.fit import Budget, refine

BETWEEN = np.array([[0, 60.0, 45.0, 16.0, 11.0, 0.0, 60.0, 0.0]])
PAIR = np.array([[0, x, 45.0, 10.0, 10.0, 0.0, 60.0, 0.0] for x in (50.0, 70.0)])


def budget() -> Budget:
    return Budget(100.0, lambda: 0.0)


@pytest.mark.parametrize("contrast", [2.5])
def test_two_touches_are_found_where_one_lies_between(contrast: float) -> None:
    """One of a weaker contrast, too, as it comes out where it is stretched over both."""
    between = BETWEEN.copy()
    between[0, 6] = contrast
    frame = frame_of(PAIR)
    found = alternatives.two_in_place_of_one(frame, frame.at(between), shares_of(), budget())
    order = np.argsort(found.pieces[:, 1])
    assert found.pieces[order, 1:5] == pytest.approx(PAIR[:, 1:5], abs=1.0)


def test_a_long_weak_touch_is_two_usual_ones() -> None:
    """A rectangle over both, at a contrast of 2, explains the frame nearly as well."""
    frame = frame_of(PAIR)
    one = refine(frame, frame.at(np.array([[0, 60.0, 45.0, 32.0, 14.0, 0.0, 2.2, 0.0]])), 8)
    found = alternatives.two_in_place_of_one(frame, one, shares_of(), budget())
    assert found.cost < one.cost
    assert np.sort(found.pieces[:, 1]) == pytest.approx(PAIR[:, 1], abs=1.5)


@pytest.mark.parametrize("length", [11.0, 24.0])
def test_one_touch_stays_one(length: float) -> None:
    one = np.array([[0, 60.0, 45.0, length, 11.0, 0.0, 60.0, 0.0]])
    frame = frame_of(one)
    for fit in (frame.at(one), frame_of(NOTHING).at(NOTHING)):
        assert alternatives.two_in_place_of_one(frame, fit, shares_of(), budget()) is fit


@pytest.mark.parametrize("explained", [False, True])
def test_a_touch_that_explains_its_frame_and_that_the_network_shows_as_large_is_one(explained: bool) -> None:
    frame, time = frame_of(BETWEEN if explained else PAIR), budget()
    fit = frame.at(BETWEEN)
    found = alternatives.two_in_place_of_one(frame, fit, shares_of(BETWEEN), time)
    assert (found is fit) is explained
    assert (time.fits == 0) is explained


def test_an_ellipse_that_lies_across_is_no_rectangle() -> None:
    """A large one, whose frame a rectangle does not explain."""
    truth = np.array([[ELLIPSE, 75.0, 48.0, 56.0, 30.0, 30.0, 50.0, 0.0]])
    frame = frame_of(truth)
    rectangle = refine(frame, frame.at(changed(truth, length=-4.0, width=-2.0) * [RECTANGLE, *[1.0] * 7], True), 10)
    found = alternatives.as_ellipses(frame, rectangle, budget())
    assert not rectangle.explains
    assert found.explains
    assert found.pieces[0, :6] == pytest.approx(truth[0, :6], abs=1.5)
    assert alternatives.as_ellipses(frame, found, budget()) is found


def test_a_touch_that_shrank_to_next_to_nothing_is_left_out_unless_the_frame_needs_it() -> None:
    ghost = np.array([[0, 100.0, 60.0, 3.0, 3.0, 0.0, 20.0, 0.0]])
    frame = frame_of(SQUARE, n_shown=2)
    found = alternatives.without_smallest(frame, frame.at(np.vstack([SQUARE, ghost])), budget())
    assert found.pieces[:, 1:3] == pytest.approx(SQUARE[:, 1:3], abs=0.5)
    needed = np.vstack([SQUARE, ghost * [1, 1, 1, 1, 1, 1, 10, 1] + [0, -85, -20, 0, 0, 0, 0, 0]])
    frame = frame_of(needed, n_shown=2)
    assert len(alternatives.without_smallest(frame, frame.at(needed), budget()).pieces) == 2


def test_what_is_as_strong_at_the_usual_contrast_is_found_along_the_valley() -> None:
    frame = frame_of(SQUARE)
    weak = alternatives.scaled_to_contrast(SQUARE, np.log([3.0]))
    begun = refine(frame, frame.at(weak), 2)
    found = alternatives.of_usual_contrast(frame, begun, budget())
    assert found.cost < begun.cost
    assert found.pieces[0, 3:5] == pytest.approx(SQUARE[0, 3:5], abs=1.5)


def test_what_the_network_shows_as_one_is_one_body_unless_the_frame_speaks_against_it() -> None:
    closed = ELL.copy()
    closed[1, [1, 3]] += -0.5, 1.0
    apart = ELL.copy()
    apart[1, 1] += 1.5  # a gap of 2.5 mm, and another contrast beyond it
    apart[1, 6] = 5.0
    for touches, joined in ((closed, True), (apart, False)):
        frame = frame_of(touches, n_shown=2)
        fit = refine(frame, frame.at(touches), 8)
        found = alternatives.as_one_body(frame, fit, shares_of(ELL), budget())
        assert (found.frame.joints == ((1, 0),)) is joined
        assert joined or found is fit
    assert alternatives.as_one_body(frame, fit, shares_of(*ELL), budget()) is fit
