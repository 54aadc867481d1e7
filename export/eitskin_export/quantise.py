"""The head with 8-bit weights: a quarter of the bytes a frame, at an error that is measured and stated.

Weights are rounded per output channel when exported; activations are scaled to 8 bits as they come (dynamic). The
first layer stays in float32: dV spans -1 to 2 while a touch moves it by 0.05, so eight bits there would blur the
touch itself. It is the smallest layer.
"""

import tempfile
from pathlib import Path

import onnx

import eitskin.model.session  # noqa: F401 -- before the next line: it sends no telemetry  # isort: skip
from onnxruntime.quantization import QuantType, quantize_dynamic  # isort: skip

from eitskin_export.graphs import check, quiet


def first_product(graph: bytes) -> str:
    """Return the name of the first matrix product in a graph."""
    model = onnx.load_from_string(graph)
    return next(str(node.name) for node in model.graph.node if node.op_type in {"Gemm", "MatMul"})


def int8_head(graph: bytes) -> bytes:
    """Return a head with dynamically quantised layers, all but the first."""
    first = first_product(graph)
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "head.onnx", Path(folder) / "int8.onnx"
        model = onnx.load_from_string(graph)
        del model.graph.value_info[:]  # the shapes of transposed weights, which quantising turns round
        onnx.save_model(model, source)
        with quiet():
            quantize_dynamic(
                source,
                target,
                weight_type=QuantType.QInt8,
                per_channel=True,
                op_types_to_quantize=["MatMul", "Gemm"],
                nodes_to_exclude=[first, f"{first}_MatMul"],  # the quantiser renames a Gemm before it looks
            )
        model = onnx.load(target)
        check(model)
    original = onnx.load_from_string(graph)
    onnx.helper.set_model_props(model, {item.key: item.value for item in original.metadata_props})
    return bytes(model.SerializeToString())
