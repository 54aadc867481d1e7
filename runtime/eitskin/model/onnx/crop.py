"""Cuts a network's last layer down to some of its outputs, without the ``onnx`` package: a region costs its own rows.

An ONNX file is nested protobuf messages (:mod:`eitskin.model.onnx.protobuf`). All but three kinds of bytes are copied
as they are: the initialisers that stand between the last matrix product and the graph's output, the declared shape of
that output, and the notes on intermediate shapes, which are dropped. ::

    x -- Gemm(W, b) -- Sigmoid --> map (1, 1350)          W (1350, H) -> W[pixels], b -> b[pixels]
    x -- MatMulInteger(W8) -- Cast -- Mul(scale) -- Add(b) -- Sigmoid --> map            the same, by columns
    x -- Gemm -- Sigmoid -- GatherElements(index) --> map         index -> index[pixels]; the layer is small already

A head that sharpens its map mixes a pixel with those around it: :mod:`eitskin.model.onnx.crop_sharpened`.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin.errors import UncutError
from eitskin.model.onnx.crop_sharpened import GATHER, THROUGH, sharpened
from eitskin.model.onnx.protobuf import (
    DATA_TYPE,
    GRAPH,
    INITIALISER,
    NAME,
    OUTPUT,
    VALUE_INFO,
    Node,
    content,
    dims_of,
    fields_of,
    message,
    node_of,
    number,
    text,
    values_of,
    with_values,
)

DTYPES: Final = {1: "<f4", 2: "u1", 3: "i1", 6: "<i4", 7: "<i8"}
"""ONNX's numbers for element types that a head's last layer has."""

GATHERS: Final = ("Gather", GATHER)
"""Operators that pick outputs by an index of as many elements."""


def cut(model: bytes, pixels: npt.NDArray[np.intp], shape: tuple[int, int]) -> bytes:
    """Return the model with only some of its outputs, in the given order.

    Args:
        model: With one output (1, pixels), a map.
        pixels: (n,) which to keep, at least one.
        shape: Rows and columns of the map.

    Raises:
        UncutError: The last layer is of a kind that cannot be cut.
        BundleError: It is no ONNX model.
    """
    fields = list(fields_of(memoryview(model)))
    graph = content(next(field for field in fields if field.number == GRAPH))
    return b"".join(message(GRAPH, _cut_graph(graph, pixels, shape)) if f.number == GRAPH else f.raw for f in fields)


def _cut_graph(graph: memoryview, pixels: npt.NDArray[np.intp], shape: tuple[int, int]) -> bytes:
    fields = list(fields_of(graph))
    nodes = [node for node in map(node_of, fields) if node is not None]
    producers = {name: node for node in nodes for name in node.outputs}
    tensors = {text(field, NAME): content(field) for field in fields if field.number == INITIALISER}
    declared = next(field for field in fields if field.number == OUTPUT)
    name = text(declared, 1)
    affected: set[str] = set()
    _trace(name, producers, set(tensors), affected)
    outputs = shape[0] * shape[1]
    changed: dict[str, bytes | memoryview] = {other: _cut_tensor(tensors[other], pixels, outputs) for other in affected}
    cells = sharpened(nodes, producers, tensors, pixels, shape)
    if cells is not None:
        layer: set[str] = set()
        _trace(cells.source, producers, set(tensors), layer)
        changed = {other: _cut_tensor(tensors[other], cells.kept, cells.outputs) for other in layer} | cells.changed
    parts: list[bytes | memoryview] = []
    for field in fields:
        if field.number == INITIALISER and (tensor := changed.get(text(field, NAME))) is not None:
            parts.append(message(INITIALISER, tensor))
        elif field.number == OUTPUT:
            parts.append(message(OUTPUT, _output(name, len(pixels))))
        elif field.number != VALUE_INFO:
            parts.append(field.raw)
    return b"".join(parts)


def _trace(name: str, producers: dict[str, Node], constants: set[str], affected: set[str]) -> None:
    """Collect the initialisers from here back to the last matrix product."""
    node = producers.get(name)
    if node is None or node.kind == "DynamicQuantizeLinear":
        return  # what the activations bring with them is the same for every output
    if node.kind in ("Gemm", "MatMul", "MatMulInteger", *GATHERS):
        affected.update(other for other in node.inputs[1:] if other in constants)
    elif node.kind in THROUGH:
        for other in node.inputs:
            if other in constants:
                affected.add(other)
            else:
                _trace(other, producers, constants, affected)
    else:
        raise UncutError(f"the head ends in {node.kind}, of which no region can be computed by itself")


def _cut_tensor(tensor: memoryview, pixels: npt.NDArray[np.intp], outputs: int) -> bytes | memoryview:
    fields, dims = list(fields_of(tensor)), dims_of(tensor)
    if outputs not in dims:
        return tensor  # one scale or zero point for all outputs
    if dims.count(outputs) > 1:
        raise UncutError(
            f"the head's last layer is {outputs} wide on both sides; which one is the map's cannot be told"
        )
    kind = next(int(field.value) for field in fields if field.number == DATA_TYPE)
    if kind not in DTYPES:
        raise UncutError(f"the head's last layer holds elements of ONNX type {kind}, expected {sorted(DTYPES)}")
    values = values_of(fields, np.dtype(DTYPES[kind])).reshape(dims)
    axis = dims.index(outputs)
    return with_values(fields, np.ascontiguousarray(np.take(values, pixels, axis=axis)))


def _output(name: str, count: int) -> bytes:
    """Return the declaration of a float32 tensor (1, count)."""
    shape = b"".join(message(1, number(1, size)) for size in (1, count))
    kind = message(1, number(1, 1) + message(2, shape))
    return message(1, name.encode()) + message(2, kind)
