"""Standard messages of frames, in metres: one point a touch, the map as an image, the surface with the map's values."""

from array import array
from struct import pack

from sensor_msgs.msg import Image, PointCloud2, PointField
from std_msgs.msg import Header

from eitskin_ros.stream import Cloud, Frame

TOUCH = {
    "x": 1e-3, "y": 1e-3, "z": 1e-3, "nx": 1, "ny": 1, "nz": 1, "area": 1e-6, "strength": 1, "id": 1, "confidence": 1,
    "peak": 1, "error_x": 1e-3, "error_y": 1e-3, "amplitude": 1, "log_likelihood_ratio": 1, "sign": 1,
    "velocity_x": 1e-3, "velocity_y": 1e-3,
}  # fmt: skip
"""Fields of a touch, as ``eitskin convert`` writes them, and the m or m2 in their units. Unknown ones are NaN."""


def _points(header: Header, names: tuple[str, ...], data: bytes) -> PointCloud2:
    """Return points of these fields, of 4 bytes each."""
    kinds, size = {"id": PointField.UINT32}, 4 * len(names)
    cloud = PointCloud2(header=header, height=1, width=len(data) // size, point_step=size, row_step=len(data))
    cloud.fields = [
        PointField(name=name, offset=4 * at, datatype=kinds.get(name, PointField.FLOAT32), count=1)
        for at, name in enumerate(names)
    ]
    cloud.data, cloud.is_dense = array("B", data), True
    return cloud


def touches_message(header: Header, frame: Frame) -> PointCloud2:
    """Return one point a touch; none while nothing touches."""
    rows = ([touch[name] * scale for name, scale in TOUCH.items()] for touch in frame.touches)
    return _points(header, tuple(TOUCH), b"".join(pack("<8fI9f", *row) for row in rows))


def map_message(header: Header, frame: Frame) -> Image:
    """Return the map; row 0 is y = 0."""
    rows, columns = frame.fields["shape"]
    image = Image(header=header, height=rows, width=columns, encoding="32FC1", step=4 * columns)
    image.data = array("B", frame.map.tobytes())
    return image


def surface_message(header: Header, frame: Frame, cloud: Cloud) -> PointCloud2:
    """Return the place of each pixel with its value in the map."""
    values = cloud.points[:]
    values[3::4] = frame.map
    return _points(header, ("x", "y", "z", "value"), values.tobytes())
