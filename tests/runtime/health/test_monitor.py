"""The pipeline goes on without an electrode: rows filled in before the gate, columns out of the projection, events."""

import time

import numpy as np
import pytest

from eitskin.health.electrodes import HEALTHY
from eitskin.health.monitor import health_of
from eitskin.model.bundle import default_path, load_bundle
from eitskin.model.geometry import GeometryGraph
from eitskin.pipeline.frame_pipeline import Pipeline
from eitskin.reference.captured import Reference
from eitskin_proto.sensor.row_gaussian import rows_of
from eitskin_proto.wire.frames import Frame


@pytest.fixture
def watching(hello, counts):
    bundle = load_bundle(default_path("units"))
    health = health_of(bundle, exclude=(5,))
    pipeline = Pipeline(bundle, hello, budget_ns=10**10, health=health)  # with a budget it keeps every solver ready
    if health is None:
        pytest.skip("the shipped bundle has no consistency.npz; 'eitskin export' makes one")
    pipeline.use_reference(Reference(counts * 1e-9, np.abs(counts) * 3e-12, 100, "TEST-1", 0xABCD, "paper", ""))
    pipeline.start_with(GeometryGraph(bundle).geometry(None, None, 0))
    return pipeline


def go(pipeline, counts, sequence):
    counts = counts + np.random.default_rng(sequence).integers(-9, 10, 104)  # a living front end repeats no row
    packed = Frame(sequence=sequence, device_us=sequence * 5000, counts=counts).pack()
    done = pipeline.accept(packed, time.perf_counter_ns()) and pipeline.compute(True)
    pipeline.keep_for_health()
    if pipeline.has_leisure_work:
        pipeline.check_health()
    return done


def test_a_dead_electrode_does_not_touch_the_sheet(watching, counts):
    gate = watching.health.gate_without_rows
    assert gate is not None
    assert not gate.due  # its threshold was set when the reference came
    rng = np.random.default_rng(0)
    for number in range(1, 21):
        dead = np.rint(counts * (1.0 + 0.003 * rng.standard_normal(104))).astype(np.int32)
        dead[rows_of((5,))] = rng.integers(-10_000, 10_000, 26)
        assert go(watching, dead, number)
        assert not watching.record.touched


def test_a_row_that_does_not_stand_out_of_its_noise_is_filled_in_and_counted(watching, counts):
    watching.health.exclude(())
    watching.health.examine(np.zeros(104, dtype=np.float32))
    spread = np.abs(counts) * 3e-12
    spread[[7, 60]] = np.abs(counts[[7, 60]]) * [0.5e-9, 0.1e-9]  # one is lost, one is weighed
    watching.use_reference(Reference(counts * 1e-9, spread, 100, "TEST-1", 0xABCD, "paper", ""))
    assert watching.normaliser.weak_count == 1
    loud = counts.copy()
    loud[[7, 60]] = counts[[7, 60]] * [3, 1.1]
    assert go(watching, loud, 1)
    change = watching.buffers.change[0]
    assert abs(change[7]) < 0.02  # as measured it is 2
    assert 0.0 < change[60] < 0.05  # as measured it is 0.1, its noise
    assert not watching.record.touched


def test_what_changes_is_an_event_of_the_next_frame(watching, counts):
    go(watching, counts, 1)
    watching.health.exclude((5, 9))
    go(watching, counts, 2)
    go(watching, counts, 3)
    assert "electrode:9:excluded:imputed" in watching.record.events
    assert watching.health.lacks_rows
    watching.health.exclude(())
    go(watching, counts, 4)
    go(watching, counts, 5)
    assert {"electrode:5:back", "electrode:9:back"} <= set(watching.record.events)
    assert not watching.health.lacks_rows
    assert HEALTHY > 5  # by hand it does not take a second


def test_frames_at_rest_are_averaged_by_the_rows_that_are_there(watching, counts):
    watching.maps.keeps_unchanged = watching.decisions.touched = True
    rng = np.random.default_rng(0)
    for number in range(1, 41):
        assert go(watching, np.rint(counts * (1.0 + 0.003 * rng.standard_normal(104))).astype(np.int32), number)
    assert watching.record.fused == 32
