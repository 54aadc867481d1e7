"""A recording to calibrate from: the reference of a measured file (docs/evaluation.md).

::

    FILE.npz  reference_V (104,) or (208,) V      flat and untouched; (208,) of a full scan has what reciprocity tells
              reference_frames                    how many frames it is the mean of (default 1)
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
from eitskin_proto.skin.skin import Skin

Array = npt.NDArray[np.float64]

LARGEST_FILE: Final = 1 << 28
SMALLEST_V: Final = 1e-9


class RecordingError(SkinError, ValueError):
    """A file that nothing can be calibrated from."""


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """What a flat, untouched sheet read."""

    reference_V: Array
    """(104,) or (208,)"""
    frames: int = 1
    """How many it is the mean of."""


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
    if "grid_id" in arrays:
        digest = _text(arrays, "skin_digest") if "skin_digest" in arrays else None
        check_made_for(str(path), skin, grid_id=_text(arrays, "grid_id"), skin_digest=digest, hint=hint)
    try:
        return _recording(arrays)
    except ValueError as error:
        raise RecordingError(f"{path}: {error}") from error


def _recording(arrays: dict[str, npt.NDArray[Any]]) -> Recording:
    if "reference_cloud_mm" in arrays:
        raise ValueError("has reference_cloud_mm: the sheet did not lie flat; calibrate from a reference taken flat")
    reference = _rows(_numbers(arrays, "reference_V"), "reference_V")
    frames = arrays.get("reference_frames", np.array(1))
    if frames.dtype.kind not in "iu" or frames.size != 1 or int(frames.reshape(-1)[0]) < 1:
        raise ValueError(f"reference_frames is {frames.dtype} of shape {frames.shape}, expected one number from 1 on")
    return Recording(reference, int(frames.reshape(-1)[0]))


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


def _text(arrays: dict[str, npt.NDArray[Any]], name: str) -> str:
    found = arrays[name]
    if found.dtype.kind != "U" or found.size != 1:
        raise ValueError(f"{name} is {found.dtype} of shape {found.shape}, expected one text")
    return str(found.reshape(-1)[0])
