"""Rows that their noise drowns: weighed by it as a Gaussian says, or filled in like missing ones, and named."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.runtime.health.test_electrodes import NOISE, REFERENCE, consistency, healthy
from tests.runtime.health.test_imputation import RANGE, gaussian

from eitskin.health.electrodes import ElectrodeWatch
from eitskin.health.imputation import Imputation
from eitskin.reference.row_noise import LOST_SPREAD, WEIGHED_SPREAD, lost_rows, weighed_rows
from eitskin_proto.sensor.table import N_ROWS


def spread(**rows):
    """Return (104,) V of spread: NOISE of every row, and what is said of some by their number."""
    found = np.full(N_ROWS, NOISE)
    for name, value in rows.items():
        found[int(name[3:])] = value
    return found * np.abs(REFERENCE)


def test_rows_are_told_apart_by_their_own_spread_and_by_their_size():
    weak = REFERENCE.copy()
    weak[3] = 0.5e-4 * np.abs(REFERENCE).max()
    noise = spread(row7=1.01 * LOST_SPREAD, row8=0.99 * LOST_SPREAD, row9=1.01 * WEIGHED_SPREAD)
    noise[3] = 0.0
    assert np.flatnonzero(lost_rows(weak, noise)).tolist() == [3, 7]
    assert np.flatnonzero(weighed_rows(weak, noise)).tolist() == [8, 9]
    assert not lost_rows(REFERENCE, np.zeros(N_ROWS)).any()
    assert not weighed_rows(REFERENCE, np.zeros(N_ROWS)).any()


@given(
    st.floats(1e-9, 1e9), st.integers(0, 2**32 - 1).map(lambda seed: np.random.default_rng(seed).permutation(N_ROWS))
)
@settings(deadline=None, max_examples=50)
def test_neither_the_current_nor_the_order_of_the_rows_decides_what_a_row_is_worth(scale, order):
    rng = np.random.default_rng(order[0])
    volts, noise = (
        REFERENCE * 10.0 ** rng.uniform(-5, 0, N_ROWS),
        np.abs(REFERENCE) * 10.0 ** rng.uniform(-6, 0, N_ROWS),
    )
    for told in (lost_rows, weighed_rows):
        assert np.array_equal(told(scale * volts[order], scale * noise[order]), told(volts, noise)[order])
        assert np.array_equal(told(-volts, noise), told(volts, noise))
    assert not (lost_rows(volts, noise) & weighed_rows(volts, noise)).any()


@pytest.mark.parametrize("gone", [(), (4, 70)])
def test_a_noisy_row_is_replaced_by_its_mean_given_its_own_reading_and_all_others(gone):
    # Independent way: the joint Gaussian of what is true of the row and of what was measured, conditioned directly.
    mean, covariance = gaussian()
    rng = np.random.default_rng(8)
    noise = np.zeros(N_ROWS)
    noise[[10, 11, 50]] = [0.02, 0.2, 0.01]
    rows = np.isin(np.arange(N_ROWS), gone)
    precision = np.linalg.inv(covariance + np.diag(noise))
    filling = Imputation(mean, precision, RANGE)
    filling.leave_out(rows, precision, noise=noise)
    measured = rng.multivariate_normal(mean, covariance) + np.sqrt(noise) * 0.3 * rng.standard_normal(N_ROWS)
    change = np.expm1(measured).astype(np.float32)
    change[rows] = 5.0  # anything
    filling.fill(change)
    here = ~rows
    gain = np.linalg.solve((covariance + np.diag(noise))[np.ix_(here, here)], covariance[here]).T
    expected = np.expm1(mean + gain @ (measured[here] - mean[here]))
    altered = (noise > 0.0) | rows
    np.testing.assert_allclose(change[altered], expected[altered], atol=2e-4)  # float32 in and out, P has 1e4
    np.testing.assert_allclose(change[~altered], np.expm1(measured)[~altered], rtol=1e-6)
    many = filling.filled(np.repeat(np.expm1(measured)[None], 3, axis=0))
    np.testing.assert_allclose(many[:, altered], np.repeat(expected[None, altered], 3, axis=0), atol=2e-4)


def test_the_more_noise_a_row_has_the_less_its_own_reading_counts():
    mean, covariance = gaussian()
    moved = []
    for variance in (1e-6, 1e-4, 1e-2, 1.0, 1e4):
        noise = np.where(np.arange(N_ROWS) == 20, variance, 0.0)
        precision = np.linalg.inv(covariance + np.diag(noise))
        filling = Imputation(mean, precision, RANGE)
        filling.leave_out(np.zeros(N_ROWS, dtype=np.bool_), precision, noise=noise)
        read = [np.expm1(mean + np.where(np.arange(N_ROWS) == 20, up, 0.0)).astype(np.float32) for up in (0.0, 0.1)]
        for change in read:
            filling.fill(change)
        moved.append(float(read[1][20] - read[0][20]))
    assert all(after < before for before, after in pairwise(moved))
    assert moved[0] > 0.09
    assert abs(moved[-1]) < 1e-6


def test_a_watch_fills_in_lost_rows_and_is_not_alarmed_by_them():
    rng = np.random.default_rng(3)
    looking = ElectrodeWatch(consistency(), REFERENCE, spread(row5=2.0, row40=0.1))
    assert np.flatnonzero(looking.missing).tolist() == [5]
    assert looking.alters
    frames = healthy(300)
    true = frames[:, [5, 40]].copy()
    frames[:, 5] += 2.0 * rng.standard_normal(len(frames)).astype(np.float32)
    frames[:, 40] += 0.1 * rng.standard_normal(len(frames)).astype(np.float32)
    off = np.empty((len(frames), 2))
    for number, raw in enumerate(frames):
        change = raw.copy()
        looking.correct(change)
        off[number] = change[[5, 40]] - true[number]
        assert not looking.update(raw, change)
    assert not looking.findings
    rms = np.sqrt(np.mean(off**2, axis=0))
    assert rms[0] < 0.02  # of a row whose readings are off by 2
    assert rms[1] < 0.02  # and by 0.1
