"""What the untouched samples of a measured file say: their noise, and how likely noise alone leaves a sample."""

import json

import numpy as np
import pytest
from scipy import stats

from eitskin_sim.surface.predict import flat_voltages
from eitskin_tools import cli
from eitskin_tools.evaluation.verified.untouched_samples import UntouchedSamples

LIMIT = {40: 0.25, 200: 0.12}
"""Kolmogorov distances that uniform numbers exceed once in a hundred."""


def lab_noise(count, own=0.003, seed=4):
    """Return (n, 104) dV of a sheet whose rows drift together more than they are noisy alone."""
    rng = np.random.default_rng(seed)
    shared = 0.01 * rng.standard_normal((3, 104))
    rows = own * np.exp(0.3 * rng.standard_normal(104))
    return rng.standard_normal((count, 3)) @ shared + rows * rng.standard_normal((count, 104))


def p_values(changes, untouched):
    found = UntouchedSamples.of(changes, np.zeros(len(changes), dtype=int), untouched)
    return np.array([found.verdict(number).p_value for number in range(len(changes))])


@pytest.mark.parametrize("count", LIMIT)
@pytest.mark.parametrize("own", [0.003, 0.0005])
def test_p_of_untouched_samples_is_uniform_however_much_their_rows_share(count, own):
    untouched = np.arange(count + 200) < count
    found = p_values(lab_noise(count + 200, own), untouched)
    assert stats.kstest(found[untouched], "uniform").statistic < LIMIT[count]
    others = {40: 0.2, 200: 0.1}[count]  # the covariance of few samples is uncertain
    assert np.mean(found[~untouched] < 0.05) < others


def test_a_change_that_noise_does_not_make_has_a_small_p():
    changes, untouched = lab_noise(100), np.arange(100) < 60
    changes[80:, 7] += 0.05
    found = p_values(changes, untouched)
    assert found[80:].max() < 1e-3 < np.median(found[60:80])


def test_noise_is_about_the_mean_of_each_shape_and_a_sample_alone_in_its_shape_has_no_verdict():
    changes, shapes = lab_noise(61), np.repeat([0, 1, 2], [30, 30, 1])
    changes += np.array([0.0, 0.4, 0.9])[shapes, None]
    found = UntouchedSamples.of(changes, shapes, np.ones(61, dtype=bool))
    assert np.median(found.noise.measured) == pytest.approx(0.003, rel=0.3)
    assert found.verdict(60) is None
    assert UntouchedSamples.of(changes[:7], shapes[:7], np.ones(7, dtype=bool)) is None
    assert UntouchedSamples.of(changes[np.arange(61) % 7], shapes, np.ones(61, dtype=bool)) is None


@pytest.mark.slow
def test_the_command_gives_p_of_untouched_samples(tmp_path, capsys):
    flat = flat_voltages()
    volts = flat * (1.0 + lab_noise(40))
    np.savez(tmp_path / "m.npz", reference_V=flat, voltages_V=volts, kind=np.array(["untouched"] * 40))
    assert cli.main(["evaluate", "--measured", str(tmp_path / "m.npz"), "--solver", "verified", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["samples"]
    assert stats.kstest([one["p_value"] for one in found], "uniform").statistic < LIMIT[40]
