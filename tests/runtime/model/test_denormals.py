"""No number that is slow to compute reaches the arithmetic, whatever a cloud, a prediction or a bundle holds."""

from types import SimpleNamespace

import numpy as np
import pytest

from eitskin.model.buffers import Buffers
from eitskin.model.bundle import load_bundle
from eitskin.model.denormals import SMALLEST, flushed, is_small
from eitskin.model.engine import ProjectionEngine
from eitskin.model.gate import Gate
from eitskin.model.onnx_graph import GRAPH, INITIALISER, content, fields_of, without_small_weights
from eitskin_proto.skin.skin import PAPER

DENORMAL = np.float32(1e-40)


def test_what_is_too_small_becomes_0_and_nothing_else_changes():
    values = np.array([1.0, -DENORMAL, 0.0, SMALLEST / 2, SMALLEST, -1e-16, np.nan, np.inf], dtype=np.float32)
    expected = np.array([1.0, 0.0, 0.0, 0.0, SMALLEST, -1e-16, np.nan, np.inf], dtype=np.float32)
    found = flushed(values)
    assert np.array_equal(found, expected, equal_nan=True)
    assert found.dtype == np.float32
    assert values[1] == -DENORMAL
    assert flushed(found) is found


def with_tiny_weights(model):
    """Return a model of which the first weight of every initialiser's data is a denormal."""
    changed = bytearray(model)
    for field in fields_of(memoryview(changed)):
        for inside in fields_of(content(field)) if field.number == GRAPH else ():
            if inside.number == INITIALISER:
                for part in fields_of(content(inside)):
                    if part.number == 9 and len(content(part)) >= 4 * 75:
                        content(part)[:4] = DENORMAL.tobytes()
    return bytes(changed)


def test_a_networks_denormal_weights_are_0_before_it_is_loaded(tiny):
    model = tiny.files["head.onnx"]
    damaged = with_tiny_weights(model)
    assert damaged.count(DENORMAL.tobytes()) == 2
    mended = without_small_weights(damaged)
    assert DENORMAL.tobytes() not in mended
    assert len(mended) == len(model)
    assert sum(a != b for a, b in zip(mended, damaged, strict=True)) <= 8


@pytest.mark.parametrize("labels", ["area", "units"])
def test_a_shipped_network_is_loaded_as_it_is(labels):
    from eitskin.model.bundle import default_path

    bundle = load_bundle(default_path(labels))
    for name in (name for name in bundle.files if name.endswith(".onnx")):
        model = bundle.files[name]
        assert without_small_weights(model) is model
    assert not is_small(bundle.tikhonov()).any()


def test_what_is_no_network_is_left_for_onnx_runtime_to_refuse(tiny):
    model = with_tiny_weights(tiny.files["head.onnx"])
    for length in range(0, len(model), 7):
        assert len(without_small_weights(model[:length])) == length
    rng = np.random.default_rng(0)
    for _ in range(300):
        noise = rng.bytes(int(rng.integers(0, 60)))
        assert len(without_small_weights(noise)) == len(noise)


def test_a_projections_denormals_are_0_also_after_rows_were_taken_out():
    matrix = np.full((1350, 104), 0.5, dtype=np.float32)
    matrix[::2] = DENORMAL
    bundle = SimpleNamespace(tikhonov=lambda: matrix, bias_width=8, beside={}, skin=PAPER)
    buffers = Buffers(bundle)
    engine = ProjectionEngine(bundle, buffers)
    buffers.change[0] = 1e6
    for change in (lambda whole: whole, lambda whole: whole - whole + DENORMAL):
        engine.change_matrix(change)
        engine.infer()
        assert not is_small(buffers.map).any()
        assert not buffers.map[0, ::2].any()
    assert not buffers.map.any()


def test_a_gates_denormal_weights_count_as_0(tiny):
    arrays = {name: np.array(value) for name, value in tiny.gate_arrays().items()}
    zeros = dict(arrays)
    arrays["w1"] = np.full_like(arrays["w1"], 1e-39)
    zeros["w1"] = np.zeros_like(arrays["w1"])
    logits = []
    for found in (Gate(arrays), Gate(zeros)):
        found.change[:] = 1e5
        found.touched()
        logits.append(found.logit)
    assert logits[0] == logits[1]
