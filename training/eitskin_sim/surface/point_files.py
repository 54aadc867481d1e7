"""The files that scanners write: .ply (ASCII, little and big endian), .xyz (text) and .npy, read as points in mm.

Only the coordinates are taken. Colours, normals, intensities and faces may be there and are passed over.
"""

import io
from collections.abc import Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.errors import SkinError
from eitskin_proto.files.arrays import read_npy
from eitskin_proto.files.plain import quoted
from eitskin_proto.files.reading import FileError, read_bytes

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
"""A PLY header is over within so many bytes."""

LARGEST_FILE: Final = 256 << 20
"""Bytes of a file of points."""

MOST_POINTS: Final = 4_000_000
"""A scanner of 0.1 mm sees 1,500,000 on the sheet."""


class PointFileError(SkinError):
    """A file that holds no points."""


def read_points(path: str | Path) -> Array:
    """Return the (n, 3) points of a file.

    Args:
        path: A .ply, .xyz or .npy file; the suffix decides.

    Raises:
        PointFileError: The file cannot be opened, or holds no points; the message says where it broke off.
    """
    path = Path(path)
    readers = {".ply": _read_ply, ".xyz": _read_xyz, ".npy": _read_npy}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise PointFileError(f"{path}: points come as a .ply, .xyz or .npy file, found suffix {path.suffix!r}")
    try:
        points = reader(path)
    except OSError as error:
        raise PointFileError(
            f"points file {path} cannot be read: {error.strerror or error}; name a .ply, .xyz or .npy file"
        ) from error
    except (FileError, ValueError, IndexError, LookupError, OverflowError) as error:
        raise PointFileError(f"{path} cannot be read as {path.suffix.lower()}: {error}") from error
    if points.dtype.kind not in "fiu":
        raise PointFileError(f"{path} holds {points.dtype}, expected numbers")
    if points.ndim != 2 or points.shape[1] < 3 or len(points) == 0:
        raise PointFileError(f"{path} holds an array of shape {points.shape}, expected (n, 3), n at least 1")
    return np.ascontiguousarray(points[:, :3], dtype=np.float64)


def _read_npy(path: Path) -> npt.NDArray[np.generic]:
    return read_npy(path, LARGEST_FILE)


def _read_xyz(path: Path) -> Array:
    def rows(data: bytes) -> Iterator[list[bytes]]:
        for number, line in enumerate(io.BytesIO(data)):
            words = line.replace(b",", b" ").replace(b";", b" ").split(None, 3)
            if not words or words[0].startswith(b"#"):
                continue
            if len(words) < 3:
                raise ValueError(f"line {number + 1} has {len(words)} numbers, expected x y z")
            yield words[:3]

    return _table(rows(read_bytes(path, LARGEST_FILE)))


def _table(rows: Iterable[list[bytes]]) -> Array:
    """Return (n, 3) numbers of rows of words, a piece at a time: words take ten times the memory of numbers."""
    found: list[Array] = []
    count = 0
    for piece in _pieces(rows):
        count += len(piece)
        if count > MOST_POINTS:
            raise ValueError(f"more than {MOST_POINTS} points; measure less densely: 7,000 do for a sheet")
        found.append(np.array([[float(word) for word in row] for row in piece], dtype=np.float64))
    return np.concatenate(found) if found else np.empty((0, 3))


def _pieces(rows: Iterable[list[bytes]]) -> Iterator[list[list[bytes]]]:
    left = iter(rows)
    while piece := list(islice(left, 4096)):
        yield piece


def _read_ply(path: Path) -> Array:
    data = read_bytes(path, LARGEST_FILE)
    end = data.find(b"end_header", 0, LARGEST_HEADER)
    if not data.startswith(b"ply") or end < 0:
        raise ValueError("no PLY header ('ply' ... 'end_header')")
    body = data.index(b"\n", end) + 1
    order, elements = _ply_header(data[:end].decode("ascii"))
    if order == "":
        return _ply_ascii(data[body:], elements)
    for name, count, properties in elements:
        if any(kind == "list" for _, kind in properties):
            raise ValueError(f"element {quoted(name)} with a list stands before the vertices: save the vertices first")
        layout = np.dtype([(label, order + PLY_TYPES[kind]) for label, kind in properties])
        if len(data) - body < count * layout.itemsize:
            raise ValueError(
                f"{count} entries of {quoted(name)} need {count * layout.itemsize} bytes, found {len(data) - body}"
            )
        if name == "vertex":
            if count > MOST_POINTS:
                raise ValueError(f"{count} points, expected at most {MOST_POINTS}; measure less densely")
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
        raise ValueError(f"{quoted(count)} vertices are announced, {max(lines - skip, 0)} lines are there")

    def rows() -> Iterator[list[bytes]]:
        for line in islice(io.BytesIO(body), skip, skip + count):
            words = line.split(None, max(columns) + 1)
            yield [words[column] for column in columns]

    return _table(rows())
