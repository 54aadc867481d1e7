"""Cuts a network's last layer down to some of its outputs, without the ``onnx`` package: a region costs its own rows.

An ONNX file is nested protobuf messages. All but three kinds of bytes are copied as they are: the initialisers that
stand between the last matrix product and the graph's output, the declared shape of that output, and the notes on
intermediate shapes, which are dropped. ::

    x -- Gemm(W, b) -- Sigmoid --> map (1, 1350)          W (1350, H) -> W[pixels], b -> b[pixels]
    x -- MatMulInteger(W8) -- Cast -- Mul(scale) -- Add(b) -- Sigmoid --> map            the same, by columns
    x -- Gemm -- Sigmoid -- GatherElements(index) --> map         index -> index[pixels]; the layer is small already

A head that sharpens its map mixes a pixel with those around it. There the output is cut down to the pixels, and the
last layer to the cells of 3 x 3 that they can see; what else the convolutions read is any finite number::

    x -- Gemm(W, b) -- GatherElements(cells) -- Reshape -- Conv ... -- GatherElements(index) -- Sigmoid --> map
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin.errors import BundleError, UncutError
from eitskin_proto.grid import GRID_SHAPE

GRAPH: Final = 7
"""Field of ModelProto; those of GraphProto and TensorProto follow."""
NODE, INITIALISER, OUTPUT, VALUE_INFO = 1, 5, 12, 13
DIMS, DATA_TYPE, FLOATS, INT32S, INT64S, NAME, RAW = 1, 2, 4, 5, 7, 8, 9

DTYPES: Final = {1: "<f4", 2: "u1", 3: "i1", 6: "<i4", 7: "<i8"}
"""ONNX's numbers for element types that a head's last layer has."""

CELL: Final = 3
"""Pixels along a side of a cell, in which a head sharpens."""

GATHERS: Final = ("Gather", "GatherElements")
"""Operators that pick outputs by an index of as many elements."""

THROUGH: Final = frozenset({"Sigmoid", "Add", "Mul", "Cast"})
"""Operators that keep every output apart from the others."""


@dataclass(frozen=True, slots=True)
class _Field:
    number: int
    value: memoryview | int
    raw: memoryview


def cut(model: bytes, pixels: npt.NDArray[np.intp], outputs: int) -> bytes:
    """Return the model with only some of its outputs, in the given order.

    Args:
        model: With one output (1, outputs).
        pixels: (n,) which to keep, at least one.
        outputs: How many there are.

    Raises:
        UncutError: The last layer is of a kind that cannot be cut.
        BundleError: It is no ONNX model.
    """
    fields = list(_fields(memoryview(model)))
    graph = _bytes(next(field for field in fields if field.number == GRAPH))
    return b"".join(_message(GRAPH, _cut_graph(graph, pixels, outputs)) if f.number == GRAPH else f.raw for f in fields)


def _cut_graph(graph: memoryview, pixels: npt.NDArray[np.intp], outputs: int) -> bytes:
    fields = list(_fields(graph))
    nodes = [node for node in map(_node, fields) if node is not None]
    producers = {name: node for node in nodes for name in node.outputs}
    tensors = {_text(field, NAME): _bytes(field) for field in fields if field.number == INITIALISER}
    declared = next(field for field in fields if field.number == OUTPUT)
    name = _text(declared, 1)
    affected: set[str] = set()
    _trace(name, producers, set(tensors), affected)
    changed = {other: _cut_tensor(tensors[other], pixels, outputs) for other in affected}
    changed |= _cut_cells(nodes, producers, tensors, pixels)
    parts: list[bytes | memoryview] = []
    for field in fields:
        if field.number == INITIALISER and (tensor := changed.get(_text(field, NAME))) is not None:
            parts.append(_message(INITIALISER, tensor))
        elif field.number == OUTPUT:
            parts.append(_message(OUTPUT, _output(name, len(pixels))))
        elif field.number != VALUE_INFO:
            parts.append(field.raw)
    return b"".join(parts)


def _cut_cells(
    nodes: "list[_Node]",
    producers: "dict[str, _Node]",
    tensors: dict[str, memoryview],
    pixels: npt.NDArray[np.intp],
) -> dict[str, bytes | memoryview]:
    """Return the initialisers of a last layer of those cells alone that some pixels of a sharpened map depend on."""
    convolutions = [node for node in nodes if node.kind == "Conv"]
    if not convolutions:
        return {}
    reshape = producers.get(convolutions[0].inputs[0])
    gather = producers.get(reshape.inputs[0]) if reshape is not None and reshape.kind == "Reshape" else None
    if gather is None or gather.kind != "GatherElements":
        raise UncutError("the head's first convolution does not read gathered cells; no region can be cut out of it")
    affected: set[str] = set()
    _trace(gather.inputs[0], producers, set(tensors), affected)
    kept = _seen(pixels, sum(_dims(tensors[node.inputs[1]])[-1] // 2 for node in convolutions))
    places = np.zeros(GRID_SHAPE[0] * GRID_SHAPE[1], dtype="<i8")
    places[kept] = np.arange(len(kept))
    index = list(_fields(tensors[gather.inputs[1]]))
    old = _values(index, np.dtype("<i8")).reshape(_dims(tensors[gather.inputs[1]]))
    changed: dict[str, bytes | memoryview] = {name: _cut_tensor(tensors[name], kept, len(places)) for name in affected}
    return changed | {gather.inputs[1]: _with_values(index, places[old])}


def _seen(pixels: npt.NDArray[np.intp], reach: int) -> npt.NDArray[np.intp]:
    """Return (n,) the pixels in the cells of some pixels and in those at most ``reach`` cells from them, ascending."""
    rows, columns = np.divmod(pixels, GRID_SHAPE[1])
    seen = np.zeros(GRID_SHAPE, dtype=bool)
    for row, column in set(zip((rows // CELL).tolist(), (columns // CELL).tolist(), strict=True)):
        top, left = max(0, row - reach), max(0, column - reach)
        seen[CELL * top : CELL * (row + reach + 1), CELL * left : CELL * (column + reach + 1)] = True
    return np.flatnonzero(seen)


@dataclass(frozen=True, slots=True)
class _Node:
    kind: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]


def _node(field: _Field) -> _Node | None:
    if field.number != NODE:
        return None
    inside = list(_fields(_bytes(field)))

    def texts(number: int) -> tuple[str, ...]:
        return tuple(bytes(_bytes(item)).decode() for item in inside if item.number == number)

    return _Node(texts(4)[0], texts(1), texts(2))


def _trace(name: str, producers: dict[str, _Node], constants: set[str], affected: set[str]) -> None:
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
    fields, dims = list(_fields(tensor)), _dims(tensor)
    if outputs not in dims:
        return tensor  # one scale or zero point for all outputs
    kind = next(int(field.value) for field in fields if field.number == DATA_TYPE)
    if kind not in DTYPES:
        raise UncutError(f"the head's last layer holds elements of ONNX type {kind}, expected {sorted(DTYPES)}")
    values = _values(fields, np.dtype(DTYPES[kind])).reshape(dims)
    axis = dims.index(outputs)
    return _with_values(fields, np.ascontiguousarray(np.take(values, pixels, axis=axis)))


def _dims(tensor: memoryview) -> list[int]:
    return [value for field in _fields(tensor) if field.number == DIMS for value in _integers(field)]


def _with_values(fields: list[_Field], values: npt.NDArray[np.generic]) -> bytes:
    """Return a tensor with other values of the same type."""
    shape = b"".join(_number(DIMS, size) for size in values.shape)
    rest = b"".join(field.raw for field in fields if field.number not in (DIMS, RAW, FLOATS, INT32S, INT64S))
    return shape + rest + _message(RAW, values.tobytes())


def _values(fields: list[_Field], kind: np.dtype[np.generic]) -> npt.NDArray[np.generic]:
    """Return a tensor's elements, whichever of ONNX's three ways they are stored in."""
    integers = [value for field in fields if field.number == INT32S for value in _integers(field)]
    if integers:
        return np.array([(value ^ 1 << 63) - (1 << 63) for value in integers]).astype(kind)
    data = b"".join(_bytes(field) for field in fields if field.number in (RAW, FLOATS))
    return np.frombuffer(data, dtype=kind)


def _output(name: str, count: int) -> bytes:
    """Return the declaration of a float32 tensor (1, count)."""
    shape = b"".join(_message(1, _number(1, size)) for size in (1, count))
    kind = _message(1, _number(1, 1) + _message(2, shape))
    return _message(1, name.encode()) + _message(2, kind)


def _fields(data: memoryview) -> Iterator[_Field]:
    at = 0
    while at < len(data):
        start = at
        key, at = _varint(data, at)
        if key & 7 == 2:
            size, at = _varint(data, at)
            at += size
            yield _Field(key >> 3, data[at - size : at], data[start:at])
        elif key & 7 == 0:
            value, at = _varint(data, at)
            yield _Field(key >> 3, value, data[start:at])
        elif key & 7 in (1, 5):
            at += 8 if key & 7 == 1 else 4
            yield _Field(key >> 3, 0, data[start:at])
        else:
            raise BundleError("the head is no ONNX model that can be read")


def _varint(data: memoryview, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
        shift += 7


def _integers(field: _Field) -> list[int]:
    if isinstance(field.value, int):
        return [field.value]
    found, at = [], 0
    while at < len(field.value):
        value, at = _varint(field.value, at)
        found.append(value)
    return found


def _bytes(field: _Field) -> memoryview:
    if isinstance(field.value, int):
        raise BundleError("the head is no ONNX model that can be read")
    return field.value


def _text(field: _Field, number: int) -> str:
    return next((bytes(_bytes(item)).decode() for item in _fields(_bytes(field)) if item.number == number), "")


def _number(number: int, value: int) -> bytes:
    return _pack(number << 3) + _pack(value)


def _message(number: int, data: bytes | memoryview) -> bytes:
    return _pack(number << 3 | 2) + _pack(len(data)) + data


def _pack(value: int) -> bytes:
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)
