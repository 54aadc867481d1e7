"""PCD files, of ROS and the Point Cloud Library: ASCII, binary and binary_compressed.

Fields beside x, y and z are passed over. A compressed body holds its two sizes and then, packed by LZF, all numbers of
the first field, all of the second, and so on.
"""

import io
from collections.abc import Iterator
from itertools import islice
from typing import Final

import numpy as np

from eitskin_proto.files.plain import quoted
from eitskin_sim.arrays import Array
from eitskin_sim.surface.words import check_count, table

LARGEST_HEADER: Final = 65_536
"""Longest header in bytes."""

MAX_NUMBERS_PER_POINT: Final = 1024
"""Numbers of a point, at most: there are descriptors of 308."""

FORMS: Final = ("ascii", "binary", "binary_compressed")
"""Kinds of DATA."""

LARGEST_BODY: Final = 256 << 20
"""Bytes that a compressed body may unpack to."""

KINDS: Final = {"F": "f", "I": "i", "U": "u"}
"""TYPE of a field, and numpy's."""


def read_pcd(data: bytes) -> Array:
    """Return the (n, 3) points of a file's bytes; those that were not seen are NaN there.

    Raises:
        ValueError: It is no PCD file, or it holds no points.
    """
    header, form, body = _header(data)
    names, count = [name.lower() for name in header["FIELDS"]], int(header["POINTS"][0])
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
    size = count * layout.itemsize
    if form == "binary_compressed":
        packed, whole = (int.from_bytes(body[place : place + 4], "little") for place in (0, 4))
        if whole != size or len(body) < 8 + packed or size > LARGEST_BODY:
            raise ValueError(f"{packed} bytes of {len(body)} unpack to {whole}, expected {size} for {count} points")
        body, place, found = memoryview(unpack(bytes(body[8 : 8 + packed]), size)), 0, []
        for number, name in enumerate(names):
            kind, times = layout.fields[f"f{number}"][0].base, repeated[number]  # type: ignore[index]
            if name in "xyz":
                numbers = np.frombuffer(body, dtype=kind, count=count * times, offset=place)
                found.append((name, numbers.reshape(count, times)[:, 0].astype(np.float64)))
            place += count * times * kind.itemsize
        return np.stack([dict(found)[axis] for axis in "xyz"], 1)
    if len(body) < size:
        raise ValueError(f"{count} points need {size} bytes, found {len(body)}")
    points = np.frombuffer(body, dtype=layout, count=count)
    return np.stack([points[f"f{names.index(axis)}"].reshape(count, -1)[:, 0].astype(np.float64) for axis in "xyz"], 1)


def _header(data: bytes) -> tuple[dict[str, list[str]], str, memoryview]:
    """Return the header's words by their keys, the form of the data, and the data."""
    found: dict[str, list[str]] = {}
    place = 0
    while place < min(len(data), LARGEST_HEADER):
        end = data.find(b"\n", place)
        line = data[place : end if end >= 0 else len(data)].decode("latin-1").split()
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
    if form not in FORMS:
        raise ValueError(f"DATA {quoted(form)}: expected {', '.join(FORMS)}")
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
        filled = (line for line in io.BytesIO(body) if not line.isspace())
        for number, line in enumerate(islice(filled, count)):
            words = line.split(None, max(columns) + 1)
            if len(words) <= max(columns):
                raise ValueError(f"point {number} has {len(words)} numbers, expected {max(columns) + 1} at least")
            yield [words[column] for column in columns]

    found = table(rows())
    if len(found) < count:
        raise ValueError(f"{count} points are declared, found {len(found)}")
    return found


def unpack(packed: bytes, size: int) -> bytes:
    """Return what LZF packed: runs of bytes, and copies of what came before.

    Raises:
        ValueError: It is damaged, or has another size.
    """
    found, place = bytearray(), 0
    try:
        while place < len(packed) and len(found) <= size:
            head, place = packed[place], place + 1
            if head < 32:
                found += packed[place : place + head + 1]
                place += head + 1
                continue
            length = head >> 5
            if length == 7:
                length, place = length + packed[place], place + 1
            start = len(found) - ((head & 31) << 8) - packed[place] - 1
            length, place = length + 2, place + 1
            if start < 0:
                raise ValueError("the compressed points are damaged: they refer to bytes before the first")
            part = found[start : start + length]
            found += (part * (length // len(part) + 1))[:length]
    except IndexError as error:
        raise ValueError("the compressed points are cut off") from error
    if len(found) != size:
        raise ValueError(f"the compressed points unpack to {len(found)} bytes, expected {size}")
    return bytes(found)
