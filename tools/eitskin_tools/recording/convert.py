"""Converts recordings for other programs: NPZ, Parquet, CSV and rosbag2.

NPZ and Parquet have a row a frame ::

    seq, device_us, read_ns, wall_ns, withheld, touched, gate_logit, solver, conditions     of every frame of the wire
    voltages_V (n, 104) V       cloud_index (n,) into the clouds, -1 for none or unknown
    map (n, rows, columns)      where the recording has it
    reference_V (104,) V        cloud_mm (k, 3, rows, columns), with predicted_V and predicted_flat_V (k, 104)
    touches                     computed by the bundle; fields as in :class:`eitskin.Touch`, NaN for None

Parquet has a list of touches in each row. NPZ has an array a field, ``touch_id`` (m,), ``touch_centre_mm`` (m, 2), ...,
and ``touch_row`` (m,), the row of each touch. Frames of the idle mode, of a few drives, are left out and counted.

CSV has a line a touch, with the scalar columns of its frame and a column for each number of the touch. A frame without
touches has one line, on which these are empty.

rosbag2 is written without ROS, in standard messages that every ROS 2 machine plays:

===================  =======================  =======================================================
/eitskin/touches     sensor_msgs/PointCloud2  a point a touch, computed by the bundle, each frame
/eitskin/voltages    sensor_msgs/Image        64FC1, one row of 104 V a frame
/eitskin/map         sensor_msgs/Image        32FC1, where the recording has maps; row 0 is y = 0
/eitskin/surface     sensor_msgs/PointCloud2  x y z in metres, when a cloud came into use
/eitskin/state       std_msgs/String          JSON, as in the recording
===================  =======================  =======================================================
"""

import csv
import math
import shutil
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO, TextIOWrapper
from operator import attrgetter
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt

from eitskin.messaging.frame import Frame
from eitskin.messaging.streams.measured import CloudInUse
from eitskin.reference.normaliser import normaliser_of, rows_of
from eitskin.touches.touch import Touch
from eitskin_proto.errors import ProtocolError
from eitskin_proto.files.arrays import save_arrays
from eitskin_proto.files.writing import replacing
from eitskin_proto.sensor.ids import PROTOCOL_ID
from eitskin_proto.sensor.table import N_ROWS
from eitskin_proto.wire.scan_rows import ALL_DRIVES
from eitskin_proto.wire.volts import view_of
from eitskin_tools.recording.codec import unpack_map
from eitskin_tools.recording.frames import RecordedFrames
from eitskin_tools.recording.layout import CLOUD, MAP, STATE, RecordingError
from eitskin_tools.recording.reader import Entry
from eitskin_tools.recording.script import Script, Step, reference_of

MAX_FRAMES: Final = 2_000_000
"""In memory: nearly three hours at 200 frames/s, 1.7 GB."""

MAX_MAPS: Final = 200_000
"""In memory: a gigabyte."""

NUMBER_MASK: Final = (1 << 32) - 1
"""Of published frames are kept beside maps modulo one more."""

NOT_COMPUTED: Final = "not computed"
"""Why a frame without a computed map is not used, where maps are computed."""

COLUMNS: Final[dict[str, Any]] = {
    "seq": np.int64, "device_us": np.int64, "read_ns": np.int64, "wall_ns": np.int64, "withheld": np.str_,
    "touched": np.bool_, "gate_logit": np.float64, "solver": np.str_, "map_seq": np.int64, "conditions": np.int64,
    "cloud_index": np.int64,
}  # fmt: skip
"""A value a frame."""

TOUCH: Final = np.dtype([
    ("id", "<u4"), ("parent", "<u4"), ("age_s", "<f4"), ("centre_mm", "<f4", 2), ("axes_mm", "<f4", 2),
    ("angle_rad", "<f4"), ("area_mm2", "<f4"), ("peak", "<f4"), ("strength", "<f4"), ("confidence", "<f4"),
    ("place_mm", "<f4", 3), ("normal", "<f4", 3), ("surface_mm2", "<f4"), ("error_mm", "<f4", 2), ("amplitude", "<f4"),
    ("log_likelihood_ratio", "<f4"), ("sign", "<f4"), ("velocity_mm_s", "<f4", 2),
])  # fmt: skip
"""The fields of :class:`eitskin.Touch`, in their order."""

FIELDS_OF: Final = attrgetter(*(TOUCH.names or ()))


def touch_array(touches: tuple[Touch, ...]) -> npt.NDArray[np.void]:
    """Return touches as ``TOUCH`` (n,), with NaN for what is None."""
    rows = [tuple(np.nan if value is None else value for value in FIELDS_OF(touch)) for touch in touches]
    return np.array(rows, dtype=TOUCH)


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
    touches: npt.NDArray[np.void] | None
    """(m,) of ``TOUCH``; None where they were not computed."""
    touch_row: npt.NDArray[np.int64]
    """(m,) the frame of each touch."""
    left_out: int
    """Frames of a few drives, or malformed ones."""

    def touches_by_row(self) -> list[Any]:
        """Return the touches of each row as records, whose attributes are the fields of ``TOUCH``."""
        touches = touch_array(()) if self.touches is None else self.touches
        ends = np.searchsorted(self.touch_row, np.arange(1, len(self.voltages_V)))
        return np.split(touches.view(np.recarray), ends)


def _computed(
    script: Script, from_s: float | None, to_s: float | None, frames: RecordedFrames | None
) -> Iterator[tuple[Step, Frame | None]]:
    """Yield the frames of a part, each with its touches where there is something that computes them."""
    if frames is not None:
        return frames.part(from_s, to_s, frames.watch())
    return ((step, None) for step in script.part(from_s, to_s))


def table_of(
    script: Script,
    from_s: float | None = None,
    to_s: float | None = None,
    frames: RecordedFrames | None = None,
    *,
    compute_maps: bool = False,
) -> Table:
    """Return a recording as arrays.

    Args:
        script: The recording.
        from_s: Begin so long after the first frame.
        to_s: End so long after it.
        frames: Computes the touches; None for none.
        compute_maps: Have ``frames`` compute the maps too, instead of taking those that the recording has.

    Raises:
        RecordingError: It holds no whole frame, or more than fit into memory.
        SkinError: Its reference cannot be used.
    """
    reference: bytes | None = None
    first = held = ""
    normaliser, view = normaliser_of(script.hello, rows_of(script.hello)), view_of(script.hello)
    rows: dict[str, list[Any]] = {name: [] for name in COLUMNS}
    volts: list[npt.NDArray[np.float64]] = []
    numbers, later, touch_row = list[int](), list[bool](), list[int]()
    touches, clouds, maps = [touch_array(())], list[Any](), list[npt.NDArray[np.float32]]()
    index_of = dict[int, int]()
    left_out, cloud = 0, -1
    for step, computed in _computed(script, from_s, to_s, frames):
        frame = step.frame
        if (new := step.cloud) is not None and new.revision not in index_of:
            index_of[new.revision] = len(clouds)
            clouds.append(new)
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
        if compute_maps and frames is not None:
            if len(maps) >= MAX_MAPS:
                raise RecordingError(f"{script.path} has more than {MAX_MAPS} maps: choose a part with --from and --to")
            maps.append(np.full(frames.shape, np.nan, dtype=np.float32) if computed is None else computed.map)
        if computed is not None and computed.touches:
            touches.append(touch_array(computed.touches))
            touch_row += [len(volts)] * len(computed.touches)
        normaliser.load(view.counts)
        volts.append(normaliser.voltages().copy())
        later.append(held != first)
        unknown = NOT_COMPUTED if compute_maps and computed is None else ""
        numbers.append(-1 if frame.frame is None else frame.frame)
        found = {
            "seq": frame.seq, "device_us": frame.device_us or 0, "read_ns": frame.read_ns, "wall_ns": step.log_ns,
            "withheld": frame.withheld or unknown, "touched": frame.touched, "gate_logit": frame.gate_logit,
            "solver": frame.solver, "map_seq": -1 if frame.map_seq is None else frame.map_seq,
            "conditions": frame.conditions, "cloud_index": cloud if step.known else -1,
        }  # fmt: skip
        for name, value in found.items():
            rows[name].append(value)
    if not volts:
        raise RecordingError(f"{script.path} has no complete frame in this part{script.ending}")
    columns = {name: np.array(rows[name], dtype=kind) for name, kind in COLUMNS.items()}
    return Table(
        columns,
        np.array(volts),
        reference_of(script, script.reference() if reference is None else reference).flat().voltages_V,
        np.array(later),
        np.array([one.cloud for one in clouds], dtype=np.float32),
        _volts([one.predicted for one in clouds]),
        _volts([one.predicted_flat for one in clouds]),
        np.array(maps) if compute_maps else _maps(script, numbers, columns),
        None if frames is None else np.concatenate(touches),
        np.array(touch_row, dtype=np.int64),
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
        sequence, values = unpack_map(entry.data)
        if not found or values.shape == found[0][1].shape:
            first.append(entry.sequence)
            found.append((sequence, values))
        if max(len(found), len(numbers)) > MAX_MAPS:
            raise RecordingError(f"{script.path} has more than {MAX_MAPS} maps: choose a part with --from and --to")
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
    if found.touches is not None:
        arrays |= {"touch_row": found.touch_row, **{f"touch_{name}": found.touches[name] for name in TOUCH.names or ()}}
    with replacing(path) as stream:
        save_arrays(stream, arrays, compressed=True)


def write_parquet(path: Path, found: Table, script: Script) -> None:
    """Write a table as Parquet, a row a frame.

    A cloud stands in the row of its first frame, with its predictions; other rows have its number and no cloud. The
    file's own metadata has the reference, as NPY in hex.

    Raises:
        OSError: It cannot be written.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    columns: dict[str, Any] = {name: pa.array(values) for name, values in found.columns.items()}
    columns["voltages_V"] = _lists(pa, found.voltages_V)
    if found.maps is not None:
        columns["map"] = _lists(pa, found.maps.reshape(len(found.maps), -1))
    if found.touches is not None:
        fields = [
            pa.array(values) if values.ndim == 1 else _lists(pa, values)
            for values in (np.ascontiguousarray(found.touches[name]) for name in TOUCH.names or ())
        ]
        begins = np.searchsorted(found.touch_row, np.arange(len(found.voltages_V) + 1)).astype(np.int32)
        structs = pa.StructArray.from_arrays(fields, names=list(TOUCH.names or ()))
        columns["touches"] = pa.ListArray.from_arrays(pa.array(begins), structs)
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


def write_csv(path: Path, found: Table, script: Script) -> None:
    """Write the touches of a table as CSV, in the order of the frames.

    Raises:
        OSError: It cannot be written.
    """
    touches = touch_array(()) if found.touches is None else found.touches
    counts = np.bincount(found.touch_row, minlength=len(found.voltages_V))
    rows = np.repeat(np.arange(len(counts)), np.maximum(counts, 1))
    columns = {name: values[rows].astype(str) for name, values in found.columns.items()}
    for name in TOUCH.names or ():
        numbers = touches[name].reshape(len(touches), -1)
        ends = ("_long", "_short") if name == "axes_mm" else ("_x", "_y", "_z")
        for k in range(numbers.shape[1]):
            column = columns[name + ends[k] if numbers.shape[1] > 1 else name] = np.full(len(rows), "", dtype="<U16")
            column[counts[rows] > 0] = numbers[:, k].astype(str)
    with replacing(path) as stream:
        text = TextIOWrapper(stream, encoding="utf-8", newline="")
        csv.writer(text, lineterminator="\n").writerows([columns, *zip(*columns.values(), strict=True)])
        text.detach()  # written, and left open to be put on disk


def _lists(pa: Any, values: npt.NDArray[Any]) -> Any:
    """Return the rows of an array as lists of one length."""
    return pa.FixedSizeListArray.from_arrays(pa.array(values.reshape(-1)), values.shape[1])


def _hex(values: npt.NDArray[Any]) -> str:
    stream = BytesIO()
    np.save(stream, values)
    return stream.getvalue().hex()


FRAME_ID: Final = "skin"

FLOAT32, UINT32 = 7, 6
"""``sensor_msgs/PointField``"""

POINT: Final = ("x", "y", "z", "nx", "ny", "nz", "area", "strength", "id", "confidence", "peak", "error_x", "error_y",
                "amplitude", "log_likelihood_ratio", "sign", "velocity_x", "velocity_y")  # fmt: skip
"""Fields of a touch, in metres, as the node of tools/ros2 publishes them: floats, but for ``id``."""

KINDS: Final = {
    "touches": "sensor_msgs/msg/PointCloud2", "voltages": "sensor_msgs/msg/Image", "map": "sensor_msgs/msg/Image",
    "surface": "sensor_msgs/msg/PointCloud2", "state": "std_msgs/msg/String",
}  # fmt: skip
"""Message of each topic below ``/eitskin/``."""

VERSIONS: Final = {8: ("ROS2_HUMBLE", "SQLITE3"), 9: ("ROS2_JAZZY", "MCAP")}
"""Of rosbag2's metadata: the release that reads it, and the storage that comes with that."""


def write_rosbag(
    folder: Path,
    script: Script,
    from_s: float | None = None,
    to_s: float | None = None,
    *,
    frames: RecordedFrames | None = None,
    version: Literal[8, 9] = 9,
) -> int:
    """Write a recording as a folder of rosbag2, and return how many messages it has.

    Args:
        folder: It must not be there.
        script: The recording.
        from_s: Begin so long after the first frame.
        to_s: End so long after it.
        frames: Computes the touches; None for none.
        version: Of rosbag2's metadata, one of ``VERSIONS``.

    Raises:
        RecordingError: The folder is there.
        SkinError: The recording cannot be used with the bundle.
        OSError: It cannot be written.
    """
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    if folder.exists():
        raise RecordingError(f"{folder} already exists: name another folder, or remove it")
    release, storage = VERSIONS[version]
    store = get_typestore(Stores[release])
    messages, count = _Messages(store, script), 0
    try:
        with Writer(folder, version=version, storage_plugin=StoragePlugin[storage]) as bag:
            to = {name: bag.add_connection(f"/eitskin/{name}", kind, typestore=store) for name, kind in KINDS.items()}
            for name, at_ns, message in messages.of(script, from_s, to_s, frames):
                bag.write(to[name], at_ns, store.serialize_cdr(message, KINDS[name]))
                count += 1
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    return count


class _Messages:
    """Makes ROS messages of a recording's."""

    def __init__(self, store: Any, script: Script) -> None:
        self._types = store.types
        self._normaliser = normaliser_of(script.hello, rows_of(script.hello))
        self._view = view_of(script.hello)

    def of(
        self, script: Script, from_s: float | None, to_s: float | None, frames: RecordedFrames | None
    ) -> Iterator[tuple[str, int, Any]]:
        """Yield the name, the time and the message of all that a part has."""
        for step, computed in _computed(script, from_s, to_s, frames):
            at_ns = step.log_ns
            if step.cloud is not None:
                yield "surface", at_ns, self._surface(step.cloud, math.nan, at_ns)
            if (values := self._voltages(step)) is not None:
                yield "voltages", at_ns, self._image(values, "64FC1", at_ns)
            if computed is not None:
                yield "touches", at_ns, self._touches(computed.touches, at_ns)
        begin_ns = script.first_ns + round((from_s or 0.0) * 1e9)
        end_ns = script.last_ns if to_s is None else script.first_ns + round(to_s * 1e9)
        held: Entry | None = None  # the state that holds at the beginning of the part
        cloud: CloudInUse | None = None
        for entry in script.recording.entries({MAP.topic, STATE.topic, CLOUD.topic}, to_ns=end_ns):
            if entry.topic == CLOUD.topic:
                cloud = CloudInUse.of(entry.data)
                continue
            if entry.log_ns < begin_ns:
                held = entry if entry.topic == STATE.topic else held
                continue
            if entry.log_ns > end_ns:
                continue
            if held is not None:
                yield "state", begin_ns, self._text(held.data)
                held = None
            if entry.topic == MAP.topic:
                image = unpack_map(entry.data)[1]
                yield "map", entry.log_ns, self._image(image, "32FC1", entry.log_ns)
                if cloud is not None and cloud.cloud.shape[1:] == image.shape:
                    yield "surface", entry.log_ns, self._surface(cloud, image, entry.log_ns)
            else:
                yield "state", entry.log_ns, self._text(entry.data)

    def _header(self, wall_ns: int) -> Any:
        if wall_ns >= 10**9 << 31:
            raise RecordingError("the recording has messages from after 2038, which ROS has no time for; choose --to")
        stamp = self._types["builtin_interfaces/msg/Time"](sec=wall_ns // 10**9, nanosec=wall_ns % 10**9)
        return self._types["std_msgs/msg/Header"](stamp=stamp, frame_id=FRAME_ID)

    def _image(self, values: npt.NDArray[Any], encoding: str, wall_ns: int) -> Any:
        rows, columns = values.shape
        return self._types["sensor_msgs/msg/Image"](
            header=self._header(wall_ns), height=rows, width=columns, encoding=encoding, is_bigendian=0,
            step=columns * values.itemsize, data=np.frombuffer(values.tobytes(), dtype=np.uint8),
        )  # fmt: skip

    def _voltages(self, step: Step) -> npt.NDArray[np.float64] | None:
        """Return (1, 104) voltages of a whole scan; None for any other frame."""
        try:
            self._view.load(step.frame.payload)
        except ProtocolError:
            return None
        if self._view.drives != ALL_DRIVES:
            return None
        self._normaliser.load(self._view.counts)
        return self._normaliser.voltages()[None]

    def _touches(self, touches: tuple[Touch, ...], wall_ns: int) -> Any:
        found = touch_array(touches)
        points = np.zeros(len(found), dtype=[(name, "<u4" if name == "id" else "<f4") for name in POINT])
        for k in range(3):
            points[POINT[k]], points[POINT[3 + k]] = 1e-3 * found["place_mm"][:, k], found["normal"][:, k]
        points["area"], points["error_x"], points["error_y"] = 1e-6 * found["area_mm2"], *(1e-3 * found["error_mm"].T)
        points["velocity_x"], points["velocity_y"] = 1e-3 * found["velocity_mm_s"].T
        for name in ("strength", "id", "confidence", "peak", "amplitude", "log_likelihood_ratio", "sign"):
            points[name] = found[name]
        return self._points(points, POINT, wall_ns)

    def _surface(self, cloud: CloudInUse, values: npt.NDArray[np.float32] | float, wall_ns: int) -> Any:
        """Return the places of all pixels with their values in the map, NaN without one."""
        points = np.empty((cloud.cloud[0].size, 4), dtype="<f4")
        points[:, :3], points[:, 3] = cloud.cloud.reshape(3, -1).T * np.float32(1e-3), np.ravel(values)
        return self._points(points, ("x", "y", "z", "value"), wall_ns)

    def _points(self, points: npt.NDArray[Any], names: Any, wall_ns: int) -> Any:
        """Return points of 4-byte fields with these names."""
        field, size = self._types["sensor_msgs/msg/PointField"], 4 * len(names)
        fields = [
            field(name=name, offset=4 * at, datatype=UINT32 if name == "id" else FLOAT32, count=1)
            for at, name in enumerate(names)
        ]
        return self._types["sensor_msgs/msg/PointCloud2"](
            header=self._header(wall_ns), height=1, width=len(points), fields=fields, is_bigendian=False,
            point_step=size, row_step=size * len(points), data=np.frombuffer(points.tobytes(), dtype=np.uint8),
            is_dense=True,
        )  # fmt: skip

    def _text(self, data: bytes) -> Any:
        return self._types["std_msgs/msg/String"](data=data.decode("utf-8", "replace"))
