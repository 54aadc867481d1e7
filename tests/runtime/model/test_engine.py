import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from eitskin.errors import BundleError
from eitskin.model.buffers import Buffers
from eitskin.model.engine import HeadEngine, default_solver, engines
from eitskin.model.gate import Gate
from eitskin.model.geometry import GeometryGraph
from eitskin.model.session import onnxruntime
from eitskin.pipeline.frame_pipeline import Pipeline
from eitskin_proto.skin.cloud import flat_cloud


@pytest.fixture
def change():
    return np.random.default_rng(5).normal(0, 0.1, 104).astype(np.float32)


def bent():
    cloud = flat_cloud()
    angle = (cloud[0] - 75) / 60
    cloud[0], cloud[2] = 75 + 60 * np.sin(angle), 60 * (1 - np.cos(angle))
    return cloud


def test_the_bound_engine_gives_what_a_plain_session_gives(tiny, change):
    buffers = Buffers(tiny)
    buffers.use_geometry(GeometryGraph(tiny).geometry(bent(), np.full(104, 0.05, np.float32), 1))
    buffers.change[0] = change
    HeadEngine(tiny, "head.onnx", "vd2t", buffers).infer()
    session = onnxruntime.InferenceSession(tiny.files["head.onnx"], providers=["CPUExecutionProvider"])
    inputs = {"dv": buffers.change, "bias": buffers.bias, "log_predicted": buffers.log_predicted}
    assert np.array_equal(buffers.map, session.run(None, inputs)[0])


def test_the_cloud_and_the_prediction_reach_the_map(tiny, change):
    graph, buffers = GeometryGraph(tiny), Buffers(tiny)
    engine = HeadEngine(tiny, "head.onnx", "vd2t", buffers)
    buffers.change[0] = change
    maps = []
    for geometry in (
        graph.geometry(None, None, 0),
        graph.geometry(bent(), None, 1),
        graph.geometry(bent(), np.full(104, 0.3, np.float32), 2),
    ):
        buffers.use_geometry(geometry)
        engine.infer()
        maps.append(buffers.map.copy())
    assert buffers.revision == 2
    assert np.abs(maps[0] - maps[1]).max() > 1e-3
    assert np.abs(maps[1] - maps[2]).max() > 1e-3


def peak_bytes(step):
    for _ in range(5):
        step()
    tracemalloc.start()
    step()
    tracemalloc.reset_peak()
    before = tracemalloc.get_traced_memory()[0]
    step()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak - before


def test_inference_and_the_gate_make_no_array(tiny, change):
    buffers = Buffers(tiny)
    buffers.change[0] = change
    gate = Gate(tiny.gate_arrays())
    steps = [*(engine.infer for engine in engines(tiny, buffers)), gate.touched]
    idle = peak_bytes(lambda: None)
    for step in steps:
        # a reduction and its Python objects take up to 1000 bytes for a moment; a copy of the map would take 5400
        assert peak_bytes(step) - idle < 1200
    assert peak_bytes(lambda: buffers.map + 1.0) - idle > 5000


def test_a_gate_of_two_hidden_layers_and_a_floor_computes_what_its_formula_says(change):
    rng = np.random.default_rng(2)
    arrays = {
        "mean": rng.normal(size=208), "scale": rng.uniform(0.5, 2, 208), "w1": 0.1 * rng.normal(size=(208, 48)),
        "b1": rng.normal(size=48), "w2": 0.1 * rng.normal(size=(48, 16)), "b2": rng.normal(size=16),
        "w3": rng.normal(size=16), "b3": np.array([0.3]), "threshold": np.array(0.1), "floor": np.array(0.05),
    }  # fmt: skip
    gate = Gate(arrays)
    change[5] = -0.99
    features = np.concatenate([change, np.log(np.maximum(1 + change.astype(np.float64), 0.05))])
    hidden = np.maximum((features - arrays["mean"]) / arrays["scale"] @ arrays["w1"] + arrays["b1"], 0)
    logit = np.maximum(hidden @ arrays["w2"] + arrays["b2"], 0) @ arrays["w3"] + 0.3
    gate.change[:] = change
    assert gate.touched() == (logit > 0.1)
    assert gate.logit == pytest.approx(logit, abs=1e-3)  # float32 sums of 208 terms of order one
    with pytest.raises(BundleError, match="b3"):
        Gate({name: value for name, value in arrays.items() if name != "b3"})
    with pytest.raises(BundleError, match=r"w2 has shape \(16, 48\), expected \(48, 16\)"):
        Gate(arrays | {"w2": arrays["w2"].T})
    with pytest.raises(BundleError, match="floor is 0, expected more than 0"):
        Gate(arrays | {"floor": np.array(0.0)})


@pytest.mark.parametrize("name", ["mean", "w1", "threshold"])
def test_a_gate_with_a_missing_or_infinite_array_is_refused(tiny, name):
    arrays = tiny.gate_arrays()
    with pytest.raises(BundleError, match=name):
        Gate({key: value for key, value in arrays.items() if key != name})
    with pytest.raises(BundleError, match=name):
        Gate(arrays | {name: np.full_like(arrays[name], np.inf)})


@pytest.mark.parametrize(
    ("card", "solver"),
    [
        ({"int8": {"flipped": 0.0003}}, "vd2t-int8"),  # less than half a pixel of 1350 a frame
        ({"int8": {"flipped": 0.0}}, "vd2t-int8"),
        ({"int8": {"flipped": 1 / 1350}}, "vd2t"),
        ({"int8": {"flipped": float("nan")}}, "vd2t"),
        ({"int8": {"flipped": "little"}}, "vd2t"),
        ({"int8": None}, "vd2t"),
        ({}, "vd2t"),
    ],
)
def test_the_int8_head_is_taken_alone_where_the_card_says_that_it_shows_the_same(tiny, hello, card, solver):
    bundle = replace(tiny, manifest={**tiny.manifest, "metrics": card})
    assert default_solver(bundle) == solver
    assert [engine.name for engine in Pipeline(bundle, hello).engines] == [solver]
    assert [engine.name for engine in Pipeline(bundle, hello, 10**9).engines] == ["vd2t", "vd2t-int8", "tikhonov"]
    assert [engine.name for engine in Pipeline(bundle, hello, solver="vd2t").engines] == ["vd2t"]


def test_a_graph_that_fails_while_it_is_computed_is_one_line(tiny, tmp_path):
    onnx = pytest.importorskip("onnx")
    graph = onnx.load_model_from_string(tiny.files["head.onnx"])
    beyond = onnx.numpy_helper.from_array(np.array([10**6], dtype=np.int64), "beyond")
    graph.graph.initializer.append(beyond)
    gather = onnx.helper.make_node("Gather", ["dv", "beyond"], ["nothing"], axis=1)
    product = onnx.helper.make_node("Mul", ["was", "nothing"], ["map"])
    for node in graph.graph.node:
        node.output[:] = ["was" if name == "map" else name for name in node.output]
    graph.graph.node.extend([gather, product])
    broken = replace(tiny, files={**tiny.files, "head.onnx": graph.SerializeToString()})
    engine = HeadEngine(broken, "head.onnx", "vd2t", Buffers(broken))
    with pytest.raises(BundleError, match="vd2t cannot be computed") as caught:
        engine.infer()
    assert "\n" not in str(caught.value)
