r"""Arrays packed, and read within bounds: ``.npy`` and ``.npz`` as numpy writes them, of plain numbers and texts.

numpy's own reader trusts a header: it allocates as many rows as the header states, and hands a damaged one to Python's
tokenizer, whose errors are of many kinds. Here a header is one short literal whose size must be that of the bytes
behind it; nothing is unpickled::

    \x93NUMPY  major minor  length (2 bytes, or 4)  {'descr': '<f8', 'fortran_order': False, 'shape': (104,), }  data
"""

import ast
import io
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.files.archive import BadArchiveError, members
from eitskin_proto.files.plain import quoted
from eitskin_proto.files.reading import FileError, opened, read_bytes

MAGIC: Final = b"\x93NUMPY"

LONGEST_HEADER: Final = 1024
"""Bytes of a header; 128 are usual."""

MOST_AXES: Final = 8
MOST_ARRAYS: Final = 256
"""In one ``.npz``."""

DESCRIPTION: Final = re.compile(r"[<>|=]?(?:[?]|b1|[iu][1248]|f[248]|c(?:8|16)|[SU][0-9]{1,6})")
"""Types of elements: truth values, integers, real and complex numbers, texts."""

GAP: Final = re.compile(r"\|V[0-9]{1,4}")
"""Bytes between fields that hold nothing."""

Array = npt.NDArray[np.float64]
Arrays = Mapping[str, npt.NDArray[Any]]


def parse_npy(data: bytes, what: str = "it", *, records: bool = False) -> npt.NDArray[Any]:
    """Return the array of a ``.npy`` file's bytes.

    Args:
        data: All of it.
        what: How messages call it.
        records: Whether its elements may have named fields, each of plain numbers.

    Raises:
        FileError: It is none, holds objects, or another number of bytes than its header says.
    """
    if data[:2] == b"PK":
        raise FileError(f"{what} is an archive of arrays (.npz), expected one array (.npy)")
    if data[: len(MAGIC)] != MAGIC or len(data) < 10:
        raise FileError(f"{what} is not an .npy file, expected one written by numpy.save")
    wide = data[6] > 1
    start = 12 if wide else 10
    length = int.from_bytes(data[8:start], "little")
    if length > LONGEST_HEADER or start + length > len(data):
        raise FileError(f"{what} has a header of {length} bytes, expected at most {LONGEST_HEADER} and no more than it")
    kind, fortran, shape = _header(data[start : start + length], what, records=records)
    found = len(data) - start - length
    needed = math.prod(shape) * kind.itemsize
    if found != needed:
        raise FileError(
            f"{what} holds {found} bytes of data, expected {quoted(needed)} by its header: it is cut off or damaged"
        )
    values = np.frombuffer(data, dtype=kind, count=math.prod(shape), offset=start + length)
    shaped = values.reshape(shape, order="F" if fortran else "C")
    return np.array(shaped)  # one that may be written


def save_arrays(stream: BinaryIO, arrays: Mapping[str, npt.ArrayLike], *, compressed: bool = False) -> None:
    """Write a ``.npz`` of these arrays and no other.

    numpy's own ``allow_pickle=False`` is an array of that name to releases before 2.2.

    Args:
        stream: Where it goes.
        arrays: By name, of plain numbers and texts.
        compressed: Smaller, and slower to write.

    Raises:
        ValueError: One holds objects, which no reader of ours would take.
    """
    for name, values in arrays.items():
        if np.asarray(values).dtype.hasobject:
            raise ValueError(f"array {name!r} holds objects, expected plain numbers or texts")
    (np.savez_compressed if compressed else np.savez)(stream, **arrays)  # type: ignore[arg-type]


def pack_arrays(arrays: Mapping[str, npt.ArrayLike]) -> bytes:
    """Return an uncompressed ``.npz``; the same arrays give the same bytes. Raises as :func:`save_arrays`."""
    buffer = io.BytesIO()
    save_arrays(buffer, arrays)
    return buffer.getvalue()


def read_npy(path: str | Path, largest: int, *, records: bool = False) -> npt.NDArray[Any]:
    """Return the array of a ``.npy`` file, as :func:`parse_npy` does.

    Raises:
        FileError: It is none, longer than ``largest`` bytes, or no regular file.
        OSError: It cannot be read.
    """
    return parse_npy(read_bytes(path, largest), str(path), records=records)


def parse_npz(source: bytes | BinaryIO, largest: int, what: str = "it") -> dict[str, npt.NDArray[Any]]:
    """Return the arrays of a ``.npz`` file by name.

    Args:
        source: Its bytes, or the open file.
        largest: Most bytes that all of it may have when it is unpacked.
        what: How messages call it.

    Raises:
        FileError: It is none, damaged, or longer.
    """
    try:
        found = members(source)
        if len(found) > MOST_ARRAYS:
            raise FileError(f"{what} holds {len(found)} arrays, expected at most {MOST_ARRAYS}")
        arrays: dict[str, npt.NDArray[Any]] = {}
        for name, member in found.items():
            content = member.read(largest)
            largest -= len(content)
            arrays[name.removesuffix(".npy")] = parse_npy(content, f"{what}: {quoted(name)}")
        return arrays
    except BadArchiveError as error:
        raise FileError(f"{what} is not an intact .npz file: {error}") from error


def read_npz(path: str | Path, largest: int) -> dict[str, npt.NDArray[Any]]:
    """Return the arrays of a ``.npz`` file by name.

    Args:
        path: A regular file.
        largest: Most bytes that it may have, on disk and when it is unpacked.

    Raises:
        FileError: It is none, damaged, or longer.
        OSError: It cannot be read.
    """
    with opened(path, largest) as stream:
        return parse_npz(stream, largest, str(path))


def _header(raw: bytes, what: str, *, records: bool = False) -> tuple[np.dtype[Any], bool, tuple[int, ...]]:
    try:
        found = ast.literal_eval(raw.decode("latin-1").strip())
    except (ValueError, SyntaxError, TypeError, RecursionError, MemoryError) as error:
        raise FileError(
            f"{what} has a damaged .npy header ({type(error).__name__}), expected one written by numpy.save"
        ) from error
    if not isinstance(found, dict) or set(found) != {"descr", "fortran_order", "shape"}:
        raise FileError(f"{what} has an .npy header with other fields than descr, fortran_order and shape")
    kind, fortran, shape = found["descr"], found["fortran_order"], found["shape"]
    if records and isinstance(kind, list) and all(map(_is_field, kind)):
        try:
            kind = np.lib.format.descr_to_dtype(kind)  # it leaves out the gaps between fields
        except ValueError as error:
            raise FileError(f"{what} has fields that contradict each other: {error}") from error
    elif not isinstance(kind, str) or DESCRIPTION.fullmatch(kind) is None:
        expected = "plain numbers, or fields of one number each" if records else "plain numbers or texts"
        raise FileError(f"{what} holds elements of type {quoted(kind)}, expected {expected}")
    if not isinstance(shape, tuple) or len(shape) > MOST_AXES or not isinstance(fortran, bool):
        raise FileError(f"{what} has the shape {quoted(shape)}, expected at most {MOST_AXES} axes")
    if not all(isinstance(size, int) and not isinstance(size, bool) and 0 <= size < 1 << 48 for size in shape):
        raise FileError(f"{what} has a shape that is not a list of sizes, expected whole numbers from 0 up")
    return np.dtype(kind), fortran, shape


def _is_field(field: Any) -> bool:
    """Whether this is the name and the type of a field, or of a gap between fields."""
    if not isinstance(field, tuple) or len(field) != 2 or not all(isinstance(one, str) for one in field):
        return False
    return (DESCRIPTION if field[0] else GAP).fullmatch(field[1]) is not None


def numbers(arrays: Arrays, name: str, shape: Sequence[int | None] | None = None) -> Array:
    """Return an array of finite numbers as float64.

    Args:
        arrays: Of a file.
        name: Of one that is there.
        shape: None in it is any length; None in its place is any shape.

    Raises:
        ValueError: It holds something else, or has another shape.
    """
    found = arrays[name]
    if found.dtype.kind not in "fiu":
        raise ValueError(f"{name} holds {found.dtype}, expected real numbers")
    if shape is not None and not _fits(found.shape, shape):
        raise ValueError(f"{name} has shape {found.shape}, expected {_shape_text(shape)}")
    finite = np.isfinite(found)
    if not finite.all():
        where = tuple(int(one) for one in np.argwhere(~finite)[0])
        raise ValueError(
            f"{name}{list(where)} is {found[where]}, expected finite numbers; {int((~finite).sum())} are not: leave "
            "out such samples"
        )
    return np.asarray(found, dtype=np.float64)


def text(arrays: Arrays, name: str) -> str:
    """Return the text of an array that holds one, as str or as UTF-8.

    Raises:
        ValueError: It holds something else.
    """
    found = arrays[name]
    if found.dtype.kind not in "US" or found.size != 1:
        raise ValueError(f"{name} is {found.dtype} of shape {found.shape}, expected one text")
    one = found.reshape(-1)[0]
    return one.decode("utf-8") if isinstance(one, bytes) else str(one)


def _fits(found: Sequence[int], shape: Sequence[int | None]) -> bool:
    return len(found) == len(shape) and all(want in (None, have) for have, want in zip(found, shape, strict=True))


def _shape_text(shape: Sequence[int | None]) -> str:
    return "(" + ", ".join("n" if one is None else str(one) for one in shape) + ("," if len(shape) == 1 else "") + ")"
