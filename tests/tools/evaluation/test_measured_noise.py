"""The noise of measured samples is that of the untouched ones among them."""

import numpy as np
import pytest

from eitskin_proto.skin.skin import PAPER
from eitskin_tools.evaluation.measured import measured_noise
from eitskin_tools.evaluation.measured_file import Measured

FLAT_V = np.geomspace(0.5, 100.0, 104)


def samples(untouched, common=0.01):
    rng = np.random.default_rng(4)
    count = untouched + 3
    change = common * rng.standard_normal((count, 1)) + 0.003 * rng.standard_normal((count, 104))
    change[untouched:] += 0.5
    kinds = ("untouched",) * untouched + ("press",) * 3
    none = np.full(count, -1)
    clouds = np.zeros((0, *PAPER.grid.cloud_shape))
    return Measured(FLAT_V, None, FLAT_V * (1.0 + change), clouds, none, None, kinds, PAPER, None, ())


def test_noise_and_what_rows_share_of_it_are_those_of_untouched_samples():
    noise = measured_noise(samples(60), FLAT_V)
    assert noise is not None
    assert np.median(noise.measured) == pytest.approx(0.003, rel=0.1)
    assert np.sqrt(np.sum(noise.shared**2) / 104.0) == pytest.approx(0.01, rel=0.3)


def test_few_untouched_samples_say_nothing():
    assert measured_noise(samples(7), FLAT_V) is None
