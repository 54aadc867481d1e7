"""Cuts a network's last layer down to some of its outputs, without the ``onnx`` package: a region costs its own rows.

An ONNX file is nested protobuf messages. All but three kinds of bytes are copied as they are: the initialisers that
stand between the last matrix product and the graph's output, the declared shape of that output, and the notes on
intermediate shapes, which are dropped. ::

    x -- Gemm(W, b) -- Sigmoid --> map (1, 1350)          W (1350, H) -> W[pixels], b -> b[pixels]
    x -- MatMulInteger(W8) -- Cast -- Mul(scale) -- Add(b) -- Sigmoid --> map            the same, by columns
    x -- Gemm -- Sigmoid -- Gather(index) --> map         index -> index[pixels]; the layer is as small as it gets

A head that sharpens its map mixes a pixel with those around it. There the layer is cut down to the cells of 3 x 3 that
the region can see, the others are taken from one untouched cell, and the whole map comes out, right in the region::

    x -- Gemm(W, b) -- Pad -- Reshape (151, 9) -- Gather(cells) -- Conv ... --> map (1, 1350)
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


def cut_cells(model: bytes, pixels: npt.NDArray[np.intp]) -> bytes:
    """Return the model with a last layer of only those cells that some pixels of a sharpened map depend on.

    Args:
        model: With one output (1, 1350); one that does not sharpen comes back as it is.
        pixels: (n,) those that must be right, at least one.

    Raises:
        UncutError: The last layer is of a kind that cannot be cut.
        BundleError: It is no ONNX model.
    """
    fields = list(_fields(memoryview(model)))
    graph = list(_fields(_bytes(next(field for field in fields if field.number == GRAPH))))
    nodes = [node for node in map(_node, graph) if node is not None]
    producers = {name: node for node in nodes for name in node.outputs}
    gather = next((node for node in nodes if node.kind == "Gather" and _padded(node, producers)), None)
    if gather is None:
        return model
    tensors = {_text(field, NAME): _bytes(field) for field in graph if field.number == INITIALISER}
    kernels = [_dims(tensors[node.inputs[1]]) for node in nodes if node.kind == "Conv"]
    cells = _seen_cells(pixels, sum(kernel[-1] // 2 for kernel in kernels))
    pad = producers[producers[gather.inputs[0]].inputs[0]]
    affected: set[str] = set()
    _trace(pad.inputs[0], producers, set(tensors), affected)
    kept = (CELL**2 * cells[:, None] + np.arange(CELL**2)).ravel()
    place = np.full(int(np.prod(_dims(tensors[gather.inputs[1]]))), len(cells), dtype="<i8")
    place[cells] = np.arange(len(cells))
    size = CELL**2 * len(place)
    changed = {name: bytes(_cut_tensor(tensors[name], kept, size)) for name in affected}
    changed[gather.inputs[1]] = _with_values(list(_fields(tensors[gather.inputs[1]])), place)
    cut_graph = b"".join(
        _message(INITIALISER, changed[_text(field, NAME)])
        if field.number == INITIALISER and _text(field, NAME) in changed
        else field.raw
        for field in graph
        if field.number != VALUE_INFO
    )
    return b"".join(_message(GRAPH, cut_graph) if field.number == GRAPH else field.raw for field in fields)


def _padded(gather: "_Node", producers: "dict[str, _Node]") -> bool:
    """Return whether what is gathered from is a padded row of cells."""
    reshape = producers.get(gather.inputs[0])
    before = producers.get(reshape.inputs[0]) if reshape is not None and reshape.kind == "Reshape" else None
    return before is not None and before.kind == "Pad"


def _seen_cells(pixels: npt.NDArray[np.intp], reach: int) -> npt.NDArray[np.intp]:
    """Return (c,) the cells of some pixels and those at most ``reach`` cells from them, ascending."""
    rows, columns = np.divmod(pixels, GRID_SHAPE[1])
    seen = np.zeros((GRID_SHAPE[0] // CELL, GRID_SHAPE[1] // CELL), dtype=bool)
    for row, column in set(zip((rows // CELL).tolist(), (columns // CELL).tolist(), strict=True)):
        seen[max(0, row - reach) : row + reach + 1, max(0, column - reach) : column + reach + 1] = True
    return np.flatnonzero(seen)


def _cut_graph(graph: memoryview, pixels: npt.NDArray[np.intp], outputs: int) -> bytes:
    fields = list(_fields(graph))
    producers = {name: node for node in map(_node, fields) if node is not None for name in node.outputs}
    names = {_text(field, NAME): field for field in fields if field.number == INITIALISER}
    declared = next(field for field in fields if field.number == OUTPUT)
    name = _text(declared, 1)
    affected: set[str] = set()
    _trace(name, producers, set(names), affected)
    parts: list[bytes | memoryview] = []
    for field in fields:
        if field.number == INITIALISER and _text(field, NAME) in affected:
            parts.append(_message(INITIALISER, _cut_tensor(_bytes(field), pixels, outputs)))
        elif field.number == OUTPUT:
            parts.append(_message(OUTPUT, _output(name, len(pixels))))
        elif field.number != VALUE_INFO:
            parts.append(field.raw)
    return b"".join(parts)


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
    if node.kind in ("Gemm", "MatMul", "MatMulInteger", "Gather"):
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
