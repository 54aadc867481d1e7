"""The files that scanners write: .ply and .pcd (ASCII and binary), .xyz (text) and .npy, read as points in mm.

Only the coordinates are taken. Colours, normals, intensities and faces may be there and are passed over.
"""

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.errors import SkinError
from eitskin_proto.files.arrays import read_npy
from eitskin_proto.files.reading import FileError, read_bytes
from eitskin_sim.surface.pcd import read_pcd
from eitskin_sim.surface.ply import read_ply
from eitskin_sim.surface.words import table

Array = npt.NDArray[np.float64]

LARGEST_FILE: Final = 256 << 20
"""Bytes of a file of points."""

SUFFIXES: Final = ".ply, .pcd, .xyz or .npy"
"""Of files of points."""


class PointFileError(SkinError):
    """A file that holds no points."""


def read_points(path: str | Path) -> Array:
    """Return the (n, 3) points of a file.

    Args:
        path: A .ply, .pcd, .xyz or .npy file; the suffix decides.

    Raises:
        PointFileError: The file cannot be opened, or holds no points; the message says where it broke off.
    """
    path = Path(path)
    readers = {".ply": _read_ply, ".pcd": _read_pcd, ".xyz": _read_xyz, ".npy": _read_npy}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise PointFileError(f"{path}: expected a {SUFFIXES} file, found suffix {path.suffix!r}")
    try:
        points = reader(path)
    except OSError as error:
        raise PointFileError(
            f"points file {path} cannot be read: {error.strerror or error}; name a {SUFFIXES} file"
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


def _read_ply(path: Path) -> Array:
    return read_ply(read_bytes(path, LARGEST_FILE))


def _read_pcd(path: Path) -> Array:
    return read_pcd(read_bytes(path, LARGEST_FILE))


def _read_xyz(path: Path) -> Array:
    def rows(data: bytes) -> Iterator[list[bytes]]:
        for number, line in enumerate(io.BytesIO(data)):
            words = line.replace(b",", b" ").replace(b";", b" ").split(None, 3)
            if not words or words[0].startswith(b"#"):
                continue
            if len(words) < 3:
                raise ValueError(f"line {number + 1} has {len(words)} numbers, expected x y z")
            yield words[:3]

    return table(rows(read_bytes(path, LARGEST_FILE)))
