"""The gate without some rows: it sees what an untouched sheet would have there, and its threshold follows.

Two kinds of gate: the shipped one of matched filters, to which noise is no touch however strong it is, and one made
here that goes by the distance from the untouched sheets, to which anything strange is a touch.
"""

import numpy as np
import pytest

from eitskin.health.gate_without_rows import BLOCKS, FALSE_ALARMS, GateWithoutRows
from eitskin.health.imputation import Consistency
from eitskin.health.monitor import Health
from eitskin.model.bundle import default_path, load_bundle
from eitskin.model.gate import Filters, Gate, patterns_of
from eitskin_proto.sensor.row_gaussian import rows_of
from eitskin_proto.sensor.table import N_ROWS

QUIET = np.full(N_ROWS, 0.003)


@pytest.fixture(scope="module")
def filters():
    bundle = load_bundle(default_path("area"))
    arrays, gate = bundle.consistency_arrays(), bundle.gate_arrays()
    if arrays is None or gate is None:
        pytest.skip("the shipped bundle has no consistency.npz or no gate; 'eitskin export' makes them")
    return Consistency.of(arrays), gate


@pytest.fixture(scope="module")
def distance(filters):
    known = filters[0]
    root = np.linalg.inv(np.linalg.cholesky(known.untouched_covariance + np.diag(QUIET**2))).T
    both = np.hstack([root, -root])
    arrays = {
        "mean": np.zeros(2 * N_ROWS), "scale": np.ones(2 * N_ROWS), "w1": np.vstack([0.0 * both, both]),
        "b1": -known.untouched_mean @ both, "w2": np.ones(2 * N_ROWS), "b2": np.zeros(1), "threshold": np.zeros(1),
    }  # fmt: skip
    logits = Gate(arrays).logits(untouched(known, 4000, QUIET, seed=1))
    return known, arrays | {"threshold": np.quantile(logits, [0.997])}


@pytest.fixture(params=["filters", "distance"])
def kind(request):
    return request.getfixturevalue(request.param)


def untouched(known, count, sigma, seed=9):
    """Return (count, 104) dV of sheets of the bundle's own deformations, with noise."""
    rng = np.random.default_rng(seed)
    logs = rng.multivariate_normal(known.untouched_mean, known.untouched_covariance, count)
    return np.expm1(logs) + sigma * rng.standard_normal(logs.shape)


def touched(filters, known, count, sigma, seed=10):
    """Return (count, 104) dV of the same sheets with what the shipped gate's filters look for, 40 times the noise."""
    arrays = filters[1]
    size = Filters.of(arrays).whitened
    first = np.asarray(arrays["w1"], dtype=np.float64)[N_ROWS:]
    patterns = np.linalg.pinv(first[:, :size]).T @ patterns_of(first[:, :size], first[:, 2 * size :])
    chosen = patterns[:, np.random.default_rng(seed).integers(patterns.shape[1], size=count)].T
    return (1.0 + untouched(known, count, sigma, seed)) * np.exp(np.clip(40.0 * chosen, -2.0, 2.0)) - 1.0


def alarms(gate, gate_without_rows, changes):
    """Return the share of frames that are called touched, one at a time as the runtime does it."""
    tripped = 0
    for change in changes.astype(np.float32):
        gate_without_rows.fill(change)
        gate.change[:] = change
        tripped += gate.touched()
    return tripped / len(changes)


@pytest.mark.parametrize("electrodes", [(5,), (0, 9)])
def test_without_electrodes_the_gate_keeps_its_rate_of_false_alarms(kind, filters, electrodes):
    known, arrays = kind
    gate = Gate(arrays)
    gate_without_rows = GateWithoutRows(known, gate, QUIET)
    gate_without_rows.leave_out(rows_of(electrodes))
    assert gate.threshold == gate.usual_threshold  # until the sheets are judged
    gate_without_rows.finish()
    still, pressed = untouched(known, 3000, QUIET), touched(filters, known, 500, QUIET)
    for changes in (still, pressed):
        changes[:, rows_of(electrodes)] = 7.0  # whatever a dead electrode reads
    # 3000 frames at a rate of 0.003 trip it 9 times, give or take 3; the threshold's own 2000 make that 5 more
    assert alarms(gate, gate_without_rows, still) < FALSE_ALARMS + 5 * np.sqrt(2 * FALSE_ALARMS / 3000)
    told_apart = alarms(gate, gate_without_rows, pressed)
    raw = Gate(arrays)  # without any of this one kind of gate finds all touched and the other nothing
    blind = alarms(raw, GateWithoutRows(known, raw, QUIET), pressed) - alarms(
        raw, GateWithoutRows(known, raw, QUIET), still
    )
    assert told_apart > 0.6
    assert blind < 0.05


def test_noise_beyond_what_the_gate_learned_raises_its_threshold_and_less_does_not_lower_it(distance):
    known, arrays = distance
    gate, sigma = Gate(arrays), np.full(N_ROWS, 0.02)
    gate_without_rows = GateWithoutRows(known, gate, sigma)
    assert gate_without_rows.due
    gate_without_rows.finish()
    assert gate.threshold > gate.usual_threshold
    changes = untouched(known, 2000, sigma)
    assert alarms(gate, gate_without_rows, changes) < FALSE_ALARMS + 5 * np.sqrt(2 * FALSE_ALARMS / 2000)
    assert (Gate(arrays).logits(changes) > gate.usual_threshold).mean() > 0.1  # as it would be
    assert not GateWithoutRows(known, Gate(arrays), QUIET).due


def test_noise_that_rows_share_raises_the_threshold_of_a_gate_that_takes_it_for_touches(distance):
    known, gate, arrays = distance[0], Gate(distance[1]), distance[1]
    shared = 0.05 * np.linalg.qr(np.random.default_rng(3).standard_normal((104, 3)))[0] * np.sqrt(104.0)
    gate_without_rows = GateWithoutRows(known, gate, np.hypot(QUIET, np.linalg.norm(shared, axis=1)), shared)
    gate_without_rows.finish()
    assert gate.threshold > Gate(arrays).usual_threshold
    plain = GateWithoutRows(known, Gate(arrays), QUIET, np.zeros((104, 0)))
    assert not plain.due


def test_noise_is_no_touch_to_matched_filters_and_their_threshold_stays(filters):
    known, arrays = filters
    gate, sigma = Gate(arrays), np.full(N_ROWS, 0.02)
    gate_without_rows = GateWithoutRows(known, gate, sigma)
    gate_without_rows.finish()
    assert gate.threshold == gate.usual_threshold
    changes = untouched(known, 2000, sigma)
    assert alarms(gate, gate_without_rows, changes) < FALSE_ALARMS + 5 * np.sqrt(2 * FALSE_ALARMS / 2000)


def test_a_later_reference_keeps_no_frame_waiting_and_its_threshold_comes_while_the_line_rests(distance):
    """Until then the one before holds for the same rows: a device does not become noisy by a new reference."""
    known, arrays = distance
    gate, health, spread = Gate(arrays), Health(known), 0.02 * np.abs(known.reference)
    health.use_reference(known.reference, spread, gate)
    first = gate.threshold
    assert not health.due  # nobody waited for frames yet
    assert first > gate.usual_threshold
    health.use_reference(known.reference, spread, gate)
    assert health.due
    assert gate.threshold == first
    looks = 0
    while health.due:
        health.examine(np.zeros(N_ROWS, dtype=np.float32))
        looks += 1
    assert looks == BLOCKS
    assert gate.threshold == first
    health.use_reference(known.reference, np.where(rows_of((4,)), 1e9, spread), gate)
    assert not health.due  # what held for other rows says nothing
    assert gate.threshold not in (first, gate.usual_threshold)
