"""PLY files: ASCII, little and big endian. Colours, normals and faces may be there and are passed over."""

import io
from collections.abc import Iterator
from itertools import islice
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.files.plain import quoted
from eitskin_sim.surface.words import check_count, table

Array = npt.NDArray[np.float64]

PLY_TYPES: Final = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
    "double": "f8",
    "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "float32": "f4",
    "float64": "f8",
}  # fmt: skip
"""Names that the PLY format gives to numbers, old and new."""

PLY_ORDERS: Final = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
"""Formats of a PLY file and their byte order."""

LARGEST_HEADER: Final = 65_536
"""Longest PLY header in bytes."""


def read_ply(data: bytes) -> Array:
    """Return the (n, 3) points of a file's bytes.

    Raises:
        ValueError: It is no PLY file, or holds no points.
    """
    end = data.find(b"end_header", 0, LARGEST_HEADER)
    if not data.startswith(b"ply") or end < 0:
        raise ValueError("no PLY header ('ply' ... 'end_header')")
    body = data.index(b"\n", end) + 1
    order, elements = _ply_header(data[:end].decode("ascii"))
    if order == "":
        return _ply_ascii(data[body:], elements)
    for name, count, properties in elements:
        if any(kind == "list" for _, kind in properties):
            raise ValueError(f"element {quoted(name)} with a list comes before the vertices: save the vertices first")
        layout = np.dtype([(label, order + PLY_TYPES[kind]) for label, kind in properties])
        if len(data) - body < count * layout.itemsize:
            raise ValueError(
                f"{count} entries of {quoted(name)} need {count * layout.itemsize} bytes, found {len(data) - body}"
            )
        if name == "vertex":
            check_count(count)
            table = np.frombuffer(data, dtype=layout, count=count, offset=body)
            return np.stack([table[axis].astype(np.float64) for axis in "xyz"], axis=-1)
        body += count * layout.itemsize
    raise ValueError("no element 'vertex'")


_Element = tuple[str, int, list[tuple[str, str]]]


def _ply_header(header: str) -> tuple[str, list[_Element]]:
    """Byte order, and the elements up to the vertices, each with its count and its properties' names and types."""
    order: str | None = None
    elements: list[_Element] = []
    for words in (line.split() for line in header.splitlines()):
        if words[:1] == ["format"]:
            if words[1] not in PLY_ORDERS:
                raise ValueError(f"format {quoted(words[1])} is none of {', '.join(PLY_ORDERS)}")
            order = PLY_ORDERS[words[1]]
        elif words[:1] == ["element"]:
            if elements and elements[-1][0] == "vertex":
                break
            elements.append((words[1], int(words[2]), []))
        elif words[:1] == ["property"]:
            kind = words[1]
            if kind != "list" and kind not in PLY_TYPES:
                raise ValueError(f"property type {quoted(kind)} is unknown")
            elements[-1][2].append((words[-1], kind))
    if order is None:
        raise ValueError("the header has no 'format' line")
    vertices = [properties for name, _, properties in elements if name == "vertex"]
    if not vertices or not {"x", "y", "z"} <= {label for label, _ in vertices[0]}:
        raise ValueError("the header has no element 'vertex' with the properties x, y and z")
    if any(not 0 <= count < 1 << 48 for _, count, _ in elements):
        raise ValueError("an element has a negative count, or one that no file can hold")
    return order, elements


def _ply_ascii(body: bytes, elements: list[_Element]) -> Array:
    skip = sum(count for _, count, _ in elements[:-1])
    _, count, properties = elements[-1]
    columns = [[label for label, _ in properties].index(axis) for axis in "xyz"]
    lines = body.count(b"\n") + (not body.endswith(b"\n") and bool(body))
    if lines < skip + count:
        raise ValueError(f"{quoted(count)} vertices are declared, found {max(lines - skip, 0)} lines")

    def rows() -> Iterator[list[bytes]]:
        for line in islice(io.BytesIO(body), skip, skip + count):
            words = line.split(None, max(columns) + 1)
            yield [words[column] for column in columns]

    return table(rows())
