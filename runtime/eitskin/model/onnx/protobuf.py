"""ONNX files as they lie on disk: nested protobuf messages, read and written again without the ``onnx`` package.

Only what cutting a network needs: the fields of a message, nodes by their inputs and outputs, tensors by their values.
Whoever changes a tensor writes it anew; every other byte is copied.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin.errors import BundleError

GRAPH: Final = 7
"""Field of ModelProto; those of GraphProto and TensorProto follow."""
NODE, INITIALISER, OUTPUT, VALUE_INFO = 1, 5, 12, 13
DIMS, DATA_TYPE, FLOATS, INT32S, INT64S, NAME, RAW = 1, 2, 4, 5, 7, 8, 9


@dataclass(frozen=True, slots=True)
class Field:
    """One field of a message."""

    number: int
    value: memoryview | int
    """Its content: a number, or the bytes of a text, a message or packed values."""
    raw: memoryview
    """All of it, as it stands in the file."""


@dataclass(frozen=True, slots=True)
class Node:
    """An operator of a graph, by the names of what it reads and writes."""

    kind: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]


def node_of(field: Field) -> Node | None:
    """Return the node that a field of a graph is; None for any other."""
    if field.number != NODE:
        return None
    inside = list(fields_of(content(field)))

    def texts(number: int) -> tuple[str, ...]:
        return tuple(bytes(content(item)).decode() for item in inside if item.number == number)

    return Node(texts(4)[0], texts(1), texts(2))


def dims_of(tensor: memoryview) -> list[int]:
    """Return a tensor's shape."""
    return [value for field in fields_of(tensor) if field.number == DIMS for value in _integers(field)]


def with_values(fields: list[Field], values: npt.NDArray[np.generic]) -> bytes:
    """Return a tensor with other values of the same type."""
    shape = b"".join(number(DIMS, size) for size in values.shape)
    rest = b"".join(field.raw for field in fields if field.number not in (DIMS, RAW, FLOATS, INT32S, INT64S))
    return shape + rest + message(RAW, values.tobytes())


def values_of(fields: list[Field], kind: np.dtype[np.generic]) -> npt.NDArray[np.generic]:
    """Return a tensor's elements, whichever of ONNX's three ways they are stored in."""
    integers = [value for field in fields if field.number == INT32S for value in _integers(field)]
    if integers:
        return np.array([(value ^ 1 << 63) - (1 << 63) for value in integers]).astype(kind)
    data = b"".join(content(field) for field in fields if field.number in (RAW, FLOATS))
    return np.frombuffer(data, dtype=kind)


def fields_of(data: memoryview) -> Iterator[Field]:
    """Yield the fields of a message.

    Raises:
        BundleError: These bytes are none.
    """
    at = 0
    while at < len(data):
        start = at
        key, at = _varint(data, at)
        if key & 7 == 2:
            size, at = _varint(data, at)
            at += size
            yield Field(key >> 3, data[at - size : at], data[start:at])
        elif key & 7 == 0:
            value, at = _varint(data, at)
            yield Field(key >> 3, value, data[start:at])
        elif key & 7 in (1, 5):
            at += 8 if key & 7 == 1 else 4
            yield Field(key >> 3, 0, data[start:at])
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


def _integers(field: Field) -> list[int]:
    if isinstance(field.value, int):
        return [field.value]
    found, at = [], 0
    while at < len(field.value):
        value, at = _varint(field.value, at)
        found.append(value)
    return found


def content(field: Field) -> memoryview:
    """Return the bytes of a field.

    Raises:
        BundleError: It is a number.
    """
    if isinstance(field.value, int):
        raise BundleError("the head is no ONNX model that can be read")
    return field.value


def text(field: Field, number: int) -> str:
    """Return a text inside a message, "" if it has none."""
    return next((bytes(content(item)).decode() for item in fields_of(content(field)) if item.number == number), "")


def number(field: int, value: int) -> bytes:
    """Return a field that is a number."""
    return _pack(field << 3) + _pack(value)


def message(field: int, data: bytes | memoryview) -> bytes:
    """Return a field that is bytes, a text or a message."""
    return _pack(field << 3 | 2) + _pack(len(data)) + data


def _pack(value: int) -> bytes:
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)
