"""The two ONNX graphs of a bundle, as bytes, with the ids in their metadata.

``geometry.onnx`` runs when a cloud arrives, ``head.onnx`` runs per frame. Batch is 1 in both, as in a stream. An export
in training mode would silently keep its dropout, so the finished graph is searched for layers that only training has.
"""

import contextlib
import io
import logging
import warnings
from collections.abc import Iterator
from typing import Final

import onnx
import torch
from onnx import numpy_helper

from eitskin.model.denormals import flushed
from eitskin_export.fold import GeometryHalf, Head
from eitskin_proto.errors import SkinError
from eitskin_proto.sensor.ids import PROTOCOL_ID
from eitskin_proto.sensor.table import N_ROWS

OPSET: Final = 20
"""Version of the ONNX operators: the newest that torch 2.13 exports (18 to 20 work)."""

TRAINING_ONLY: Final = frozenset({"Dropout", "BatchNormalization"})
"""Operators that no deployed graph may hold."""


def geometry_graph(geometry: GeometryHalf) -> bytes:
    """Return the graph from "cloud" (1, 3, rows, columns) to "bias" (1, H)."""
    return _export(geometry, (torch.zeros(1, *geometry.skin.grid.cloud_shape),), ["cloud"], ["bias"])


def head_graph(head: Head) -> bytes:
    """Return the graph from "dv" (1, 104) [, "log_predicted" (1, 104)] and "bias" (1, H) to "map" (1, n_pixels)."""
    rows, bias = torch.zeros(1, N_ROWS), torch.zeros(1, head.bias_width)
    if head.architecture.log_predicted:
        return _export(head, (rows, rows.clone(), bias), ["dv", "log_predicted", "bias"], ["map"])
    return _export(head, (rows, bias), ["dv", "bias"], ["map"])


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Silence the exporters' notes on their own optional parts; ours are errors and stay."""
    before = logging.root.manager.disable
    logging.disable(logging.WARNING)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logging.disable(before)


def _export(
    module: GeometryHalf | Head, example: tuple[torch.Tensor, ...], inputs: list[str], outputs: list[str]
) -> bytes:
    if module.training:
        raise SkinError(
            "a network in training mode cannot be exported: call eval() first, or dropout stays in the graph"
        )
    with quiet():
        program = torch.onnx.export(
            module,
            example,
            input_names=inputs,
            output_names=outputs,
            opset_version=OPSET,
            dynamo=True,
            external_data=False,
            verbose=False,
        )
    assert program is not None
    model = program.model_proto
    check(model)
    without_traces(model)
    for one in model.graph.initializer:
        values = numpy_helper.to_array(one)
        if values.ndim > 1 and flushed(values) is not values:  # the runtime refuses such weights
            one.CopyFrom(numpy_helper.from_array(flushed(values), one.name))
    onnx.helper.set_model_props(model, {"protocol_id": PROTOCOL_ID, "grid_id": module.skin.grid_id})
    onnx.checker.check_model(model)
    buffer = io.BytesIO()
    onnx.save_model(model, buffer)
    return buffer.getvalue()


def without_traces(model: onnx.ModelProto) -> None:
    """Take out where the exporter says each node came from: stack traces, and with them a machine's paths."""
    model.doc_string = ""
    graph = model.graph
    for item in (graph, *graph.node, *graph.initializer, *graph.value_info, *graph.input, *graph.output):
        item.doc_string = ""
        del item.metadata_props[:]


def check(model: onnx.ModelProto) -> None:
    """Refuse a graph that still holds a layer that only training has.

    Raises:
        SkinError: With the nodes found.
    """
    graphs = [model.graph, *model.functions]
    left = sorted({f"{node.op_type} ({node.name})" for graph in graphs for node in graph.node if _trains(node)})
    if left:
        raise SkinError(
            f"the exported graph holds {', '.join(left)}, expected no Dropout and no BatchNormalization; "
            "fold the network with eitskin_export.fold.split and export it in evaluation mode"
        )


def _trains(node: onnx.NodeProto) -> bool:
    return node.op_type in TRAINING_ONLY
