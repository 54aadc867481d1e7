"""A recording to calibrate from: a measured file (docs/evaluation.md) that says a little more.

::

    FILE.npz  reference_V (104,) or (208,) V      untouched; (208,) of a full scan also has what reciprocity tells
              reference_cloud_mm (3, rows, columns) mm    the scan of the sheet at that moment (optional)
              voltages_V (n, 104) or (n, 208) V   one moment each
              cloud_mm (k, 3, rows, columns), cloud_index (n,)   scans, and the scan of each moment, -1 for flat
              kind (n,) text                      "untouched" ones are used, others are not
              reference_frames, frames (n,)       how many frames each row is the mean of (default 1)
              protocol_id, grid_id, skin_digest   text, held against this release and the skin
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.errors import MismatchError, SkinError
from eitskin_proto.files.arrays import read_npz
from eitskin_proto.files.plain import quoted, stated
from eitskin_proto.sensor.ids import PROTOCOL_ID
from eitskin_proto.sensor.table import N_FULL_ROWS, N_ROWS
from eitskin_proto.skin.made_for import check_made_for
from eitskin_proto.skin.sheet_cloud import check_sheet
from eitskin_proto.skin.skin import Skin

Array = npt.NDArray[np.float64]

LARGEST_FILE: Final = 1 << 28
MOST_MOMENTS: Final = 40
"""Untouched moments: each is solved some ten times."""

UNTOUCHED: Final = "untouched"
SMALLEST_V: Final = 1e-9


class RecordingError(SkinError, ValueError):
    """A file that nothing can be calibrated from."""


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """What was read at one moment, and how the sheet lay."""

    name: str
    voltages_V: Array
    """(104,) or (208,)"""
    cloud_mm: Array | None
    """(3, rows, columns); None is flat."""
    frames: int = 1


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """A reference and untouched moments."""

    reference: Moment
    untouched: tuple[Moment, ...] = ()
    left_out: int = 0
    """Samples of other kinds."""


def load_recording(path: str | Path, skin: Skin) -> Recording:
    """Return the recording of a file.

    Args:
        path: The file.
        skin: Whose it must be.

    Raises:
        RecordingError: An array is missing, has another shape, is not finite, or contradicts another one.
        MismatchError: The file was made for another table or another skin.
        FileError: It is no intact file of plain arrays.
        OSError: It cannot be read.
    """
    arrays = read_npz(path, LARGEST_FILE)
    hint = "record it again with this skin, or name its own with --skin"
    if "protocol_id" in arrays and (found := _text(arrays, "protocol_id")) != PROTOCOL_ID:
        raise MismatchError(f"{path}: protocol_id", found=stated(found), expected=PROTOCOL_ID, hint=hint)
    if "skin_digest" in arrays:
        grid_id = _text(arrays, "grid_id") if "grid_id" in arrays else skin.grid_id
        check_made_for(str(path), skin, grid_id=grid_id, skin_digest=_text(arrays, "skin_digest"), hint=hint)
    try:
        return _recording(arrays, skin)
    except ValueError as error:
        raise RecordingError(f"{path}: {error}") from error


def _recording(arrays: dict[str, npt.NDArray[Any]], skin: Skin) -> Recording:
    reference = _rows(_numbers(arrays, "reference_V"), "reference_V")
    voltages = _numbers(arrays, "voltages_V") if "voltages_V" in arrays else np.zeros((0, N_ROWS))
    if voltages.ndim != 2:
        raise ValueError(f"voltages_V has shape {voltages.shape}, expected (n, {N_ROWS}) or (n, {N_FULL_ROWS})")
    n = len(voltages)
    scan = _cloud(_numbers(arrays, "reference_cloud_mm"), "reference_cloud_mm", skin) if _has_scan(arrays) else None
    clouds = _clouds(arrays, skin)
    index = _whole(arrays, "cloud_index", n, -1)
    if index.max(initial=-1) >= len(clouds) or index.min(initial=-1) < -1:
        raise ValueError(f"cloud_index names cloud {index.max()}, expected -1 to {len(clouds) - 1}")
    frames = _whole(arrays, "frames", n, 1)
    first = int(_whole(arrays, "reference_frames", 1, 1)[0])
    if frames.min(initial=1) < 1 or first < 1:
        raise ValueError("frames, reference_frames: expected at least 1 frame each")
    kinds = _kinds(arrays, n)
    untouched = []
    for number in [at for at, kind in enumerate(kinds) if kind == UNTOUCHED]:
        cloud = None if index[number] < 0 else clouds[index[number]]
        own = _rows(voltages[number], f"voltages_V[{number}]")
        untouched.append(Moment(f"sample {number}", own, cloud, int(frames[number])))
    if len(untouched) > MOST_MOMENTS:
        raise ValueError(f"has {len(untouched)} untouched moments, expected at most {MOST_MOMENTS}: leave some out")
    return Recording(Moment("reference", reference, scan, first), tuple(untouched), n - len(untouched))


def _numbers(arrays: dict[str, npt.NDArray[Any]], name: str) -> Array:
    if name not in arrays:
        raise ValueError(f"lacks {name}; found {', '.join(quoted(one) for one in list(arrays)[:12]) or 'no array'}")
    found = arrays[name]
    if found.dtype.kind not in "fiu":
        raise ValueError(f"{name} holds {found.dtype}, expected real numbers")
    if not np.isfinite(found).all():
        where = [int(one) for one in np.argwhere(~np.isfinite(found))[0]]
        raise ValueError(f"{name}{where} is {found[tuple(where)]}, expected finite numbers; leave such samples out")
    return np.asarray(found, dtype=np.float64)


def _rows(volts: Array, name: str) -> Array:
    if volts.shape not in ((N_ROWS,), (N_FULL_ROWS,)):
        raise ValueError(f"{name} has shape {volts.shape}, expected ({N_ROWS},), or ({N_FULL_ROWS},) of a full scan")
    small = np.flatnonzero(np.abs(volts) < SMALLEST_V)
    if small.size:
        raise ValueError(f"{name}: row {small[0]} is {volts[small[0]]:.3g} V: is its electrode connected?")
    return volts


def _has_scan(arrays: dict[str, npt.NDArray[Any]]) -> bool:
    return "reference_cloud_mm" in arrays


def _clouds(arrays: dict[str, npt.NDArray[Any]], skin: Skin) -> list[Array]:
    if "cloud_mm" not in arrays:
        return []
    found = _numbers(arrays, "cloud_mm")
    if found.ndim != 4:
        raise ValueError(
            f"cloud_mm has shape {found.shape}, expected (k, {', '.join(map(str, skin.grid.cloud_shape))})"
        )
    return [_cloud(one, f"cloud_mm[{number}]", skin) for number, one in enumerate(found)]


def _cloud(cloud: Array, name: str, skin: Skin) -> Array:
    try:
        return check_sheet(cloud, skin)[0]
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from error


def _whole(arrays: dict[str, npt.NDArray[Any]], name: str, n: int, default: int) -> npt.NDArray[np.int64]:
    if name not in arrays:
        return np.full(n, default, dtype=np.int64)
    found = arrays[name]
    if found.dtype.kind not in "iu" or found.shape not in ((n,), ()):
        raise ValueError(f"{name} is {found.dtype} of shape {found.shape}, expected whole numbers ({n},)")
    return np.array(np.broadcast_to(found, (n,)), dtype=np.int64)


def _kinds(arrays: dict[str, npt.NDArray[Any]], n: int) -> list[str]:
    if not n:
        return []
    if "kind" not in arrays:
        raise ValueError(f"lacks kind: expected {n} texts, {UNTOUCHED!r} for samples that are to be used")
    found = arrays["kind"]
    if found.dtype.kind != "U" or found.shape != (n,):
        raise ValueError(f"kind is {found.dtype} of shape {found.shape}, expected texts ({n},)")
    return [str(one) for one in found]


def _text(arrays: dict[str, npt.NDArray[Any]], name: str) -> str:
    found = arrays[name]
    if found.dtype.kind != "U" or found.size != 1:
        raise ValueError(f"{name} is {found.dtype} of shape {found.shape}, expected one text")
    return str(found.reshape(-1)[0])
