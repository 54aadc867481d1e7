"""Orders of rows are named from levels: of an ideal disc cut square, whose levels have a closed form."""

import numpy as np
import pytest

from eitskin_proto.sensor.table import FULL_TABLE, N_ELECTRODES, ROW_IN_FULL, TABLE
from eitskin_proto.sensor.wiring import lag_of, read_wiring

PLACES = 2.0 * np.pi * np.arange(16) / 16 + 0.08 * np.sin(np.arange(16) ** 2)
"""Angles of electrodes, uneven so that every order has levels of its own."""


def levels(table, places=PLACES):
    """Voltages of point electrodes on the rim of a disc: logarithms of distances."""
    at = np.exp(1j * places)
    apart = np.abs(at[:, None] - at) + np.eye(N_ELECTRODES)
    potential = -2.0 * np.log(apart)
    a, b = table.astype(int).T
    c, d = (a + 1) % N_ELECTRODES, (b + 1) % N_ELECTRODES
    return potential[a, b] - potential[a, d] - potential[c, b] + potential[c, d]


MODEL = levels(TABLE)


def measured(volts, seed=0, noise=0.03):
    rng = np.random.default_rng(seed)
    return volts * (1.0 + noise * rng.standard_normal(volts.shape))


@pytest.mark.parametrize("seed", range(3))
def test_rows_in_order_are_right_whatever_their_factor_offset_and_sign(seed):
    for volts, noise in ((MODEL, 0.03), (0.01 * MODEL + 0.1 * MODEL.mean(), 1e-3), (levels(FULL_TABLE), 0.03)):
        found = read_wiring(measured(volts, seed, noise), MODEL)
        assert found.right
        assert not found.inverted
        assert found.rank_correlation > 0.9
    inverted = read_wiring(measured(-MODEL, seed), MODEL)
    assert inverted.right
    assert inverted.inverted
    assert "inverted signs" in inverted.text


@pytest.mark.parametrize(
    ("volts", "said"),
    [
        (np.roll(MODEL, 1), "readings come 1 row late"),
        (np.roll(MODEL, -2), "readings come 2 rows early"),
        (levels((TABLE.astype(int) + 3) % 16), "electrode 0 is at the place of 3"),
        (levels((5 - TABLE.astype(int)) % 16), "electrodes run clockwise from the place of 6"),
        (levels(np.array(sorted(FULL_TABLE.tolist()))), "pyEIT's order"),
        (np.roll(levels(FULL_TABLE), 1), "readings come 1 row late"),
        (np.random.default_rng(3).permutation(MODEL), "no known order"),
    ],
)
def test_a_known_order_is_named(volts, said):
    found = read_wiring(measured(np.tile(volts, (5, 1)), 4), MODEL)
    assert not found.right
    assert said in found.text


def test_a_ring_that_only_runs_clockwise_is_named_among_those_with_the_same_levels():
    quarter = np.radians([10.0, 35.0, 50.0, 80.0])
    places = np.sort(np.concatenate([quarter, np.pi - quarter, np.pi + quarter, 2.0 * np.pi - quarter]))
    places = np.roll(places, 3)
    found = read_wiring(measured(levels((15 - TABLE.astype(int)) % 16, places)), levels(TABLE, places))
    assert "electrodes run clockwise from the place of 0" in found.text


def test_a_failed_electrode_is_not_a_wrong_order():
    volts, rng = measured(MODEL), np.random.default_rng(5)
    failed = np.isin(TABLE, (3, 4)).any(axis=1)
    volts[failed] *= rng.lognormal(0.0, 2.0, failed.sum())
    assert read_wiring(volts, MODEL).right


def test_a_front_end_that_is_not_four_wire_is_said_to_be_so():
    drop = 60.0 * np.linspace(1.0, 3.0, 16)[TABLE[:, 0]] * np.abs(MODEL).mean()
    found = read_wiring(measured(np.sign(MODEL) * drop + MODEL), MODEL)
    assert not found.right
    assert "not those of a sheet read by four wires" in found.text


def test_reciprocal_rows_are_compared():
    full = levels(FULL_TABLE)
    assert read_wiring(full, MODEL).reciprocity == pytest.approx(0.0, abs=1e-12)
    full[ROW_IN_FULL] *= 1.1
    assert read_wiring(full, MODEL).reciprocity == pytest.approx(0.1 / 1.05, rel=1e-6)
    assert read_wiring(MODEL, MODEL).reciprocity is None


def test_readings_that_come_one_late_are_found():
    rng = np.random.default_rng(6)
    touched = np.arange(120) % 6 != 0
    change = 0.01 * rng.standard_normal((120, 104)) * touched[:, None]
    volts = MODEL * (1.0 + change + 0.003 * rng.standard_normal((120, 104)))
    assert lag_of(volts, touched) == 0
    assert lag_of(np.roll(volts, 1, axis=0), touched) == 1
    assert lag_of(np.roll(volts, -1, axis=0), touched) == -1
    assert lag_of(volts[:12], touched[:12]) == 0, "too few untouched readings say nothing"


def test_other_shapes_are_refused():
    with pytest.raises(ValueError, match=r"readings of shape \(1, 103\), expected"):
        read_wiring(MODEL[:103], MODEL)
