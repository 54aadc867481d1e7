"""A recording as rosbag2, without ROS: standard messages only, so that every ROS 2 machine plays it.

===================  =======================  =======================================================
/eitskin/voltages    sensor_msgs/Image        64FC1, one row of 104 V a frame
/eitskin/map         sensor_msgs/Image        32FC1, where the recording has maps; row 0 is y = 0
/eitskin/surface     sensor_msgs/PointCloud2  x y z in metres, when a cloud came into use
/eitskin/state       std_msgs/String          JSON, as in the recording
===================  =======================  =======================================================
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin.errors import FrameError
from eitskin.messaging.streams.measured import CloudInUse, WireFrame
from eitskin.reference.normaliser import Normaliser
from eitskin_proto.errors import ProtocolError
from eitskin_proto.wire.frames import FrameView
from eitskin_proto.wire.scan_rows import ALL_DRIVES
from eitskin_tools.recording.codec import unpack_map
from eitskin_tools.recording.layout import CLOUD, MAP, STATE, WIRE, RecordingError
from eitskin_tools.recording.reader import Entry
from eitskin_tools.recording.script import Script

FRAME_ID: Final = "skin"
FLOAT32: Final = 7
"""``sensor_msgs/PointField.FLOAT32``"""

BAG_VERSION: Final = 9


def write_rosbag(folder: Path, script: Script, from_s: float | None = None, to_s: float | None = None) -> int:
    """Write a recording as a folder of rosbag2, and return how many messages it has.

    Args:
        folder: It must not be there.
        script: The recording.
        from_s: Begin so long after the first frame.
        to_s: End so long after it.

    Raises:
        RecordingError: The folder is there.
        OSError: It cannot be written.
    """
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    if folder.exists():
        raise RecordingError(f"{folder} exists already; name another folder, or remove it")
    store = get_typestore(Stores.ROS2_JAZZY)
    messages = _Messages(store, script)
    begin_ns = script.first_ns + int((from_s or 0.0) * 1e9)
    end_ns = script.last_ns if to_s is None else script.first_ns + int(to_s * 1e9)
    count = 0
    with Writer(folder, version=BAG_VERSION, storage_plugin=StoragePlugin.MCAP) as bag:
        kinds = {"voltages": "sensor_msgs/msg/Image", "map": "sensor_msgs/msg/Image",
                 "surface": "sensor_msgs/msg/PointCloud2", "state": "std_msgs/msg/String"}  # fmt: skip
        to = {name: bag.add_connection(f"/eitskin/{name}", kind, typestore=store) for name, kind in kinds.items()}
        makers: dict[str, Callable[[bytes, int], Any]] = {
            WIRE.topic: messages.voltages, MAP.topic: messages.map, CLOUD.topic: messages.surface,
            STATE.topic: messages.text,
        }  # fmt: skip
        names = {WIRE.topic: "voltages", MAP.topic: "map", CLOUD.topic: "surface", STATE.topic: "state"}

        def write(entry: Entry, at_ns: int) -> int:
            found, name = makers[entry.topic](entry.data, at_ns), names[entry.topic]
            if found is not None:
                bag.write(to[name], at_ns, store.serialize_cdr(found, kinds[name]))
            return found is not None

        held: dict[str, Entry] = {}  # what was said last before the part, and holds at its beginning
        for entry in script.recording.entries(names):
            if entry.log_ns < begin_ns:
                if entry.topic in (CLOUD.topic, STATE.topic):
                    held[entry.topic] = entry
            elif entry.log_ns <= end_ns:
                while held:
                    count += write(held.popitem()[1], begin_ns)
                count += write(entry, entry.log_ns)
    return count


class _Messages:
    """Makes ROS messages of a recording's."""

    def __init__(self, store: Any, script: Script) -> None:
        self._types = store.types
        self._normaliser, self._view = Normaliser(script.hello.volts_per_count), FrameView()

    def _type(self, name: str) -> Any:
        return self._types[name]

    def _header(self, wall_ns: int) -> Any:
        stamp = self._type("builtin_interfaces/msg/Time")(sec=wall_ns // 10**9, nanosec=wall_ns % 10**9)
        return self._type("std_msgs/msg/Header")(stamp=stamp, frame_id=FRAME_ID)

    def _image(self, values: npt.NDArray[Any], encoding: str, wall_ns: int) -> Any:
        rows, columns = values.shape
        return self._type("sensor_msgs/msg/Image")(
            header=self._header(wall_ns), height=rows, width=columns, encoding=encoding, is_bigendian=0,
            step=columns * values.itemsize, data=np.frombuffer(values.tobytes(), dtype=np.uint8),
        )  # fmt: skip

    def voltages(self, data: bytes, wall_ns: int) -> Any:
        """Return the voltages of a whole scan; None for any other frame."""
        try:
            self._view.load(WireFrame.of(data).payload)
        except (FrameError, ProtocolError):
            return None
        if self._view.drives != ALL_DRIVES:
            return None
        self._normaliser.load(self._view.counts)
        return self._image(self._normaliser.voltages()[None], "64FC1", wall_ns)

    def map(self, data: bytes, wall_ns: int) -> Any:
        """Return a map."""
        return self._image(unpack_map(data)[1], "32FC1", wall_ns)

    def surface(self, data: bytes, wall_ns: int) -> Any:
        """Return a cloud in metres; None for one that makes no sense."""
        try:
            cloud = CloudInUse.of(data).cloud
        except FrameError:
            return None
        points = np.ascontiguousarray(cloud.reshape(3, -1).T * np.float32(1e-3), dtype="<f4")
        field = self._type("sensor_msgs/msg/PointField")
        fields = [field(name=name, offset=4 * at, datatype=FLOAT32, count=1) for at, name in enumerate("xyz")]
        return self._type("sensor_msgs/msg/PointCloud2")(
            header=self._header(wall_ns), height=1, width=len(points), fields=fields, is_bigendian=False,
            point_step=12, row_step=12 * len(points), data=np.frombuffer(points.tobytes(), dtype=np.uint8),
            is_dense=True,
        )  # fmt: skip

    def text(self, data: bytes, _: int) -> Any:
        """Return a text."""
        return self._type("std_msgs/msg/String")(data=data.decode("utf-8", "replace"))
