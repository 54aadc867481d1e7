"""PCD files, of ROS and the Point Cloud Library: ASCII and binary. Fields beside x, y and z are passed over."""

import io
from collections.abc import Iterator
from itertools import islice
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.files.plain import quoted
from eitskin_sim.surface.words import check_count, table

Array = npt.NDArray[np.float64]

LARGEST_HEADER: Final = 65_536
"""Longest header in bytes."""

MAX_NUMBERS_PER_POINT: Final = 1024
"""Numbers of a point, at most: there are descriptors of 308."""

KINDS: Final = {"F": "f", "I": "i", "U": "u"}
"""TYPE of a field, and numpy's."""


def read_pcd(data: bytes) -> Array:
    """Return the (n, 3) points of a file's bytes; those that were not seen are NaN there.

    Raises:
        ValueError: It is no PCD file, it is compressed, or it holds no points.
    """
    header, form, body = _header(data)
    names, count = header["FIELDS"], int(header["POINTS"][0])
    if count < 0:
        raise ValueError(f"{count} points are announced")
    check_count(count)
    repeated = [int(word) for word in header.get("COUNT", ["1"] * len(names))]
    if not {"x", "y", "z"} <= set(names):
        raise ValueError("the header's FIELDS have no x, y and z")
    if len(repeated) != len(names) or min(repeated) < 1 or sum(repeated) > MAX_NUMBERS_PER_POINT:
        raise ValueError(f"COUNT does not fit the {len(names)} FIELDS")
    if form == "ascii":
        columns = [sum(repeated[: names.index(axis)]) for axis in "xyz"]
        return _ascii(body, count, columns)
    layout = _layout(names, header["TYPE"], header["SIZE"], repeated)
    if len(body) < count * layout.itemsize:
        raise ValueError(f"{count} points need {count * layout.itemsize} bytes, found {len(body)}")
    points = np.frombuffer(body, dtype=layout, count=count)
    return np.stack([points[f"f{names.index(axis)}"].reshape(count, -1)[:, 0].astype(np.float64) for axis in "xyz"], 1)


def _header(data: bytes) -> tuple[dict[str, list[str]], str, memoryview]:
    """Return the header's words by their keys, the form of the data, and the data."""
    found: dict[str, list[str]] = {}
    place = 0
    while place < min(len(data), LARGEST_HEADER):
        end = data.find(b"\n", place)
        line = data[place : end if end >= 0 else len(data)].decode("ascii").split()
        place = end + 1 if end >= 0 else len(data)
        if not line or line[0].startswith("#"):
            continue
        found[line[0].upper()] = line[1:]
        if line[0].upper() == "DATA":
            break
    missing = [key for key in ("FIELDS", "SIZE", "TYPE", "POINTS", "DATA") if not found.get(key)]
    if missing:
        raise ValueError(f"no PCD header (it has no {', '.join(missing)})")
    form = found["DATA"][0].lower()
    if form not in ("ascii", "binary"):
        raise ValueError(f"DATA {quoted(form)}: expected ascii or binary; save it uncompressed")
    return found, form, memoryview(data)[place:]


def _layout(names: list[str], types: list[str], sizes: list[str], repeated: list[int]) -> "np.dtype[np.void]":
    """Return how a point's numbers follow each other; fields are named by their number, since names may repeat."""
    if not len(names) == len(types) == len(sizes):
        raise ValueError(f"{len(names)} FIELDS, {len(types)} TYPEs and {len(sizes)} SIZEs")
    fields = []
    for number, (name, kind, size, times) in enumerate(zip(names, types, sizes, repeated, strict=True)):
        if kind not in KINDS or size not in (("4", "8") if kind == "F" else ("1", "2", "4", "8")):
            raise ValueError(f"field {quoted(name)} has TYPE {quoted(kind)} and SIZE {quoted(size)}, which are unknown")
        fields.append((f"f{number}", f"<{KINDS[kind]}{size}", (times,)))
    return np.dtype(fields)


def _ascii(body: memoryview, count: int, columns: list[int]) -> Array:
    def rows() -> Iterator[list[bytes]]:
        for number, line in enumerate(islice(io.BytesIO(body), count)):
            words = line.split(None, max(columns) + 1)
            if len(words) <= max(columns):
                raise ValueError(f"point {number} has {len(words)} numbers, expected {max(columns) + 1} at least")
            yield [words[column] for column in columns]

    found = table(rows())
    if len(found) < count:
        raise ValueError(f"{count} points are declared, found {len(found)}")
    return found
