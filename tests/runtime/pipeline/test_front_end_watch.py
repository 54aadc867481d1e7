"""Frames that no living front end sends are withheld, with their reason; the next fit one says so."""

import numpy as np
import pytest

from eitskin.health.monitor import health_of
from eitskin.model.bundle import load_bundle
from eitskin.model.geometry import GeometryGraph
from eitskin.pipeline.frame_pipeline import Pipeline
from eitskin.reference.captured import Reference

from .passing import go, payload

NOISE = 3e-3


def referred(pipeline, counts, noise=NOISE):
    pipeline.use_reference(Reference(counts * 1e-9, np.abs(counts) * noise * 1e-9, 100, "TEST-1", 0xABCD, "paper", ""))
    return pipeline


@pytest.fixture
def noisy(pipeline, counts):
    return referred(pipeline, counts)


def living(counts, count, seed=0, noise=NOISE):
    rng = np.random.default_rng(seed)
    return np.rint(counts * (1.0 + noise * rng.standard_normal((count, 104)))).astype(np.int32)


def watched(bundle, hello):
    """Return a pipeline that fills rows in, and its bundle's flat sheet in counts."""
    flat = bundle.consistency_arrays()["reference"]
    counts = flat / np.abs(flat).max() * 4e6
    pipeline = referred(Pipeline(bundle, hello, health=health_of(bundle)), counts)
    pipeline.start_with(GeometryGraph(bundle).geometry(None, None, 0))
    return pipeline, counts


def show(pipeline, frames, first=1):
    """Return of each frame whether it is published as untouched, and all events."""
    seen, events = [], []
    for number, frame in enumerate(frames, start=first):
        passes = go(pipeline, payload(frame, number))
        seen.append(passes and not pipeline.record.touched)
        if passes:
            events += pipeline.record.events
            pipeline.keep_for_health()
        if pipeline.has_leisure_work:
            pipeline.check_health()
    return seen, events


def test_rows_at_one_count_are_withheld_and_the_next_frame_says_so(noisy, counts):
    for number, value in enumerate((2**31 - 1, -(2**31), 1_000_000, 1)):
        assert not go(noisy, payload(np.full(104, value, dtype=np.int32), number))
    assert (noisy.intake.withheld["stuck"], noisy.intake.withheld["no_signal"]) == (3, 1)
    assert go(noisy, payload(counts, 9))
    assert {"withheld:stuck", "withheld:no_signal"} <= set(noisy.record.events)


def test_a_frame_that_comes_again_is_withheld_from_rings_of_up_to_a_second(noisy, counts):
    frames = living(counts, 200)
    assert all(go(noisy, payload(frame, number)) for number, frame in enumerate(frames))
    again = [go(noisy, payload(frames[136 + number % 64], 200 + number)) for number in range(400)]
    assert not any(again[6:])
    assert noisy.intake.withheld["frozen"] >= 394
    assert all(go(noisy, payload(frame, 600 + number)) for number, frame in enumerate(living(counts, 200, 1)))
    assert go(noisy, payload(frames[0], 800)), "what is long past is forgotten"


@pytest.mark.parametrize("rows", [slice(0, 12), slice(40, 41), slice(0, 52)])
def test_rows_that_hang_are_named_and_filled_in_until_they_move(hello, rows):
    pipeline, counts = watched(load_bundle(), hello)
    show(pipeline, living(counts, 20))
    frames = living(counts, 300, 1)
    frames[:60, rows] = frames[0, rows]
    seen, events = show(pipeline, frames[:60], 21)
    assert "rows:" in " ".join(events)
    assert np.array_equal(np.flatnonzero(pipeline.health.electrodes.missing), np.arange(104)[rows])
    assert pipeline.record.weak_rows == len(range(104)[rows])
    assert all(seen[20:])
    _, events = show(pipeline, frames[60:], 100)
    assert any(event.startswith("rows:") and event.endswith(":back") for event in events)
    assert not pipeline.health.lacks_rows


@pytest.mark.parametrize("level", [0.2, 1.0, 3.0])
def test_honest_repeats_of_a_coarse_converter_are_no_fault(pipeline, hello, level):
    counts = np.geomspace(1000.0, 30.0, 104)
    rng = np.random.default_rng(4)
    frames = np.rint(counts + level * rng.standard_normal((2000, 104)))
    spread = frames[:100].std(axis=0)
    reference = Reference(frames[:100].mean(axis=0) * 1e-9, spread * 1e-9, 100, "TEST-1", 0xABCD, "paper", "")
    pipeline.use_reference(reference)
    assert all(go(pipeline, payload(frame.astype(np.int32), number)) for number, frame in enumerate(frames[100:]))


def turned(frame, how):
    """Return a frame that a front end has turned or exchanged in some way."""
    found = frame.copy()
    if how == "all":
        return -found
    if how == "half":
        found[::2] *= -1
    elif how == "a drive":
        found[:13] *= -1
    else:
        found[[0, 6]] = found[[6, 0]]
    return found


@pytest.mark.parametrize("name", ["free", "press"])
@pytest.mark.parametrize(
    ("how", "reason"), [("all", "reversed"), ("half", "reversed"), ("a drive", "reversed"), ("exchanged", "unlike")]
)
def test_signs_that_turn_and_columns_that_are_exchanged_are_no_touch(hello, name, how, reason):
    pipeline, counts = watched(load_bundle(name), hello)
    show(pipeline, living(counts, 20))
    seen, events = show(pipeline, [turned(frame, how) for frame in living(counts, 50, 1)], 21)
    assert pipeline.intake.withheld[reason] > 5 or "electrode:0:detached:imputed" in events
    assert pipeline.intake.withheld_total + sum(seen) == 50, "none is published as touched"
    show(pipeline, living(counts, 300, 2), 100)
    assert go(pipeline, payload(living(counts, 1, 3)[0], 500))
    assert not pipeline.record.touched
