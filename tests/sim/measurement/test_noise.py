"""Noise: each definition has the power that it states, of what it states."""

import numpy as np
import pytest

from eitskin_sim.measurement.noise import add_noise

RNG = np.random.default_rng(0)
REFERENCE = RNG.uniform(0.01, 5.0, 104) * RNG.choice((-1.0, 1.0), 104)
CHANGE = 0.1 * RNG.standard_normal((400, 104))
VOLTAGES = REFERENCE * (1.0 + CHANGE)


def rms(values: np.ndarray) -> np.ndarray:
    return np.sqrt(np.mean(values**2, axis=-1))


def snr_db(signal: np.ndarray, noise: np.ndarray) -> np.ndarray:
    return 20.0 * np.log10(rms(signal) / rms(noise))


# 104 draws a sample know their own level to 7 % (0.6 dB); 400 samples know the mean to 0.03 dB.
def test_n1_is_50_db_under_each_samples_dv() -> None:
    noisy = add_noise(VOLTAGES, REFERENCE, "N1", 50.0, np.random.default_rng(1))
    found = snr_db(CHANGE, noisy / REFERENCE - VOLTAGES / REFERENCE)
    assert abs(found.mean() - 50.0) < 0.2
    assert found.std() < 1.2


def test_n2_is_50_db_under_every_single_voltage() -> None:
    noisy = add_noise(VOLTAGES, REFERENCE, "N2", 50.0, np.random.default_rng(1))
    error = noisy / VOLTAGES - 1.0
    assert rms(error.ravel()) == pytest.approx(10 ** (-50 / 20), rel=0.02)
    assert rms(error.T).max() / rms(error.T).min() < 1.4


def test_n3_is_one_level_for_all_rows_50_db_under_their_rms() -> None:
    noisy = add_noise(VOLTAGES, REFERENCE, "N3", 50.0, np.random.default_rng(1))
    error = noisy - VOLTAGES
    assert abs(snr_db(VOLTAGES, error).mean() - 50.0) < 0.2
    weak, strong = np.argmin(np.abs(REFERENCE)), np.argmax(np.abs(REFERENCE))
    assert rms(error[:, weak]) == pytest.approx(rms(error[:, strong]), rel=0.2)


def test_no_noise_is_no_noise_and_the_input_is_left_alone() -> None:
    before = VOLTAGES.copy()
    assert np.array_equal(add_noise(VOLTAGES, REFERENCE, "none", 50.0, np.random.default_rng(1)), VOLTAGES)
    add_noise(VOLTAGES, REFERENCE, "N3", 20.0, np.random.default_rng(1))
    assert np.array_equal(VOLTAGES, before)


def test_an_untouched_sample_has_no_n1_noise() -> None:
    noisy = add_noise(REFERENCE, REFERENCE, "N1", 50.0, np.random.default_rng(1))
    assert noisy == pytest.approx(REFERENCE, rel=1e-12)


def test_a_seed_repeats_itself_and_kinds_have_names() -> None:
    first, second = (add_noise(VOLTAGES, REFERENCE, "N2", 40.0, np.random.default_rng(5)) for _ in range(2))
    assert np.array_equal(first, second)
    with pytest.raises(ValueError, match="'N4' is unknown; expected one of N1, N2, N3, none"):
        add_noise(VOLTAGES, REFERENCE, "N4", 50.0, np.random.default_rng(1))  # type: ignore[arg-type]
