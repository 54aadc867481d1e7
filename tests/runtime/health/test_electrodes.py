"""Failed electrodes are named within 20 frames, filled in, and used again once they are healthy."""

import numpy as np
import pytest

from eitskin.health.electrodes import AGREEING_FRAMES, HEALTHY, ElectrodeWatch
from eitskin.health.imputation import Consistency
from eitskin.health.swapped_wires import rewiring
from eitskin_proto.sensor.row_gaussian import rows_of
from eitskin_proto.sensor.table import N_ROWS, TABLE

CAUSES = 0.1 * np.random.default_rng(11).standard_normal((6, N_ROWS))
BENDS = 0.05 * np.random.default_rng(12).standard_normal((4, N_ROWS))
NOISE = 0.003


def response(seed=0):
    """Return a random (16, 16) response of a passive network."""
    rng = np.random.default_rng(seed)
    half = rng.standard_normal((16, 16))
    return half @ half.T + 16 * np.eye(16)


def rows_from(network, order=None):
    """Return the (104,) V of a network whose wires lead to the electrodes in some order."""
    order = np.arange(16) if order is None else order
    wired = network[np.ix_(order, order)]
    pairs = np.eye(16) - np.roll(np.eye(16), 1, axis=1)
    between = pairs @ wired @ pairs.T
    return between[TABLE[:, 0], TABLE[:, 1]]


REFERENCE = rows_from(response())


def consistency(threshold=30.0, total=5.0):
    """Return the Gaussian that :func:`healthy` draws from."""
    noise = NOISE**2 * np.eye(N_ROWS)
    return Consistency(
        mean=np.zeros(N_ROWS),
        covariance=CAUSES.T @ CAUSES + noise,
        ratio_range=np.array([0.01, 8.0]),
        reference=REFERENCE,
        untouched_mean=np.zeros(N_ROWS),
        untouched_covariance=BENDS.T @ BENDS + noise,
        predicted_mean=np.zeros(N_ROWS),
        predicted_covariance=1e-4 * BENDS.T @ BENDS + noise,
        drift_limits=np.array([[0.02, 3.0], [0.002, 3.0]]),
        projection_inverse=np.eye(N_ROWS),
        thresholds=np.array([threshold, total]),
    )


def healthy(count, seed=0):
    """Return (count, 104) dV of a touch that moves smoothly, with noise."""
    rng = np.random.default_rng(seed)
    time = np.arange(count)[:, None] / 200.0
    phases, speeds = rng.uniform(0, 2 * np.pi, 6), rng.uniform(0.5, 3.0, 6)
    logs = np.sin(speeds * time + phases) @ CAUSES + NOISE * rng.standard_normal((count, N_ROWS))
    return np.expm1(logs).astype(np.float32)


def watch(excluded=()):
    return ElectrodeWatch(consistency(), REFERENCE, NOISE * np.abs(REFERENCE), excluded)


def show(looking, frames):
    """Show frames to a watch, and return after how many of them something changed."""
    changes = []
    for number, raw in enumerate(frames, start=1):
        change = raw.copy()
        looking.correct(change)
        if looking.update(raw, change):
            changes.append(number)
    return changes


def detached(frames, electrode, seed=5):
    """Drives at an electrode carry nothing, and its wire reads anything."""
    rng, broken = np.random.default_rng(seed), frames.copy()
    pairs = ((electrode - 1) % 16, electrode)
    driven, sensed = np.isin(TABLE[:, 0], pairs), np.isin(TABLE[:, 1], pairs)
    broken[:, sensed] = rng.uniform(-6.0, 6.0, sensed.sum())
    broken[:, driven] = -0.995
    return broken


@pytest.mark.parametrize("electrode", [0, 1, 6, 15])
def test_a_detached_electrode_is_named_within_20_frames(electrode):
    looking = watch()
    assert show(looking, healthy(50)) == []
    changes = show(looking, detached(healthy(20, seed=1), electrode))
    assert changes
    assert AGREEING_FRAMES <= changes[0] <= 20
    assert looking.states()[electrode] == "detached"
    assert sum(state != "well" for state in looking.states()) == 1
    assert looking.texts == (f"{electrode}:detached:imputed",)
    assert np.array_equal(looking.missing, rows_of((electrode,)))


@pytest.mark.parametrize("pair", [0, 7, 15])
def test_a_short_is_told_from_a_detached_electrode(pair):
    frames = healthy(20)
    frames[:, (pair == TABLE).any(axis=1)] = -0.9995
    looking = watch()
    assert show(looking, frames)[0] <= 20
    states, after = looking.states(), (pair + 1) % 16
    assert [number for number, state in enumerate(states) if state != "well"] == sorted((pair, after))
    assert states[pair] == states[after] == "shorted"


@pytest.mark.parametrize("electrode", [0, 9])
def test_an_electrode_whose_contact_jumps_is_noisy(electrode):
    rng, frames = np.random.default_rng(2), healthy(60)
    frames[20:, rows_of((electrode,))] += 0.1 * rng.standard_normal((40, 26)).astype(np.float32)
    looking = watch()
    changes = show(looking, frames)
    assert changes
    assert 20 + AGREEING_FRAMES <= changes[0] <= 40
    assert looking.states()[electrode] == "noisy"


@pytest.mark.parametrize(("first", "second"), [(4, 5), (15, 0), (2, 9), (0, 8)])
def test_an_exchange_of_wires_is_undone_exactly_where_its_rows_were_measured(first, second):
    order = np.arange(16)
    order[[first, second]] = second, first
    network = response(3)
    undone = rewiring(first, second)
    found, right = undone.matrix @ rows_from(network, order), rows_from(network)
    np.testing.assert_allclose(found[~undone.missing], right[~undone.missing], rtol=1e-9)
    neighbours = (second - first) % 16 in (1, 15)
    assert undone.missing.sum() == (1 if neighbours else 4) or undone.missing.sum() < 30


def test_healthy_frames_name_nobody():
    looking = watch()
    assert show(looking, np.concatenate([healthy(500, seed) for seed in range(3)])) == []
    assert looking.texts == ()
    assert not looking.missing.any()


def test_an_electrode_comes_back_after_as_many_healthy_frames_as_stated():
    looking = watch()
    show(looking, detached(healthy(20), 5))
    assert looking.states()[5] == "detached"
    changes = show(looking, healthy(HEALTHY + 50, seed=3))
    assert changes == [HEALTHY]
    assert set(looking.states()) == {"well"}


def test_a_second_failure_is_found_while_the_first_is_out():
    looking = watch()
    show(looking, detached(healthy(20), 5))
    show(looking, detached(detached(healthy(20, seed=2), 5), 11, seed=6))
    assert [number for number, state in enumerate(looking.states()) if state != "well"] == [5, 11]


def test_what_is_excluded_by_hand_stays_out():
    looking = watch(excluded=(3,))
    assert looking.texts == ("3:excluded:imputed",)
    show(looking, healthy(HEALTHY + 20))
    assert looking.states()[3] == "excluded"
    looking.exclude(())
    assert looking.texts == ()
