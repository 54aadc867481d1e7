"""The files that scanners write: .ply, .pcd, text, .npy, and the vertices of .obj and .stl, read as points.

Only the coordinates are taken. Colours, normals, intensities and faces may be there and are passed over. Libraries were
weighed: trimesh 5.2 reads a file that was cut short without a word, and neither it nor plyfile 1.1 (of the GPL) reads a
comment in Latin-1; neither reads PCD or text.
"""

import struct
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.errors import SkinError
from eitskin_proto.files.arrays import read_npy
from eitskin_proto.files.plain import quoted
from eitskin_proto.files.reading import FileError, read_bytes
from eitskin_sim.arrays import Array
from eitskin_sim.surface.mesh_files import read_obj, read_stl
from eitskin_sim.surface.pcd import read_pcd
from eitskin_sim.surface.ply import read_ply
from eitskin_sim.surface.text_points import read_text

LARGEST_FILE: Final = 256 << 20
"""Bytes of a file of points."""

READERS: Final = {
    ".ply": read_ply, ".pcd": read_pcd, ".obj": read_obj, ".stl": read_stl,
    **dict.fromkeys((".xyz", ".txt", ".csv", ".asc", ".pts"), read_text),
}  # fmt: skip
"""Readers of a file's bytes, by its suffix."""

SUFFIXES: Final = ", ".join(READERS) + " or .npy"
"""Of files of points."""

MOST_COLUMNS: Final = 16
"""Numbers of a point in an array, at most: more are an image's columns."""


class PointFileError(SkinError):
    """A file that holds no points."""


@np.errstate(invalid="ignore")  # a NaN that signals is one like any other
def read_points(path: str | Path) -> Array:
    """Return the (n, 3) points of a file.

    Args:
        path: A file of one of ``SUFFIXES``, which decides.

    Raises:
        PointFileError: The file cannot be opened, or holds no points; the message says where it broke off.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in (*READERS, ".npy"):
        raise PointFileError(f"{path}: expected a {SUFFIXES} file, found suffix {path.suffix!r}")
    try:
        if suffix == ".npy":
            points = _rows(read_npy(path, LARGEST_FILE, records=True))
        else:
            points = READERS[suffix](read_bytes(path, LARGEST_FILE))
    except OSError as error:
        raise PointFileError(
            f"points file {path} cannot be read: {error.strerror or error}; name a {SUFFIXES} file"
        ) from error
    except (FileError, ValueError, LookupError, OverflowError, struct.error) as error:
        raise PointFileError(f"{path} cannot be read as {suffix}: {error}") from error
    if points.dtype.kind not in "fiu":
        raise PointFileError(f"{path} holds {points.dtype}, expected numbers")
    if points.ndim != 2 or points.shape[1] < 3 or len(points) == 0:
        raise PointFileError(f"{path} holds an array of shape {points.shape}, expected (n, 3), n at least 1")
    return np.ascontiguousarray(points[:, :3], dtype=np.float64)


def _rows(values: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """(n, columns) of points in rows, of an organised image of points, or of records with the fields x, y and z."""
    if names := values.dtype.names:
        axes = [name for axis in "xyz" for name in names if name.lower() == axis] or list(names)
        if len(axes) != 3:
            raise ValueError(f"its fields are {', '.join(map(quoted, names))}, expected x, y and z")
        values = np.stack([values[name].astype(np.float64) for name in axes], axis=-1)
    if values.ndim < 2 or not 3 <= values.shape[-1] <= MOST_COLUMNS:
        raise ValueError(
            f"it holds an array of shape {values.shape}, expected (n, 3) or (rows, columns, 3), the coordinates last"
        )
    return values.reshape(-1, values.shape[-1])
