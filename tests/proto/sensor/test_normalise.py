import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eitskin_proto.sensor.normalise import (
    RATIO_FLOOR,
    WEAK_FRACTION,
    inverse_reference,
    log_prediction,
    relative_change,
    weak_rows,
)

REFERENCE = np.array([2.0, -4.0, 0.5])


def test_relative_change_is_the_difference_over_the_reference():
    assert relative_change(np.array([1.0, -5.0, 0.5]), REFERENCE).tolist() == [-0.5, 0.25, 0.0]


def test_an_untouched_sheet_gives_zero():
    # One rounding of 1 / V0 and one of the product: 2 ulp.
    reference = np.random.default_rng(0).uniform(0.1, 3.0, 104)
    assert np.abs(relative_change(reference, reference)).max() < 5e-16


@given(st.floats(1e-6, 1e6), st.booleans())
def test_the_current_and_the_sign_of_the_drive_cancel(scale, flip):
    factor = -scale if flip else scale
    voltages = np.array([1.0, -5.0, 0.7])
    assert np.allclose(
        relative_change(factor * voltages, factor * REFERENCE), relative_change(voltages, REFERENCE), rtol=0, atol=1e-14
    )


@pytest.mark.parametrize("bad", [0.0, 1e-12, -1e-12, np.nan, np.inf, -np.inf])
def test_a_weak_row_is_named_and_gives_zero_and_never_inf(bad):
    reference = np.array([1.0, bad, -1.0])
    assert weak_rows(reference).tolist() == [False, True, False]
    change = relative_change(np.array([0.5, 7.0, -0.5]), reference)
    assert change.tolist() == [-0.5, 0.0, -0.5]
    assert inverse_reference(reference)[1] == 0.0


def test_the_bound_of_a_weak_row_is_exact():
    assert weak_rows(np.array([1.0, WEAK_FRACTION, WEAK_FRACTION * 0.999])).tolist() == [False, False, True]


@pytest.mark.parametrize("reference", [np.zeros(3), np.full(3, np.nan)])
def test_a_reference_of_nothing_is_refused(reference):
    with pytest.raises(ValueError, match="reference of zeros"):
        relative_change(np.ones(3), reference)


@pytest.mark.parametrize("largest", [5e-324, 1e-310, 1e-200, 1e200, 1e308])
def test_reference_that_no_front_end_can_read_is_refused_with_its_bounds(largest):
    # 1 / 1e-310 overflows: every dV would be infinite, with a warning as the only sign of it.
    with pytest.raises(ValueError, match="expected 1e-30 to 1e\\+30 V"):
        inverse_reference(np.linspace(0.1, 1.0, 104) * largest)


@pytest.mark.parametrize("predicted", [0.0, 1e-9])
def test_a_prediction_of_nothing_is_cut_off_at_the_floor(predicted: float) -> None:
    assert log_prediction(np.array([predicted]), np.array([1.0]))[0] == pytest.approx(np.log(RATIO_FLOOR))


def test_a_row_without_a_reference_says_nothing() -> None:
    assert log_prediction(np.array([0.3, 1.0]), np.array([0.0, 1.0])).tolist() == [0.0, 0.0]
