"""PLY files: ASCII, little and big endian. Colours, normals, lists and faces may be there and are passed over.

A binary entry with lists has no fixed length. Entries are read as if every list were as long as the first entry's; if
one is not, each entry is walked through.
"""

import io
import re
import struct
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import islice
from typing import Final

import numpy as np

from eitskin_proto.files.plain import quoted
from eitskin_sim.arrays import Array
from eitskin_sim.surface.words import check_count, table

PLY_TYPES: Final = {
    "char": "b", "uchar": "B", "short": "h", "ushort": "H", "int": "i", "uint": "I", "float": "f", "double": "d",
    "int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i", "uint32": "I", "float32": "f", "float64": "d",
}  # fmt: skip
"""Names that the PLY format gives to numbers, old and new, and their letters in :mod:`struct` and numpy."""

PLY_ORDERS: Final = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
"""Formats of a PLY file and their byte order."""

LARGEST_HEADER: Final = 65_536
"""Longest PLY header in bytes."""

HEADER_END: Final = re.compile(rb"[\r\n]end_header[ \t]*(?:\r\n|\n|\r)")


@dataclass(frozen=True, slots=True)
class _Property:
    name: str
    kind: str
    """Letter of its numbers."""
    length: str = ""
    """Letter of a list's length; empty for a single number."""


@dataclass(frozen=True, slots=True)
class _Element:
    name: str
    count: int
    properties: list[_Property] = field(default_factory=list)


def read_ply(data: bytes) -> Array:
    """Return the (n, 3) points of a file's bytes.

    Raises:
        ValueError: It is no PLY file, or holds no points.
    """
    end = HEADER_END.search(data, 0, LARGEST_HEADER)
    if not data.startswith(b"ply") or end is None:
        raise ValueError("no PLY header ('ply' ... 'end_header')")
    order, elements = _header(data[: end.start()].decode("latin-1"))
    start = end.end()
    if order == "":
        return _ascii(data[start:], elements)
    check_count(elements[-1].count)
    found = []
    for place in (start, start + 1, start + 2):
        if not data[start:place].strip(b"\r\n"):  # some programs write a blank line before the numbers
            with suppress(ValueError, struct.error):
                found.append(_binary(data, place, elements, order))
    return max(found, key=_usual) if found else _binary(data, start, elements, order)


def _usual(points: Array) -> float:
    """The share of numbers of a usual size: those of bytes that are shifted have any."""
    size = np.abs(points)
    return float(np.mean((size == 0.0) | (size > 1e-6) & (size < 1e7)))


def _binary(data: bytes, place: int, elements: list[_Element], order: str) -> Array:
    for element in elements[:-1]:
        place, _ = _entries(data, place, element, order)
    return _entries(data, place, elements[-1], order)[1]


def _header(header: str) -> tuple[str, list[_Element]]:
    """Byte order, and the elements up to the vertices."""
    order: str | None = None
    elements: list[_Element] = []
    for words in (line.split() for line in header.splitlines()):
        if words[:1] == ["format"]:
            if words[1] not in PLY_ORDERS:
                raise ValueError(f"format {quoted(words[1])} is none of {', '.join(PLY_ORDERS)}")
            order = PLY_ORDERS[words[1]]
        elif words[:1] == ["element"]:
            if elements and elements[-1].name == "vertex":
                break
            elements.append(_Element(words[1], int(words[2])))
        elif words[:1] == ["property"]:
            kinds = words[2:4] if words[1] == "list" else words[1:2]
            if unknown := [kind for kind in kinds if kind not in PLY_TYPES]:
                raise ValueError(f"property type {quoted(unknown[0])} is unknown")
            letters = [PLY_TYPES[kind] for kind in kinds]
            elements[-1].properties.append(
                _Property(words[-1].lower(), letters[-1], letters[0] if len(letters) > 1 else "")
            )
    if order is None:
        raise ValueError("the header has no 'format' line")
    single = [one.name for one in elements[-1].properties if not one.length] if elements else []
    if not elements or elements[-1].name != "vertex" or sorted(set(single) & set("xyz")) != ["x", "y", "z"]:
        raise ValueError("the header has no element 'vertex' with the properties x, y and z")
    if any(not 0 <= element.count < 1 << 48 for element in elements):
        raise ValueError("an element has a negative count, or one that no file can hold")
    return order, elements


def _entries(data: bytes, place: int, element: _Element, order: str) -> tuple[int, Array]:
    """Return where an element's binary entries end, and (n, 3) x, y and z of vertices; none of another element."""
    axes = "xyz" if element.name == "vertex" else ""
    if not element.count or not element.properties:
        return place, np.empty((0, 3))
    lengths = _lengths(data, place, element, order)
    fields: list[tuple[str, str, tuple[int, ...]]] = []
    for number, (one, length) in enumerate(zip(element.properties, lengths, strict=True)):
        if one.length:
            fields.append((f"length {number}", order + one.length, ()))
        name = one.name if one.name in axes and not one.length else f"{one.name} {number}"
        fields.append((name, order + one.kind, (length,) if one.length else ()))
    layout = np.dtype(fields)
    end = place + element.count * layout.itemsize
    if end <= len(data):
        found = np.frombuffer(data, dtype=layout, count=element.count, offset=place)
        checked = [(f"length {number}", length) for number, length in enumerate(lengths) if length >= 0]
        if all(np.all(found[name] == length) for name, length in checked):
            return end, np.stack([found[axis].astype(np.float64) for axis in axes], -1) if axes else np.empty((0, 3))
    elif all(length < 0 for length in lengths):
        needed = element.count * layout.itemsize
        raise ValueError(
            f"{element.count} entries of {quoted(element.name)} need {needed} bytes, found {len(data) - place}"
        )
    points = []
    for number in range(element.count):
        entry: dict[str, float] = {}
        for one in element.properties:
            length, place = _length(data, place, one, order)
            if one.name in axes and not one.length:
                (entry[one.name],) = struct.unpack_from(order + one.kind, data, place)
            place += max(length, 0 if one.length else 1) * struct.calcsize(order + one.kind)
        if place > len(data):
            raise ValueError(f"the file ends in entry {number} of {quoted(element.name)}, expected {element.count}")
        if axes:
            points.append([entry[axis] for axis in axes])
    return place, np.array(points).reshape(-1, 3)


def _lengths(data: bytes, place: int, element: _Element, order: str) -> list[int]:
    """Lengths of the first entry's lists; -1 for what is a single number."""
    found = []
    for one in element.properties:
        length, place = _length(data, place, one, order)
        place += max(length, 0 if one.length else 1) * struct.calcsize(order + one.kind)
        found.append(length)
    return found


def _length(data: bytes, place: int, one: _Property, order: str) -> tuple[int, int]:
    """Return the length of a list, -1 for a single number, and where its numbers begin."""
    if not one.length:
        return -1, place
    if place + struct.calcsize(order + one.length) > len(data):
        raise ValueError(f"the file ends in the list {quoted(one.name)}")
    (length,) = struct.unpack_from(order + one.length, data, place)
    if length != int(length) or not 0 <= length <= len(data):
        raise ValueError(f"the list {quoted(one.name)} has the length {length}, more than the file holds or none")
    return int(length), place + struct.calcsize(order + one.length)


def _ascii(body: bytes, elements: list[_Element]) -> Array:
    skip, count = sum(element.count for element in elements[:-1]), elements[-1].count
    lines = sum(1 for line in io.BytesIO(body) if not line.isspace())
    if lines < skip + count:
        raise ValueError(f"{quoted(count)} vertices are declared, found {max(lines - skip, 0)} lines")
    check_count(count)

    def rows() -> Iterator[list[bytes]]:
        filled = (line for line in io.BytesIO(body) if not line.isspace())
        for number, line in enumerate(islice(filled, skip, skip + count)):
            words, place, entry = line.split(), 0, {}
            for one in elements[-1].properties:
                if one.length:
                    place += int(words[place])
                else:
                    entry[one.name] = place
                place += 1
            if place != len(words):
                raise ValueError(f"vertex {number} has {len(words)} numbers, expected {place} by the header")
            yield [words[entry[axis]] for axis in "xyz"]

    return table(rows())
