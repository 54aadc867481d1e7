"""Which untouched frames the verifier receives."""

import numpy as np
import pytest

from eitskin_tools.evaluation.verified.untouched_baseline import BASELINE_FRAMES, MIN_NEW_RMS, UntouchedBaseline

NOISE = 1e-3


@pytest.fixture
def baseline():
    own = UntouchedBaseline()
    own.start(np.ones(104), np.full(104, NOISE), 100, 0.0)
    return own


def told(own, change, frames, seed=1):
    """Return what frames around one value say."""
    rng = np.random.default_rng(seed)
    found = [own.add((change + 0.7 * NOISE * rng.standard_normal(104)).astype(np.float32)) for _ in range(frames)]
    return [one for one in found if one is not None]


def test_the_mean_of_still_frames_is_told_once_and_again_when_it_is_news(baseline):
    assert told(baseline, 0.1, BASELINE_FRAMES - 1) == []
    (mean,) = told(baseline, 0.1, 3 * BASELINE_FRAMES)
    assert mean == pytest.approx(np.full(104, 0.1), abs=NOISE)
    assert np.sqrt(np.mean((mean - 0.1) ** 2)) < 2.0 * NOISE / np.sqrt(BASELINE_FRAMES)
    assert told(baseline, 0.1 + 0.5 * MIN_NEW_RMS, 3 * BASELINE_FRAMES) == []
    assert len(told(baseline, 0.1 + 3.0 * MIN_NEW_RMS, 3 * BASELINE_FRAMES)) == 1


def test_what_moves_or_was_touched_meanwhile_does_not_rest(baseline):
    for step in range(3 * BASELINE_FRAMES):
        assert baseline.add(np.full(104, 0.01 * step, dtype=np.float32)) is None
    told(baseline, 0.1, BASELINE_FRAMES // 2)
    baseline.reset()
    assert told(baseline, 0.1, BASELINE_FRAMES - 1) == []
    assert len(told(baseline, 0.1, 1)) == 1
