"""A press that no frame shows by itself reaches the map, and a new reference begins anew."""

import io
from dataclasses import replace

import numpy as np
import pytest

from eitskin.model.gate import MIN_UNTOUCHED
from eitskin.model.geometry import GeometryGraph
from eitskin.pipeline.frame_pipeline import Pipeline
from eitskin.reference.captured import Reference

from .passing import go, payload

WHITENED, FILTERS, LIMIT, STILL = 40, 16, 7.0, 0.25
SIZE = 0.05
"""By which devices and bends change a row."""

RNG = np.random.default_rng(0)
WHITENING = np.linalg.qr(RNG.normal(size=(104, WHITENED)))[0] / SIZE
PATTERNS = np.abs(RNG.normal(size=(WHITENED, FILTERS))) ** 3
PATTERNS /= np.linalg.norm(PATTERNS, axis=0)


@pytest.fixture
def reference(counts):
    return Reference(counts * 1e-9, counts * 0.0, 2, "TEST-1", 0xABCD, "paper", "")


@pytest.fixture
def remembering(tiny, hello, reference):
    """Return a pipeline whose gate is made of matched filters."""
    first = np.concatenate([WHITENING, -WHITENING, WHITENING @ PATTERNS], axis=1)
    second = np.concatenate([np.full((2 * WHITENED, FILTERS), -LIMIT / WHITENED), np.eye(FILTERS)])
    arrays = {
        "floor": np.array(0.05), "mean": np.zeros(208), "scale": np.ones(208), "threshold": np.zeros(1),
        "w1": np.concatenate([np.zeros_like(first), first]).astype(np.float32),
        "b1": np.zeros(first.shape[1]), "w2": second, "b2": np.full(FILTERS, -LIMIT * STILL),
        "w3": np.ones(FILTERS), "b3": np.zeros(1),
    }  # fmt: skip
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    bundle = replace(tiny, files={**tiny.files, "gate.npz": stream.getvalue()})
    pipeline = Pipeline(bundle, hello)
    pipeline.use_reference(reference)
    pipeline.start_with(GeometryGraph(bundle).geometry(None, None, 0))
    return pipeline


def test_a_press_that_no_frame_shows_by_itself_gets_a_map_and_a_new_reference_begins_anew(
    remembering, counts, reference, hello
):
    bend = SIZE * RNG.standard_normal(104)
    press = 7.0 * np.linalg.pinv(WHITENING.T) @ PATTERNS[:, 2]
    sequence = 0

    def show(logs, frames):
        nonlocal sequence
        found = []
        for _ in range(frames):
            seen = counts * np.exp(logs) * (1.0 + 0.002 * RNG.standard_normal(104))
            assert go(remembering, payload(np.rint(seen).astype(np.int32), sequence))
            found.append(remembering.record.touched)
            sequence += 1
        return found

    assert not any(show(bend, 100))
    assert all(show(bend + press, 20))
    assert remembering.record.solver == "vd2t"
    assert remembering.record.gate_logit <= remembering.gate.threshold  # by itself it is untouched, and says so
    assert not any(show(bend, 20))
    for begin in (lambda: remembering.use_reference(reference), lambda: remembering.greet(hello)):
        begin()
        assert remembering.gate.changes.seen == 0
        assert not any(show(bend + press, MIN_UNTOUCHED - 1))
        assert not any(show(bend, 100))
        assert any(show(bend + press, 5))
