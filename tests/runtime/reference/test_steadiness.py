"""How many frames a mean gains from: all of them under white noise, few where the sheet drifts."""

import numpy as np
import pytest

from eitskin.reference.steadiness import steady_frames


@pytest.mark.parametrize("seed", range(5))
def test_white_noise_has_no_end(seed):
    assert steady_frames(np.random.default_rng(seed).standard_normal((400, 104)), np.ones(104)) == 64


@pytest.mark.parametrize(("walk", "least", "most"), [(0.5, 2, 4), (0.1, 8, 32)])
def test_a_walk_ends_where_it_is_as_large_as_the_noise_that_is_left(walk, least, most):
    # the Allan variance of n frames is 1 / n + n walk^2 / 3, least at sqrt(3) / walk: 3.5 and 17 frames
    rng = np.random.default_rng(1)
    frames = rng.standard_normal((800, 104)) + walk * np.cumsum(rng.standard_normal((800, 104)), axis=0)
    assert least <= steady_frames(frames, frames.std(axis=0)) <= most
