"""Converts recordings for other programs: NPZ, Parquet and rosbag2.

NPZ and Parquet have a row a frame ::

    seq, device_us, read_ns, wall_ns, withheld, touched, gate_logit, solver, conditions     of every frame of the wire
    voltages_V (n, 104) V       cloud_index (n,) into the clouds, -1 for none or unknown
    map (n, rows, columns)      where the recording has it
    reference_V (104,) V        cloud_mm (k, 3, rows, columns), with predicted_V and predicted_flat_V (k, 104)

Frames of the idle mode, of a few drives, are left out and counted.

rosbag2 is written without ROS, in standard messages that every ROS 2 machine plays:

===================  =======================  =======================================================
/eitskin/voltages    sensor_msgs/Image        64FC1, one row of 104 V a frame
/eitskin/map         sensor_msgs/Image        32FC1, where the recording has maps; row 0 is y = 0
/eitskin/surface     sensor_msgs/PointCloud2  x y z in metres, when a cloud came into use
/eitskin/state       std_msgs/String          JSON, as in the recording
===================  =======================  =======================================================
"""

from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin.errors import FrameError
from eitskin.messaging.streams.measured import CloudInUse, WireFrame
from eitskin.reference.normaliser import normaliser_of, rows_of
from eitskin_proto.errors import ProtocolError
from eitskin_proto.files.arrays import save_arrays
from eitskin_proto.files.writing import replacing
from eitskin_proto.sensor.ids import PROTOCOL_ID
from eitskin_proto.sensor.table import N_ROWS
from eitskin_proto.wire.scan_rows import ALL_DRIVES
from eitskin_proto.wire.volts import view_of
from eitskin_tools.recording.codec import unpack_map
from eitskin_tools.recording.layout import CLOUD, MAP, STATE, WIRE, RecordingError
from eitskin_tools.recording.reader import Entry
from eitskin_tools.recording.script import Script, reference_of

MAX_FRAMES: Final = 2_000_000
"""In memory: nearly three hours at 200 frames/s, 1.7 GB."""

NUMBER_MASK: Final = (1 << 32) - 1
"""Of published frames are kept beside maps modulo one more."""

COLUMNS: Final[dict[str, Any]] = {
    "seq": np.int64, "device_us": np.int64, "read_ns": np.int64, "wall_ns": np.int64, "withheld": np.str_,
    "touched": np.bool_, "gate_logit": np.float64, "solver": np.str_, "map_seq": np.int64, "conditions": np.int64,
    "cloud_index": np.int64,
}  # fmt: skip
"""A value a frame."""


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """A recording in memory."""

    columns: dict[str, npt.NDArray[Any]]
    """By name, (n,) each."""
    voltages_V: npt.NDArray[np.float64]
    """(n, 104)"""
    reference_V: npt.NDArray[np.float64]
    """(104,), flat; the reference of the first frame whose reference is known."""
    later: npt.NDArray[np.bool_]
    """(n,) whether the frame belongs to a later reference."""
    clouds_mm: npt.NDArray[np.float32]
    """(k, 3, rows, columns)"""
    predicted_V: npt.NDArray[np.float64]
    predicted_flat_V: npt.NDArray[np.float64]
    """(k, 104), NaN where there is none."""
    maps: npt.NDArray[np.float32] | None
    """(n, rows, columns), NaN where the recording has none; None where it has none at all."""
    left_out: int
    """Frames of a few drives, or malformed ones."""


def table_of(script: Script, from_s: float | None = None, to_s: float | None = None) -> Table:
    """Return a recording as arrays.

    Args:
        script: The recording.
        from_s: Begin so long after the first frame.
        to_s: End so long after it.

    Raises:
        RecordingError: It holds no whole frame, or more than fit into memory.
        SkinError: Its reference cannot be used.
    """
    reference: bytes | None = None
    first = held = ""
    normaliser, view = normaliser_of(script.hello, rows_of(script.hello)), view_of(script.hello)
    revisions = sorted(script.clouds)
    index_of = {revision: index for index, revision in enumerate(revisions)}
    rows: dict[str, list[Any]] = {name: [] for name in COLUMNS}
    volts: list[npt.NDArray[np.float64]] = []
    numbers, later = list[int](), list[bool]()
    left_out, cloud = 0, -1
    for step in script.steps(from_s, to_s):
        frame = step.frame
        if step.conditions is not None:
            cloud, held = index_of.get(step.conditions.cloud, -1), step.conditions.reference
            if reference is None:
                reference, first = step.reference, held
        try:
            view.load(frame.payload)
        except ProtocolError:
            left_out += 1
            continue
        if view.drives != ALL_DRIVES or frame.seq is None:
            left_out += 1
            continue
        if len(volts) >= MAX_FRAMES:
            raise RecordingError(f"{script.path} has more than {MAX_FRAMES} frames: choose a part with --from and --to")
        normaliser.load(view.counts)
        volts.append(normaliser.voltages().copy())
        later.append(held != first)
        numbers.append(-1 if frame.frame is None else frame.frame)
        found = {
            "seq": frame.seq, "device_us": frame.device_us or 0, "read_ns": frame.read_ns, "wall_ns": step.log_ns,
            "withheld": frame.withheld, "touched": frame.touched, "gate_logit": frame.gate_logit,
            "solver": frame.solver, "map_seq": -1 if frame.map_seq is None else frame.map_seq,
            "conditions": frame.conditions, "cloud_index": cloud if step.known else -1,
        }  # fmt: skip
        for name, value in found.items():
            rows[name].append(value)
    if not volts:
        raise RecordingError(f"{script.path} has no complete frame in this part{script.ending}")
    columns = {name: np.array(rows[name], dtype=kind) for name, kind in COLUMNS.items()}
    clouds = [script.clouds[revision] for revision in revisions]
    return Table(
        columns,
        np.array(volts),
        reference_of(script, script.reference() if reference is None else reference).flat().voltages_V,
        np.array(later),
        np.array([one.cloud for one in clouds], dtype=np.float32),
        _volts([one.predicted for one in clouds]),
        _volts([one.predicted_flat for one in clouds]),
        _maps(script, numbers, columns),
        left_out,
    )


def measured_arrays(script: Script) -> tuple[dict[str, npt.NDArray[Any]], int]:
    """Return samples for ``eitskin evaluate --measured``, and the number of frames with a later reference.

    The samples are the publishable frames of the first reference.

    Raises:
        RecordingError: There is none.
        SkinError: Its reference cannot be used.
    """
    found = table_of(script)
    fit = (found.columns["withheld"] == "") & ~found.later
    if len(found.clouds_mm):
        fit &= found.columns["cloud_index"] >= 0  # of others it is not known how the sheet lay
    if not fit.any():
        raise RecordingError(f"{script.path} has no usable frame{script.ending}")
    arrays: dict[str, npt.NDArray[Any]] = {
        "voltages_V": found.voltages_V[fit],
        "reference_V": found.reference_V,
        "kind": np.where(found.columns["touched"][fit], "touched", "untouched"),
    }
    if script.head_text("grid_id"):
        arrays["grid_id"] = np.array(script.head_text("grid_id"))
    if len(found.clouds_mm):
        arrays |= {"cloud_mm": found.clouds_mm, "cloud_index": found.columns["cloud_index"][fit]}
    return arrays, int(found.later.sum())


def _volts(given: list[npt.NDArray[np.float64] | None]) -> npt.NDArray[np.float64]:
    return np.array([np.full(N_ROWS, np.nan) if one is None else one for one in given]).reshape(-1, N_ROWS)


def _maps(script: Script, numbers: list[int], columns: dict[str, npt.NDArray[Any]]) -> npt.NDArray[np.float32] | None:
    """Return the map of every frame, as far as the recording has it.

    The file has each map once, under the number of the first published frame with it. ``seq`` alone does not identify
    it, because a restarted device counts from 0 again.
    """
    first: list[int] = []
    found: list[tuple[int, npt.NDArray[np.float32]]] = []
    for entry in script.recording.entries({MAP.topic}):
        first.append(entry.sequence)
        found.append(unpack_map(entry.data))
    if not found:
        return None
    maps = np.full((len(numbers), *found[0][1].shape), np.nan, dtype=np.float32)
    rows = zip(numbers, columns["map_seq"].tolist(), columns["solver"].tolist(), strict=True)
    for row, (number, sequence, solver) in enumerate(rows):
        if solver == "none" and sequence >= 0:
            maps[row] = 0.0
            continue
        at = bisect_right(first, number & NUMBER_MASK)
        for known, values in found[max(at - 1, 0) : at + 1]:  # the frame that had it first may not have been received
            if known == sequence:
                maps[row] = values
                break
    return maps


def write_npz(path: Path, found: Table, script: Script) -> None:
    """Write a table as NPZ: arrays that ``eitskin evaluate --measured`` reads, and more.

    Raises:
        OSError: It cannot be written.
    """
    arrays: dict[str, npt.NDArray[Any]] = {
        **{name: values for name, values in found.columns.items() if name != "cloud_index"},
        "voltages_V": found.voltages_V,
        "reference_V": found.reference_V,
        "predicted_V": found.predicted_V,
        "predicted_flat_V": found.predicted_flat_V,
        "protocol_id": np.array(script.head_text("protocol_id") or PROTOCOL_ID),
        "grid_id": np.array(script.head_text("grid_id")),
        "bundle": np.array(script.head_text("bundle")),
        "serial": np.array(script.head_text("serial")),
    }
    if len(found.clouds_mm):
        arrays |= {"cloud_mm": found.clouds_mm, "cloud_index": found.columns["cloud_index"]}
    if found.maps is not None:
        arrays["map"] = found.maps
    with replacing(path) as stream:
        save_arrays(stream, arrays, compressed=True)


def write_parquet(path: Path, found: Table, script: Script) -> None:
    """Write a table as Parquet, a row a frame.

    A cloud stands in the row of its first frame, with its predictions; other rows have its number and no cloud. The
    reference stands in the file's own metadata, as NPY in hex: readers take some megabytes there, and no more.

    Raises:
        OSError: It cannot be written.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    columns: dict[str, Any] = {name: pa.array(values) for name, values in found.columns.items()}
    columns["voltages_V"] = _lists(pa, found.voltages_V)
    if found.maps is not None:
        columns["map"] = _lists(pa, found.maps.reshape(len(found.maps), -1))
    clouds, first = np.unique(found.columns["cloud_index"], return_index=True)
    row_of = {row: cloud for row, cloud in zip(first.tolist(), clouds.tolist(), strict=True) if cloud >= 0}
    for name, values, kind in (
        ("cloud_mm", found.clouds_mm, pa.float32()),
        ("predicted_V", found.predicted_V, pa.float64()),
        ("predicted_flat_V", found.predicted_flat_V, pa.float64()),
    ):
        rows = [values[row_of[row]].ravel() if row in row_of else None for row in range(len(found.voltages_V))]
        columns[name] = pa.array(rows, pa.list_(kind))
    told = {
        name: script.head_text(name) for name in ("serial", "configuration", "bundle", "skin", "protocol_id", "grid_id")
    }
    shapes = {
        "map_shape": () if found.maps is None else found.maps.shape[1:],
        "cloud_shape": found.clouds_mm.shape[1:] if len(found.clouds_mm) else (),
    }
    metadata = {**told, **{name: " ".join(map(str, shape)) for name, shape in shapes.items()}}
    metadata["reference_V"] = _hex(found.reference_V)
    table = pa.table(columns).replace_schema_metadata(metadata)
    with replacing(path) as stream:
        pq.write_table(table, stream, compression="zstd")


def _lists(pa: Any, values: npt.NDArray[Any]) -> Any:
    """Return the rows of an array as lists of one length."""
    return pa.FixedSizeListArray.from_arrays(pa.array(values.reshape(-1)), values.shape[1])


def _hex(values: npt.NDArray[Any]) -> str:
    from io import BytesIO

    stream = BytesIO()
    np.save(stream, values)
    return stream.getvalue().hex()


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
        raise RecordingError(f"{folder} already exists: name another folder, or remove it")
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
        self._normaliser = normaliser_of(script.hello, rows_of(script.hello))
        self._view = view_of(script.hello)

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
