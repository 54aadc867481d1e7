"""Predictions that cannot be; those of drawn deformations, which can, are in tests/sim/surface."""

import numpy as np
import pytest

from eitskin.model.bundle import load_bundle
from eitskin.reference.captured import Reference
from eitskin.reference.plausible import check_prediction
from eitskin_proto.skin.cloud import flat_cloud

RNG = np.random.default_rng(11)


@pytest.fixture(scope="module")
def flat():
    """Return (104,) V of the forward model's flat sheet under 1 A, as every shipped bundle has it."""
    return np.asarray(load_bundle().consistency_arrays()["reference"], dtype=np.float64)


def captured(voltages, spread=3e-3):
    return Reference(voltages, spread * np.abs(voltages), 100, "TEST-1", 0xABCD, "paper", "")


def stretched(x=1.0, y=1.0):
    return flat_cloud() * np.array([x, y, 1.0]).reshape(3, 1, 1)


def test_the_flat_sheets_own_voltages_pass(flat):
    check_prediction(flat_cloud(), flat, flat, None)
    check_prediction(flat_cloud(), flat, flat, captured(1e-3 * flat))
    check_prediction(flat_cloud(), flat, None, captured(flat))
    check_prediction(flat_cloud(), flat, None, captured(-flat))  # a front end of the other polarity
    check_prediction(flat_cloud(), flat, None, None)  # nothing to hold it against; the runtime says so elsewhere


def test_a_stretched_sheet_reads_as_much_more_as_its_size_explains(flat):
    check_prediction(stretched(y=1.2), flat * 1.2**1.88, flat, None)
    with pytest.raises(ValueError, match=r"predicted is 1 times predicted_flat .* expected 1.1 to 1.81 times"):
        check_prediction(stretched(y=1.2), flat, flat, None)


def one_row(factor):
    return np.where(np.arange(104) == 40, factor, 1.0)


WRONG = {
    "zeros": (0.0, "predicted is 0 times predicted_flat"),
    "the other sign": (-1.0, "predicted is -1 times"),
    "of another scale": (1e-3, "predicted is 0.001 times"),
    "half as large again": (1.5, "predicted is 1.5 times"),
    "one row of nothing": (one_row(0.0), r"predicted\[40\] is 0 times predicted_flat, expected 0.08 to 6"),
    "one row of the other sign": (one_row(-1.0), r"predicted\[40\] is -1 times"),
    "one row far too large": (one_row(20.0), r"predicted\[40\] is 20 times"),
    "next to infinite": (1e300, "times"),
    "denormal": (1e-310, "times"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_no_deformation_does_is_refused(flat, name):
    factor, text = WRONG[name]
    with pytest.raises(ValueError, match=text) as caught:
        check_prediction(flat_cloud(), flat * factor, flat, captured(1e-3 * flat))
    assert "predicted_flat, its own V of the flat sheet" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_prediction_under_one_ampere_is_not_held_against_a_reference_under_a_milliampere(flat):
    with pytest.raises(ValueError, match=r"predicted is 1e\+03 times the captured reference .*predicted_flat"):
        check_prediction(flat_cloud(), flat, None, captured(1e-3 * flat))


def test_rows_in_another_order_are_refused_with_or_without_the_models_flat_sheet(flat):
    mixed = RNG.permutation(flat)
    with pytest.raises(ValueError, match="expected"):
        check_prediction(flat_cloud(), mixed, flat, None)
    with pytest.raises(ValueError, match=r"differs from the captured reference by .* in the median row"):
        check_prediction(flat_cloud(), mixed, mixed, captured(1e-3 * flat))


@pytest.mark.parametrize("value", [0.0, 5e-324, 1e308])
def test_a_flat_sheet_without_voltages_is_refused(flat, value):
    with pytest.raises(ValueError, match="predicted_flat holds no voltage"):
        check_prediction(flat_cloud(), flat, np.full(104, value), None)
