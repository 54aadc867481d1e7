"""Reads ONNX files, which are nested protobuf messages, without the ``onnx`` package.

Only what checking a network needs: the fields of a message, nodes by their inputs and outputs, shapes of tensors.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from eitskin.errors import BundleError

GRAPH: Final = 7
"""Field of ModelProto; those of GraphProto and TensorProto follow."""
NODE, INITIALISER, OUTPUT, VALUE_INFO = 1, 5, 12, 13
DIMS, DATA_TYPE, FLOATS, INT32S, INT64S, NAME, RAW = 1, 2, 4, 5, 7, 8, 9

LONGEST_VARINT: Final = 10
"""Bytes of a number."""


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
        return tuple(decoded(content(item)) for item in inside if item.number == number)

    kinds = texts(4)
    if len(kinds) != 1:
        raise unreadable()  # which of several counts is the library's secret
    return Node(kinds[0], texts(1), texts(2))


def dims_of(tensor: memoryview) -> list[int]:
    """Return a tensor's shape."""
    return [value for field in fields_of(tensor) if field.number == DIMS for value in integers(field)]


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
            if at > len(data):
                raise unreadable()
            yield Field(key >> 3, data[at - size : at], data[start:at])
        elif key & 7 == 0:
            value, at = _varint(data, at)
            yield Field(key >> 3, value, data[start:at])
        elif key & 7 in (1, 5):
            at += 8 if key & 7 == 1 else 4
            if at > len(data):
                raise unreadable()
            yield Field(key >> 3, 0, data[start:at])
        else:
            raise unreadable()


def _varint(data: memoryview, at: int) -> tuple[int, int]:
    value = 0
    for number, byte in enumerate(data[at : at + LONGEST_VARINT]):
        value |= (byte & 0x7F) << 7 * number
        if byte < 0x80:
            return value & (1 << 64) - 1, at + number + 1
    raise unreadable()


def unreadable() -> BundleError:
    """Return the error of bytes that are no ONNX model."""
    return BundleError("a graph is no ONNX model that can be read")


def decoded(data: memoryview) -> str:
    """Return a text of a message.

    Raises:
        BundleError: It is none.
    """
    try:
        return bytes(data).decode()
    except UnicodeDecodeError as error:
        raise unreadable() from error


def integers(field: Field) -> list[int]:
    """Return the unsigned numbers of a repeated field, packed or not."""
    if isinstance(field.value, int):
        return [field.value]
    found, at = [], 0
    while at < len(field.value):
        value, at = _varint(field.value, at)
        found.append(value)
    return found


def signed(value: int) -> int:
    """Return the signed number that 64 bits stand for."""
    return (value ^ 1 << 63) - (1 << 63)


def content(field: Field) -> memoryview:
    """Return the bytes of a field.

    Raises:
        BundleError: It is a number.
    """
    if isinstance(field.value, int):
        raise unreadable()
    return field.value


def text(field: Field, number: int) -> str:
    """Return a text inside a message, "" if it has none."""
    return next((decoded(content(item)) for item in fields_of(content(field)) if item.number == number), "")
