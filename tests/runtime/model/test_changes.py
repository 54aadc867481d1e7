"""A faint press is found by what has changed, stays found, and nothing else is taken for one."""

import numpy as np
import pytest

from eitskin.model.bundle import default_path, load_bundle
from eitskin.model.gate import SLOW_FRAMES, ChangeDetector, Filters, Gate

WHITENED, COUNT, LIMIT, STILL = 60, 24, 7.0, 0.25
NOISE = 0.2
"""Of w in a frame: a fifth of what devices and bends do to it."""

PATTERNS = np.abs(np.random.default_rng(1).normal(size=(WHITENED, COUNT))) ** 3
PATTERNS /= np.linalg.norm(PATTERNS, axis=0)
"""All of one sign, and alike by a half: of touches."""

PRESS = 7.0 * PATTERNS[:, 3]
"""A faint one: below the limit of a frame of a device that is far off."""


def sheet(rng):
    """Return (60,) w of a device at a bend."""
    return rng.standard_normal(WHITENED)


def judged(changes, w, rng, *, noise=NOISE, touched=False):
    """Return what is said of (n, 60) w under noise."""
    seen = w + noise * rng.standard_normal(w.shape)
    responses = np.concatenate([seen, seen @ PATTERNS], axis=1).astype(np.float32)
    return np.array([changes.step(response, touched) for response in responses])


def watching(rest, rng, frames=200, **more):
    """Return what has seen a sheet at rest for some frames."""
    changes = ChangeDetector(Filters(WHITENED, LIMIT, STILL, True), WHITENED + COUNT)
    assert not judged(changes, np.tile(rest, (frames, 1)), rng, **more).any()
    return changes


def single(w):
    """Return what one frame by itself comes to: above ``LIMIT`` it is touched."""
    return (w @ PATTERNS).max() / (np.abs(w).mean() + STILL)


def test_a_press_that_no_frame_shows_by_itself_is_found_at_once():
    found, by_itself = [], []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        rest = sheet(rng)
        changes = watching(rest, rng)
        by_itself.append(single(rest + PRESS) > LIMIT)
        found.append(judged(changes, np.tile(rest + PRESS, (5, 1)), rng).any())
    assert np.mean(by_itself) < 0.3
    assert all(found)


def test_a_press_that_is_held_is_never_learned_and_its_end_is_seen_at_once():
    rng = np.random.default_rng(2)
    rest = sheet(rng)
    changes = watching(rest, rng)
    creep = np.linspace(0.0, 1.0, 5 * SLOW_FRAMES)[:, None] * 0.3 * sheet(rng)  # uneven drift of a session
    assert judged(changes, rest + PRESS + creep, rng).mean() > 0.999
    after = judged(changes, np.tile(rest + creep[-1], (300, 1)), rng)
    assert not after.any()
    assert not changes.held
    assert judged(changes, np.tile(rest + creep[-1] + PRESS, (5, 1)), rng).any()


def test_a_moving_sheet_is_no_touch_and_hides_none():
    for seed in range(10):
        rng = np.random.default_rng(seed)
        one, other = sheet(rng), sheet(rng)
        way = one + np.linspace(0.0, 1.0, 200)[:, None] * (other - one)
        changes = watching(one, rng)
        assert not judged(changes, way, rng).any()
        assert not judged(changes, np.tile(other, (200, 1)), rng).any()
        assert not judged(changes, way[:99:-1], rng).any()
        assert judged(changes, way[100:95:-1] + PRESS, rng).any()


def test_noise_however_strong_is_no_touch():
    for noise in (0.02, 0.2, 3.0):
        rng = np.random.default_rng(6)
        changes = ChangeDetector(Filters(WHITENED, LIMIT, STILL, True), WHITENED + COUNT)
        assert judged(changes, np.tile(sheet(rng), (5000, 1)), rng, noise=noise).mean() < 1e-3
        assert not changes.held


def test_filters_of_both_signs_find_presses_of_both():
    rng = np.random.default_rng(8)
    both = np.concatenate([PATTERNS, -PATTERNS], axis=1)
    for sign in (1.0, -1.0):
        rest = sheet(rng)
        changes = ChangeDetector(Filters(WHITENED, LIMIT, STILL, False), WHITENED + 2 * COUNT)
        w = np.concatenate([np.tile(rest, (200, 1)), np.tile(rest + sign * PRESS, (5, 1))])
        w = w + NOISE * rng.standard_normal(w.shape)
        seen = [changes.step(np.concatenate([one, one @ both]).astype(np.float32), False) for one in w]
        assert not any(seen[:200])
        assert any(seen[200:])


@pytest.fixture(scope="module")
def shipped():
    arrays = load_bundle(default_path(touches="lower")).gate_arrays()
    if arrays is None:
        pytest.skip("the shipped bundle has no gate; 'eitskin export' makes one")
    return arrays


def test_a_common_factor_is_no_change(shipped):
    rng = np.random.default_rng(10)
    gate = Gate(shipped)
    for factor in np.repeat([1.0, 1.1, 0.9], 100):
        gate.change[:] = factor * (1.0 + 0.0025 * rng.standard_normal(104)) - 1.0
        assert not gate.touched()
    assert gate.changes is not None
    assert gate.changes.seen == 300
    gate.reset()
    assert gate.changes.seen == 0
