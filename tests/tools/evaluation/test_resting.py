"""Which untouched frames the verifier is told of."""

import numpy as np
import pytest

from eitskin_tools.evaluation.verified.resting import FRAMES, NEWS, Resting

NOISE = 1e-3


@pytest.fixture
def resting():
    own = Resting()
    own.use(np.ones(104), np.full(104, NOISE), 100, 0.0)
    return own


def told(own, change, frames, seed=1):
    """Return what frames around one value say."""
    rng = np.random.default_rng(seed)
    found = [own.take((change + 0.7 * NOISE * rng.standard_normal(104)).astype(np.float32)) for _ in range(frames)]
    return [one for one in found if one is not None]


def test_the_mean_of_still_frames_is_told_once_and_again_when_it_is_news(resting):
    assert told(resting, 0.1, FRAMES - 1) == []
    (mean,) = told(resting, 0.1, 3 * FRAMES)
    assert mean == pytest.approx(np.full(104, 0.1), abs=NOISE)
    assert np.sqrt(np.mean((mean - 0.1) ** 2)) < 2.0 * NOISE / np.sqrt(FRAMES)
    assert told(resting, 0.1 + 0.5 * NEWS, 3 * FRAMES) == []
    assert len(told(resting, 0.1 + 3.0 * NEWS, 3 * FRAMES)) == 1


def test_what_moves_or_was_touched_meanwhile_does_not_rest(resting):
    for step in range(3 * FRAMES):
        assert resting.take(np.full(104, 0.01 * step, dtype=np.float32)) is None
    told(resting, 0.1, FRAMES // 2)
    resting.forget()
    assert told(resting, 0.1, FRAMES - 1) == []
    assert len(told(resting, 0.1, 1)) == 1


def test_another_surface_is_told_whatever_it_reads(resting):
    assert len(told(resting, 0.1, FRAMES)) == 1
    resting.use(np.ones(104), np.full(104, NOISE), 100, 0.0)
    assert len(told(resting, 0.1, FRAMES)) == 1
