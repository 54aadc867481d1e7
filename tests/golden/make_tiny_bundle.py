"""Writes the hand-made bundles of the runtime's tests: tiny.eitskin of the paper's skin, second.eitskin of another.

The graphs have the real signatures, but their weights are drawn from fixed seeds, with 8 hidden values and a map that
is the sum of a column profile and a row profile; nothing was trained. The gate adds |dV| over all rows: it is exact on
synthetic frames, where only a touch changes dV. ::

    python -m tests.golden.make_tiny_bundle tests/golden/tiny.eitskin tests/golden/second.eitskin

It needs onnx and onnxruntime's quantiser.
"""

import hashlib
import io
import json
import sys
import tempfile
import zipfile
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

import eitskin.model.session  # noqa: F401 -- before the next line: it sends no telemetry  # isort: skip
from onnxruntime.quantization import QuantType, quantize_dynamic  # isort: skip

from tests.second_skin import SECOND

from eitskin_proto.sensor.ids import PROTOCOL_ID
from eitskin_proto.skin.skin import PAPER
from eitskin_proto.skin.toml import to_toml

HIDDEN = 8
ROWS = 104


def graph(skin, name, nodes, inputs, output, weights):
    values = [helper.make_tensor_value_info(key, TensorProto.FLOAT, shape) for key, shape in inputs.items()]
    results = [helper.make_tensor_value_info(key, TensorProto.FLOAT, shape) for key, shape in output.items()]
    constants = [numpy_helper.from_array(array, key) for key, array in weights.items()]
    built = helper.make_graph(nodes, name, values, results, constants)
    model = helper.make_model(built, opset_imports=[helper.make_opsetid("", 18)], ir_version=9)
    helper.set_model_props(model, {"protocol_id": PROTOCOL_ID, "grid_id": skin.grid_id})
    onnx.checker.check_model(model)
    return model.SerializeToString()


def geometry(rng, skin):
    rows, columns = skin.grid.shape
    pool = 15 if skin is PAPER else 9
    points = 3 * (rows // pool) * (columns // pool)
    weights = {
        "w": rng.normal(0, 0.3, (points, HIDDEN)).astype(np.float32),
        "flat": np.array([1, points], dtype=np.int64),
    }
    nodes = [
        helper.make_node("AveragePool", ["cloud"], ["pooled"], kernel_shape=[pool, pool], strides=[pool, pool]),
        helper.make_node("Reshape", ["pooled", "flat"], ["points"]),
        helper.make_node("MatMul", ["points", "w"], ["bias"]),
    ]
    return graph(skin, "geometry", nodes, {"cloud": [1, *skin.grid.cloud_shape]}, {"bias": [1, HIDDEN]}, weights)


def head(rng, skin):
    rows, columns = skin.grid.shape
    weights = {
        "w1": rng.normal(0, 1.0, (ROWS, HIDDEN)).astype(np.float32),
        "w2": rng.normal(0, 1.0, (HIDDEN, rows + columns)).astype(np.float32),
        "split": np.array([rows, columns], dtype=np.int64),
        "as_rows": np.array([1, rows, 1], dtype=np.int64),
        "as_columns": np.array([1, 1, columns], dtype=np.int64),
        "as_map": np.array([1, skin.grid.n_pixels], dtype=np.int64),
        "floor": np.array(1e-3, dtype=np.float32),
        "one": np.array(1.0, dtype=np.float32),
    }
    nodes = [
        helper.make_node("Add", ["dv", "one"], ["ratio"]),
        helper.make_node("Max", ["ratio", "floor"], ["clamped"]),
        helper.make_node("Log", ["clamped"], ["log"]),
        helper.make_node("Sub", ["log", "log_predicted"], ["change"]),
        helper.make_node("MatMul", ["change", "w1"], ["first"]),
        helper.make_node("Add", ["first", "bias"], ["fused"]),
        helper.make_node("Relu", ["fused"], ["hidden"]),
        helper.make_node("MatMul", ["hidden", "w2"], ["profiles"]),
        helper.make_node("Split", ["profiles", "split"], ["rows", "columns"], axis=1),
        helper.make_node("Reshape", ["rows", "as_rows"], ["down"]),
        helper.make_node("Reshape", ["columns", "as_columns"], ["across"]),
        helper.make_node("Add", ["down", "across"], ["logits"]),
        helper.make_node("Reshape", ["logits", "as_map"], ["flat"]),
        helper.make_node("Sigmoid", ["flat"], ["map"]),
    ]
    inputs = {"dv": [1, ROWS], "log_predicted": [1, ROWS], "bias": [1, HIDDEN]}
    return graph(skin, "head", nodes, inputs, {"map": [1, skin.grid.n_pixels]}, weights)


def int8(model):
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder, "head.onnx"), Path(folder, "int8.onnx")
        source.write_bytes(model)
        quantize_dynamic(source, target, weight_type=QuantType.QInt8, extra_options={"DefaultTensorType": 1})
        return target.read_bytes()


def gate():
    """Return a gate whose logit is the mean of |dV| over the rows, in 16 pairs of hidden values."""
    weights = np.zeros((208, 208), dtype=np.float32)
    weights[np.arange(104), np.arange(104)] = 1.0
    weights[np.arange(104), np.arange(104, 208)] = -1.0
    return {
        "mean": np.zeros(208, np.float32),
        "scale": np.ones(208, np.float32),
        "w1": weights,
        "b1": np.zeros(208, np.float32),
        "w2": np.full(208, 1 / 104, np.float32),
        "b2": np.zeros(1, np.float32),
        "threshold": np.array([0.02], np.float32),
    }


def saved(writer, *arguments, **named):
    stream = io.BytesIO()
    writer(stream, *arguments, **named)
    return stream.getvalue()


def main(target, skin):
    rng = np.random.default_rng(20240)
    head_model = head(rng, skin)
    n_pixels = skin.grid.n_pixels
    projection = np.zeros((n_pixels, ROWS), np.float32)
    projection[np.arange(0, n_pixels, n_pixels // ROWS + (skin is PAPER))[:ROWS], np.arange(ROWS)] = -1.0
    files = {
        "geometry.onnx": geometry(rng, skin),
        "head.onnx": head_model,
        "head_int8.onnx": int8(head_model),
        "tikhonov.npy": saved(np.save, projection),
        "gate.npz": saved(np.savez, **gate()),
    }
    if skin is not PAPER:
        files["skin.toml"] = to_toml(skin).encode()
    manifest = {
        "format": "eitskin-bundle",
        "version": 1,
        "protocol_id": PROTOCOL_ID,
        "grid_id": skin.grid_id,
        **({} if skin is PAPER else {"skin_digest": skin.digest}),
        "labels": "area",
        "created_utc": "2026-01-01T00:00:00Z",
        "files": {
            name: {"sha256": hashlib.sha256(data).hexdigest(), "bytes": len(data)} for name, data in files.items()
        },
        "head": {"inputs": ["dv", "log_predicted", "bias"], "bias": HIDDEN, "precision": ["fp32", "int8"]},
        "gate": {"false_alarm_rate": 0.0, "note": "hand-made"},
        "recipe": {"name": "hand-made for tests"},
        "seeds": {"weights": 20240},
        "metrics": {},
    }
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in {"manifest.json": json.dumps(manifest, indent=1).encode(), **files}.items():
            info = zipfile.ZipInfo(name, (2026, 1, 1, 0, 0, 0))
            info.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(info, data)


if __name__ == "__main__":
    for path, made_for in zip(sys.argv[1:], (PAPER, SECOND), strict=True):
        main(path, made_for)
