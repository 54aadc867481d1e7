"""The gate without some rows: it sees what an untouched sheet would have there, and its threshold follows."""

import numpy as np
import pytest

from eitskin.health.gate_without_rows import BLOCKS, FALSE_ALARMS, GateWithoutRows
from eitskin.health.imputation import Consistency
from eitskin.health.monitor import Health
from eitskin.model.bundle import default_path, load_bundle
from eitskin.model.gate import Gate
from eitskin_proto.sensor.row_gaussian import rows_of
from eitskin_proto.sensor.table import N_ROWS

QUIET = np.full(N_ROWS, 0.003)


@pytest.fixture(scope="module")
def shipped():
    bundle = load_bundle(default_path("units"))
    arrays, gate = bundle.consistency_arrays(), bundle.gate_arrays()
    if arrays is None or gate is None:
        pytest.skip("the shipped bundle has no consistency.npz or no gate; 'eitskin export' makes them")
    return Consistency.of(arrays), gate


def untouched(known, count, sigma, seed=9):
    """Return (count, 104) dV of sheets of the bundle's own deformations, with noise."""
    rng = np.random.default_rng(seed)
    logs = rng.multivariate_normal(known.untouched_mean, known.untouched_covariance, count)
    return np.expm1(logs) + sigma * rng.standard_normal(logs.shape)


def alarms(gate, gate_without_rows, changes):
    """Return the share of frames that are called touched, one at a time as the runtime does it."""
    tripped = 0
    for change in changes.astype(np.float32):
        gate_without_rows.fill(change)
        gate.change[:] = change
        tripped += gate.touched()
    return tripped / len(changes)


def test_many_frames_are_judged_as_each_by_itself(shipped):
    known, arrays = shipped
    gate = Gate(arrays)
    changes = untouched(known, 50, QUIET).astype(np.float32)
    changes[3:6, 7] = [-1.0, -2.0, 30.0]
    single = []
    for change in changes:
        gate.change[:] = change
        gate.touched()
        single.append(gate.logit)
    np.testing.assert_allclose(gate.logits(changes), single, rtol=2e-5, atol=2e-4)  # sums of float32 in another order


@pytest.mark.parametrize("electrodes", [(5,), (0, 9)])
def test_without_electrodes_the_gate_keeps_its_rate_of_false_alarms(shipped, electrodes):
    known, arrays = shipped
    gate = Gate(arrays)
    gate_without_rows = GateWithoutRows(known, gate, QUIET)
    gate_without_rows.leave_out(rows_of(electrodes))
    assert gate.threshold == gate.usual_threshold  # until the sheets are judged
    gate_without_rows.finish()
    changes = untouched(known, 3000, QUIET)
    changes[:, rows_of(electrodes)] = 7.0  # whatever a dead electrode reads
    # 3000 frames at a rate of 0.003 trip it 9 times, give or take 3; the threshold's own 2000 make that 5 more
    assert alarms(gate, gate_without_rows, changes) < FALSE_ALARMS + 5 * np.sqrt(2 * FALSE_ALARMS / 3000)
    assert alarms(Gate(arrays), GateWithoutRows(known, Gate(arrays), QUIET), changes) == 1.0  # without any of this


def test_noise_beyond_what_the_gate_learned_raises_its_threshold_and_less_does_not_lower_it(shipped):
    known, arrays = shipped
    gate, sigma = Gate(arrays), np.full(N_ROWS, 0.02)
    gate_without_rows = GateWithoutRows(known, gate, sigma)
    assert gate_without_rows.due
    gate_without_rows.finish()
    assert gate.threshold > gate.usual_threshold
    changes = untouched(known, 2000, sigma)
    assert alarms(gate, gate_without_rows, changes) < FALSE_ALARMS + 5 * np.sqrt(2 * FALSE_ALARMS / 2000)
    assert (Gate(arrays).logits(changes) > gate.usual_threshold).mean() > 0.1  # as it would be
    assert not GateWithoutRows(known, Gate(arrays), QUIET).due


def test_thresholds_are_no_matter_of_luck_and_come_back_with_the_rows(shipped):
    known, arrays = shipped
    gate = Gate(arrays)
    gate_without_rows = GateWithoutRows(known, gate, QUIET)
    found = []
    for _ in range(2):
        gate_without_rows.leave_out(rows_of((3,)))
        gate_without_rows.finish()
        found.append(gate.threshold)
    assert found[0] == found[1] != gate.usual_threshold
    gate_without_rows.leave_out(np.zeros(N_ROWS, dtype=np.bool_))
    assert gate.threshold == gate.usual_threshold
    assert not gate_without_rows.due


def test_the_threshold_is_set_while_the_line_rests_a_block_at_a_time(shipped):
    known, arrays = shipped
    gate, health = Gate(arrays), Health(shipped[0])
    health.use(known.reference, 0.003 * np.abs(known.reference), gate)
    assert not health.due
    health.exclude((4,))
    looks = 0
    while health.due:
        health.look(np.zeros(N_ROWS, dtype=np.float32))
        looks += 1
        assert looks < 2 * BLOCKS
    assert looks >= BLOCKS
    assert gate.threshold != gate.usual_threshold
