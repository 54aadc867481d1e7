import numpy as np
import pytest

from eitskin_proto.sensor.normalise import RATIO_FLOOR, log_prediction


def test_what_both_voltages_have_in_common_drops_out() -> None:
    reference = np.array([1e-3, -2e-3, 5e-2])
    np.testing.assert_allclose(log_prediction(-7.0 * np.exp([0.1, -0.2, 0.0]) * reference, reference),
                               np.log(7.0) + np.array([0.1, -0.2, 0.0]), rtol=1e-6)  # fmt: skip


@pytest.mark.parametrize("predicted", [0.0, 1e-9])
def test_a_prediction_of_nothing_is_cut_off_at_the_floor(predicted: float) -> None:
    assert log_prediction(np.array([predicted]), np.array([1.0]))[0] == pytest.approx(np.log(RATIO_FLOOR))


def test_a_row_without_a_reference_says_nothing() -> None:
    assert log_prediction(np.array([0.3, 1.0]), np.array([0.0, 1.0])).tolist() == [0.0, 0.0]


def test_many_sheets_at_once_give_a_row_each_in_single_precision() -> None:
    found = log_prediction(np.ones((5, 104)), np.full(104, 2.0))
    assert (found.shape, found.dtype) == ((5, 104), np.float32)
