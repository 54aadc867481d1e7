"""Reciprocity: a closed form of the gap, what noise and touches make of it, and the stream that acts on it."""

import time
from dataclasses import replace

import numpy as np
import pytest

from eitskin.health.electrodes import HEALTHY
from eitskin.health.monitor import MAX_BATCH, health_of
from eitskin.health.reciprocity import AGREEING_FRAMES, Reciprocity, electrode_gaps, row_gaps
from eitskin.model.bundle import default_path, load_bundle
from eitskin.model.geometry import GeometryGraph
from eitskin.pipeline.frame_pipeline import Pipeline
from eitskin.reference.captured import Reference
from eitskin_proto.sensor.row_gaussian import rows_of
from eitskin_proto.sensor.table import FULL_TABLE, N_FULL_ROWS, RECIPROCAL_IN_FULL, ROW_IN_FULL
from eitskin_proto.wire.frames import Frame, FrameFlag


def both_ways(counts: np.ndarray) -> np.ndarray:
    """Return (208,) counts of a sheet, alike both ways, from (104,)."""
    found = np.zeros(N_FULL_ROWS, dtype=np.int32)
    found[ROW_IN_FULL] = found[RECIPROCAL_IN_FULL] = counts
    return found


def weak(counts: np.ndarray, electrode: int, share: float) -> np.ndarray:
    """Return the frame of an electrode that drives only a share of the current, and reads well."""
    drives = np.isin(FULL_TABLE[:, 0], ((electrode - 1) % 16, electrode))
    return np.where(drives, counts * share, counts).astype(np.int32)


@pytest.mark.parametrize("electrode", range(16))
def test_a_share_of_the_current_is_a_gap_that_can_be_written_down(electrode, counts):
    share = 0.8
    apart, size = row_gaps(weak(both_ways(counts), electrode, share))
    gaps = electrode_gaps(np.abs(apart) / size)
    # V against share V: 0.2 of 1.8; rows between its own two pairs do not exist, the table leaves neighbours out.
    assert gaps[electrode] == pytest.approx(0.2 / 1.8, rel=1e-3)
    assert np.delete(gaps, electrode).max() < 1e-3


def test_a_reciprocal_sheet_is_never_suspected_under_noise(counts):
    rng = np.random.default_rng(0)
    whole = both_ways(counts)
    sigma = 10 ** (-50 / 20) * np.sqrt(np.mean(np.square(counts, dtype=np.float64)))
    watched, largest = Reciprocity(), 0.0
    for _ in range(400):
        watched.add(whole + np.rint(sigma * rng.standard_normal(N_FULL_ROWS)).astype(np.int32))
        largest = max(largest, float(watched.gaps.max()))
        assert watched.suspect is None
    assert largest > 0.0


def test_a_suspect_needs_its_frames_in_a_row(counts):
    watched, whole = Reciprocity(), both_ways(counts)
    for _ in range(20):
        watched.add(whole)
    took = 0
    while watched.suspect is None:
        watched.add(weak(whole, 5, 0.8))
        took += 1
    assert watched.suspect == 5
    # The running mean passes 3 % of 11 % after three frames; then all of them count.
    assert AGREEING_FRAMES <= took <= AGREEING_FRAMES + 3
    watched.add(weak(whole, 5, 0.8), frozenset({5}))
    assert watched.suspect is None, "what is out of use already is no news"


@pytest.fixture
def watching(hello, counts):
    bundle = load_bundle(default_path("units"))
    health = health_of(bundle)
    pipeline = Pipeline(bundle, replace(hello, rows=N_FULL_ROWS), budget_ns=None, health=health)
    if health is None:
        pytest.skip("the shipped bundle has no consistency.npz; 'eitskin export' makes one")
    reference = np.asarray(bundle.consistency_arrays()["reference"]) * 1e-3
    pipeline.use_reference(Reference(reference, np.abs(reference) * 3e-3, 100, "TEST-1", 0xABCD, "full208", ""))
    pipeline.start_with(GeometryGraph(bundle).geometry(None, None, 0))
    return pipeline, both_ways(np.rint(reference / hello.volts_per_count))


def go(pipeline, counts, sequence):
    counts = counts + np.random.default_rng(sequence).integers(-99, 100, 208)  # a living front end repeats no row
    packed = Frame(sequence=sequence, device_us=sequence * 5000, counts=counts, flags=FrameFlag.FULL).pack()
    assert pipeline.accept(packed, time.perf_counter_ns())
    assert pipeline.compute(True)
    pipeline.keep_for_health()
    if pipeline.has_leisure_work:
        pipeline.check_health()


def test_the_stream_names_it_in_time_fills_it_in_and_takes_it_back(watching):
    pipeline, whole = watching
    health = pipeline.health
    for sequence in range(30):
        go(pipeline, whole, sequence)
    assert health.electrodes.texts == ()
    ill = weak(whole, 5, 0.9)  # a gap of 5 %, a change of 5 % in 26 averaged rows: less than a touch
    took = 0
    while not health.electrodes.texts:
        took += 1
        go(pipeline, ill, 29 + took)
        assert took <= 20, "named within 20 frames"
    assert health.electrodes.texts == ("5:not reciprocal:imputed",)
    go(pipeline, ill, 30 + took)
    assert "electrode:5:not reciprocal:imputed" in pipeline.record.events
    np.testing.assert_array_equal(health.electrodes.missing, rows_of((5,)))
    begin, frames = 31 + took, 0
    while health.electrodes.texts:
        go(pipeline, whole, begin + frames)
        frames += 1
        assert frames < 2 * HEALTHY
    assert frames >= HEALTHY
    assert frames <= HEALTHY + 10 + MAX_BATCH  # the running mean first has to forget
