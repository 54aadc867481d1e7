"""Products of 8-bit numbers are exact on every processor: pairs of them pass what 16 bits hold."""

import numpy as np
import pytest

from eitskin.model.session import onnxruntime, session_options

onnx = pytest.importorskip("onnx", reason="no onnx to make a graph with")

WIDTH = 64


def multiplied(options, values, weights):
    """Return values (1, 64) times weights (64, n), each of 8 bits, as a quantised layer multiplies them."""
    node = onnx.helper.make_node("MatMulInteger", ["values", "weights"], ["product"])
    graph = onnx.helper.make_graph(
        [node],
        "product",
        [onnx.helper.make_tensor_value_info("values", onnx.TensorProto.UINT8, values.shape)],
        [onnx.helper.make_tensor_value_info("product", onnx.TensorProto.INT32, (1, weights.shape[1]))],
        [onnx.numpy_helper.from_array(weights, "weights")],
    )
    model = onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 17)], ir_version=8)
    session = onnxruntime.InferenceSession(model.SerializeToString(), options, providers=["CPUExecutionProvider"])
    return session.run(None, {"values": values})[0]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("columns", [1, 16, 30, 340])
def test_the_largest_products_do_not_overflow(columns, seed):
    rng = np.random.default_rng(seed)
    values = rng.integers(200, 256, (1, WIDTH)).astype(np.uint8)
    weights = rng.choice([-127, 127, 100], (WIDTH, columns)).astype(np.int8)
    expected = values.astype(np.int64) @ weights.astype(np.int64)
    assert np.array_equal(multiplied(session_options(), values, weights), expected)
