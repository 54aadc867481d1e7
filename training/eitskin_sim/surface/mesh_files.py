"""The vertices of OBJ and STL files. An STL file has those of every triangle: one that they share counts once."""

import re
from typing import Final

import numpy as np

from eitskin_sim.arrays import Array
from eitskin_sim.surface.words import check_count, table

STL_HEAD: Final = 84
"""Bytes of a binary STL file before its triangles: a text, and their number."""

STL_TRIANGLE: Final = np.dtype([("normal", "<f4", (3,)), ("corners", "<f4", (3, 3)), ("about", "<u2")])
"""A triangle of a binary STL file."""


def read_obj(data: bytes) -> Array:
    """Return the (n, 3) vertices of an OBJ file's bytes.

    Raises:
        ValueError: A vertex has fewer than three numbers, or there is none.
    """
    return _vertices(data, rb"v")


def read_stl(data: bytes) -> Array:
    """Return the (n, 3) corners of the triangles of an STL file's bytes, ASCII or binary.

    Raises:
        ValueError: It is no STL file.
    """
    count = int.from_bytes(data[STL_HEAD - 4 : STL_HEAD], "little")
    if len(data) >= STL_HEAD and len(data) == STL_HEAD + count * STL_TRIANGLE.itemsize:
        check_count(3 * count)
        found = np.frombuffer(data, dtype=STL_TRIANGLE, offset=STL_HEAD)["corners"].reshape(-1, 3).astype(np.float64)
    elif data.lstrip()[:5].lower() == b"solid":
        if b"endsolid" not in data.lower():
            raise ValueError("it has no 'endsolid': it was cut off")
        found = _vertices(data, rb"vertex")
    else:
        raise ValueError(f"no STL file: {count} triangles are announced in {len(data)} bytes")
    return np.unique(found, axis=0)


def _vertices(data: bytes, word: bytes) -> Array:
    lines = re.finditer(rb"(?:^|\r)[ \t]*" + word + rb"[ \t]+([^\r\n]*)", data, re.MULTILINE | re.IGNORECASE)
    found = table(line[1].split()[:3] for line in lines)
    if found.shape[1:] != (3,):
        raise ValueError(f"the lines {word.decode()!r} have {found.shape[1]} numbers, expected x y z")
    return found
