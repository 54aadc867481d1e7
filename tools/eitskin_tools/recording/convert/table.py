"""A recording as arrays, a row a frame: what NPZ and Parquet hold.

::

    seq, device_us, read_ns, wall_ns, withheld, touched, gate_logit, solver, conditions     of every frame of the wire
    voltages_V (n, 104) V       cloud_index (n,) into the clouds, -1 for none, or where it is not known
    map (n, rows, columns)      where the recording has it
    reference_V (104,) V        cloud_mm (k, 3, rows, columns), with predicted_V and predicted_flat_V (k, 104)

Frames of the idle mode, of a few drives, are left out and counted.
"""

from bisect import bisect_right
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin.reference.normaliser import Normaliser
from eitskin_proto.errors import ProtocolError
from eitskin_proto.sensor.table import N_ROWS
from eitskin_proto.wire.frames import FrameView
from eitskin_proto.wire.scan_rows import ALL_DRIVES
from eitskin_tools.recording.bundles import reference_of
from eitskin_tools.recording.codec import unpack_map
from eitskin_tools.recording.layout import MAP, RecordingError
from eitskin_tools.recording.script import Script

MOST_FRAMES: Final = 2_000_000
"""In memory: nearly three hours at 200 frames/s, 1.7 GB."""

NUMBERS: Final = (1 << 32) - 1
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
    """(104,), flat; what the first frame is held against of which that is known."""
    later: npt.NDArray[np.bool_]
    """(n,) held against another reference, which was captured later."""
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
    normaliser, view = Normaliser(script.hello.volts_per_count), FrameView()
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
        if len(volts) >= MOST_FRAMES:
            raise RecordingError(
                f"{script.path} has more than {MOST_FRAMES} frames: choose a part with --from and --to"
            )
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
        raise RecordingError(f"{script.path} holds no whole frame in this part{script.ending}")
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
    """Return what ``eitskin evaluate --measured`` takes of a recording, and how many frames had a later reference.

    It takes frames that were fit to publish and were held against the first reference.

    Raises:
        RecordingError: There is none.
        SkinError: Its reference cannot be used.
    """
    found = table_of(script)
    fit = (found.columns["withheld"] == "") & ~found.later
    if len(found.clouds_mm):
        fit &= found.columns["cloud_index"] >= 0  # of others it is not known how the sheet lay
    if not fit.any():
        raise RecordingError(f"{script.path} holds no frame that was fit to publish{script.ending}")
    arrays: dict[str, npt.NDArray[Any]] = {
        "voltages_V": found.voltages_V[fit],
        "reference_V": found.reference_V,
        "kind": np.where(found.columns["touched"][fit], "touched", "untouched"),
    }
    if script.told("grid_id"):
        arrays["grid_id"] = np.array(script.told("grid_id"))
    if len(found.clouds_mm):
        arrays |= {"cloud_mm": found.clouds_mm, "cloud_index": found.columns["cloud_index"][fit]}
    return arrays, int(found.later.sum())


def _volts(given: list[npt.NDArray[np.float64] | None]) -> npt.NDArray[np.float64]:
    return np.array([np.full(N_ROWS, np.nan) if one is None else one for one in given]).reshape(-1, N_ROWS)


def _maps(script: Script, numbers: list[int], columns: dict[str, npt.NDArray[Any]]) -> npt.NDArray[np.float32] | None:
    """Return the map of every frame, as far as the recording has it.

    A map stands in the file once, under the number of the first published frame that had it. By ``seq`` alone it is not
    known: a device that starts anew counts from 0 again.
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
        at = bisect_right(first, number & NUMBERS)
        for known, values in found[max(at - 1, 0) : at + 1]:  # the frame that had it first may not have been received
            if known == sequence:
                maps[row] = values
                break
    return maps
