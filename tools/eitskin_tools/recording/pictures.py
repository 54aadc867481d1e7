"""The map and the bent surface as Foxglove shows them: its well-known schemas, in their JSON form.

JSON needs no further package and every release of Foxglove reads it; binary fields are base64. The surface is a cloud
of points, a pixel each, with the map's value for a colour; the map is a grid of 32-bit floats on the flat sheet.
"""

import base64
import json
from typing import Any, Final

import numpy as np
import numpy.typing as npt

NS: Final = 1_000_000_000
FLOAT32: Final = 7
"""``foxglove.PackedElementField.type`` of a float32."""

STEPS: Final = np.float32(1024)
"""Of a map's values from 0 to 1, in pictures."""

STRIDE: Final = 18
"""Bytes of a point: a multiple of three, so that in base64 the same point is the same text, which packs to nothing."""

FRAME_ID: Final = "skin"
POSE: Final = {"position": {"x": 0.0, "y": 0.0, "z": 0.0}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}


def pixel_of(cloud_mm: npt.NDArray[np.float32]) -> tuple[float, float]:
    """Return width and height of a pixel in mm, by the places of their centres on a sheet that may be bent.

    Args:
        cloud_mm: (3, rows, columns).
    """
    rows, columns = cloud_mm.shape[1:]
    places = cloud_mm.astype(np.float64)
    width = float(np.linalg.norm(np.diff(places, axis=2), axis=0).mean()) if columns > 1 else 0.0
    height = float(np.linalg.norm(np.diff(places, axis=1), axis=0).mean()) if rows > 1 else 0.0
    return width or height, height or width


def grid(values: npt.NDArray[np.float32], pixel_mm: tuple[float, float], wall_ns: int) -> bytes:
    """Return a map as ``foxglove.Grid``.

    Args:
        values: (rows, columns), row 0 at y = 0.
        pixel_mm: Width and height of a pixel.
        wall_ns: When it was measured.
    """
    columns = values.shape[1]
    fields = [{"name": "touched", "offset": 0, "type": FLOAT32}]
    cell = {"x": pixel_mm[0] * 1e-3, "y": pixel_mm[1] * 1e-3}
    return _packed(wall_ns, fields, values, column_count=columns, cell_size=cell, row_stride=4 * columns, cell_stride=4)


def surface(values: npt.NDArray[np.float32], cloud_mm: npt.NDArray[np.float32], wall_ns: int) -> bytes:
    """Return the bent sheet as ``foxglove.PointCloud`` in metres, coloured by a map.

    Args:
        values: (rows, columns).
        cloud_mm: (3, rows, columns) in the pose in which it came.
        wall_ns: When it was measured.
    """
    points = np.zeros((values.size, STRIDE), dtype=np.uint8)
    points[:, :12] = np.ascontiguousarray(cloud_mm.reshape(3, -1).T * 1e-3, dtype="<f4").view(np.uint8)
    points[:, 12:16] = _rounded(values).reshape(-1, 1).view(np.uint8)
    fields = [
        {"name": name, "offset": 4 * index, "type": FLOAT32} for index, name in enumerate(("x", "y", "z", "touched"))
    ]
    return _packed(wall_ns, fields, points, point_stride=STRIDE)


def _rounded(values: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Return a map rounded to a 1024th: finer steps are invisible, and zeros in its last bytes compress well."""
    return np.ascontiguousarray(np.rint(values * STEPS) / STEPS, dtype="<f4")


def _packed(wall_ns: int, fields: list[dict[str, object]], data: npt.NDArray[Any], **more: object) -> bytes:
    stamp = {"sec": wall_ns // NS, "nsec": wall_ns % NS}
    plain = base64.b64encode(np.ascontiguousarray(data).tobytes()).decode("ascii")
    content = {"timestamp": stamp, "frame_id": FRAME_ID, "pose": POSE, "fields": fields, "data": plain, **more}
    return json.dumps(content, separators=(",", ":")).encode("ascii")
