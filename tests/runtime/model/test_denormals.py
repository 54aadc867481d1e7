"""No number that is slow to compute reaches the arithmetic, whatever a cloud, a prediction or a bundle holds."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from eitskin.model import geometry as geometry_module
from eitskin.model.buffers import Buffers
from eitskin.model.bundle import load_bundle
from eitskin.model.denormals import SMALLEST, flushed, is_small
from eitskin.model.engine import HeadEngine, ProjectionEngine
from eitskin.model.gate import Gate
from eitskin.model.geometry import GeometryGraph
from eitskin.model.onnx.protobuf import GRAPH, INITIALISER, content, fields_of
from eitskin.model.onnx.small_weights import without_small_weights
from eitskin.model.session import onnxruntime
from eitskin_proto.skin.cloud import flat_cloud
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


def test_a_cloud_of_denormals_is_flat_before_the_graph_sees_it(tiny, monkeypatch):
    seen = []

    def recording(bundle, file, graph):
        session = open_session(bundle, file, graph)

        def run(names, feed):
            seen.append(feed["cloud"].copy())
            return [np.full((1, tiny.bias_width), DENORMAL)]

        return SimpleNamespace(get_inputs=session.get_inputs, get_outputs=session.get_outputs, run=run)

    open_session = geometry_module.open_session
    monkeypatch.setattr(geometry_module, "open_session", recording)
    for size in (1e-36, 1e-38, 1e-40, 1e-43, 5e-324):
        cloud = flat_cloud()
        cloud[2] = size * np.random.default_rng(1).standard_normal(cloud[2].shape)
        found = GeometryGraph(tiny).geometry(cloud, np.full(104, DENORMAL), 1)
        assert not is_small(seen[-1]).any(), size
        assert not found.bias.any()
        assert not found.log_predicted.any()
    assert len(seen) == 5


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


def test_what_is_loaded_is_what_was_mended(tiny, monkeypatch):
    loaded = []
    make = onnxruntime.InferenceSession
    monkeypatch.setattr(
        onnxruntime, "InferenceSession", lambda model, *a, **k: loaded.append(model) or make(model, *a, **k)
    )
    mended = replace(tiny, files={**tiny.files, "head.onnx": with_tiny_weights(tiny.files["head.onnx"])})
    HeadEngine(mended, "head.onnx", "vd2t", Buffers(tiny))
    assert len(loaded) == 1
    assert DENORMAL.tobytes() not in loaded[0]


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
