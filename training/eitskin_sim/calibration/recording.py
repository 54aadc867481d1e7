"""A recording to calibrate from: the reference of a measured file (docs/evaluation.md), and what came after it.

::

    FILE.npz  reference_V (104,) or (208,) V      untouched; (208,) of a full scan adds reciprocity
              reference_cloud_mm (3, rows, columns) mm    the scan of the sheet at that moment; without it, it lay flat
              reference_frames                    how many frames it is the mean of (default 1)
              bent_V (k, 104) or (k, 208) V       untouched and bent, a row a moment (optional)
              bent_cloud_mm (k, 3, rows, columns) mm    the scan of each
              press_V (p, 104) or (p, 208) V      in the reference's shape, pressed by the stamp (optional)
              press_xy_mm (p, 2) mm               where its middle was
              stamp_mm (1,) or (2,) mm            a disc's diameter, or length along x and width along y
              bent_frames, press_frames           how many frames each is the mean of (default 1)
              protocol_id, grid_id, skin_digest   text, checked against this release and the skin
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from eitskin_proto.errors import MismatchError, SkinError
from eitskin_proto.files.arrays import Array, Arrays, numbers, read_npz
from eitskin_proto.files.plain import quoted
from eitskin_proto.sensor.table import N_FULL_ROWS, N_ROWS, ROW_IN_FULL
from eitskin_proto.skin.cloud import align_cloud, check_cloud
from eitskin_proto.skin.made_for import check_arrays_made_for
from eitskin_proto.skin.sheet_cloud import check_sheet
from eitskin_proto.skin.skin import Skin

LARGEST_FILE: Final = 1 << 28
SMALLEST_V: Final = 1e-9
MAX_V: Final = 1e9
"""Nothing that was measured is larger, whatever its unit."""
STAMP_MM: Final = (3.0, 60.0)
MAX_MOMENTS: Final = 200
"""Of a kind: each costs a solve and a step."""


class RecordingError(SkinError, ValueError):
    """A file that nothing can be calibrated from."""


@dataclass(frozen=True, slots=True, eq=False)
class LaterReading:
    """Voltages after the reference: bent, with a scan, or pressed."""

    voltages_V: Array
    """(104,)"""
    frames: int = 1
    cloud_mm: Array | None = None
    """(3, rows, columns) the scan of a bent one."""
    xy_mm: Array | None = None
    """(2,) of a press."""
    stamp_mm: tuple[float, ...] | None = None
    """A disc's diameter, or length and width."""


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """The voltages of an untouched sheet, and the later moments."""

    reference_V: Array
    """(104,) or (208,)"""
    frames: int = 1
    """How many it is the mean of."""
    bents: tuple[LaterReading, ...] = ()
    presses: tuple[LaterReading, ...] = ()
    cloud_mm: Array | None = None
    """(3, rows, columns) the scan of the sheet when the reference was taken; None where it lay flat."""
    offset_V: float = 0.0
    """Offset of all rows that :mod:`eitskin_sim.calibration.line` found; 0 where a factor explains them as well."""


def load_recording(path: str | Path, skin: Skin) -> Recording:
    """Return the recording of a file.

    Args:
        path: The file.
        skin: The expected skin.

    Raises:
        RecordingError: An array is missing, has another shape, is not finite, or contradicts another one.
        MismatchError: The file was made for another table or another skin.
        FileError: It is no intact file of plain arrays.
        OSError: It cannot be read.
    """
    arrays = read_npz(path, LARGEST_FILE)
    try:
        hint = "record it again with this skin, or name its own with --skin"
        check_arrays_made_for(str(path), skin, arrays, hint)
        return _recording(arrays, skin)
    except MismatchError:
        raise
    except ValueError as error:
        raise RecordingError(f"{path}: {error}") from error


def _recording(arrays: Arrays, skin: Skin) -> Recording:
    reference = _rows(_numbers(arrays, "reference_V"), "reference_V")
    frames, cloud = _frames(arrays, "reference_frames"), None
    if "reference_cloud_mm" in arrays:
        cloud = _numbers(arrays, "reference_cloud_mm", skin.grid.cloud_shape)
        try:
            cloud, _ = check_sheet(cloud, skin)
        except ValueError as error:
            raise ValueError(f"reference_cloud_mm: {error}; leave it out if the sheet lay flat") from error
    return Recording(reference, frames, _bents(arrays, skin), _presses(arrays, skin), cloud)


def _frames(arrays: Arrays, name: str) -> int:
    frames = arrays.get(name, np.array(1))
    if frames.dtype.kind not in "iu" or frames.size != 1:
        raise ValueError(f"{name} is {frames.dtype} of shape {frames.shape}, expected one whole number from 1 on")
    found = int(frames.reshape(-1)[0])
    if found < 1:
        raise ValueError(f"{name} is {found}, expected one whole number from 1 on")
    return found


def _bents(arrays: Arrays, skin: Skin) -> tuple[LaterReading, ...]:
    if not _together(arrays, ("bent_V", "bent_cloud_mm")):
        return ()
    volts, frames = _moments(arrays, "bent_V"), _frames(arrays, "bent_frames")
    clouds = _numbers(arrays, "bent_cloud_mm", (len(volts), *skin.grid.cloud_shape))
    for number, cloud in enumerate(clouds):
        try:
            align_cloud(check_cloud(cloud, skin.grid), skin.grid)
        except ValueError as error:
            raise ValueError(f"bent_cloud_mm[{number}]: {error}") from error
    return tuple(LaterReading(one, frames, cloud) for one, cloud in zip(volts, clouds, strict=True))


def _presses(arrays: Arrays, skin: Skin) -> tuple[LaterReading, ...]:
    if not _together(arrays, ("press_V", "press_xy_mm", "stamp_mm")):
        return ()
    volts, frames = _moments(arrays, "press_V"), _frames(arrays, "press_frames")
    places, stamp = _numbers(arrays, "press_xy_mm", (len(volts), 2)), _numbers(arrays, "stamp_mm").reshape(-1)
    length, width = skin.outline.size_mm
    for number, (x, y) in enumerate(places):
        if not (0.0 <= x <= length and 0.0 <= y <= width):
            raise ValueError(
                f"press_xy_mm[{number}] is ({x:g}, {y:g}), expected a place on the sheet, from (0, 0) to "
                f"({length:g}, {width:g}) mm"
            )
    if len(stamp) not in (1, 2) or not ((stamp >= STAMP_MM[0]) & (stamp <= STAMP_MM[1])).all():
        raise ValueError(
            f"stamp_mm is {', '.join(f'{one:g}' for one in stamp[:4])}, expected a disc's diameter, or a length and a "
            f"width, from {STAMP_MM[0]:g} to {STAMP_MM[1]:g} mm"
        )
    size = tuple(float(one) for one in stamp)
    return tuple(LaterReading(one, frames, None, place, size) for one, place in zip(volts, places, strict=True))


def _together(arrays: Arrays, names: tuple[str, ...]) -> bool:
    """Return whether all of some arrays are there.

    Raises:
        ValueError: Some are, and others are not.
    """
    there = [name for name in names if name in arrays]
    if there and len(there) < len(names):
        missing = next(name for name in names if name not in arrays)
        raise ValueError(f"has {there[0]} without {missing}; expected {', '.join(names)}, or none of them")
    return bool(there)


def _moments(arrays: Arrays, name: str) -> Array:
    """Return (n, 104) V."""
    volts = _numbers(arrays, name)
    if volts.ndim != 2 or volts.shape[1] not in (N_ROWS, N_FULL_ROWS) or not 1 <= len(volts) <= MAX_MOMENTS:
        raise ValueError(
            f"{name} has shape {volts.shape}, expected (n, {N_ROWS}) or (n, {N_FULL_ROWS}), n from 1 to {MAX_MOMENTS}"
        )
    _check_size(volts, name)
    return volts[:, ROW_IN_FULL] if volts.shape[1] == N_FULL_ROWS else volts


def _numbers(arrays: Arrays, name: str, shape: tuple[int, ...] | None = None) -> Array:
    if name not in arrays:
        raise ValueError(f"lacks {name}; found {', '.join(quoted(one) for one in list(arrays)[:12]) or 'no array'}")
    return numbers(arrays, name, shape)


def _rows(volts: Array, name: str) -> Array:
    if volts.shape not in ((N_ROWS,), (N_FULL_ROWS,)):
        raise ValueError(f"{name} has shape {volts.shape}, expected ({N_ROWS},), or ({N_FULL_ROWS},) of a full scan")
    small = np.flatnonzero(np.abs(volts) < SMALLEST_V)
    if small.size:
        raise ValueError(f"{name}: row {small[0]} is {volts[small[0]]:.3g} V: is its electrode connected?")
    _check_size(volts, name)
    return volts


def _check_size(volts: Array, name: str) -> None:
    largest = float(np.abs(volts).max())
    if largest > MAX_V:
        raise ValueError(f"{name} goes up to {largest:.3g} V, expected at most {MAX_V:g}: no front end reaches that")


def of_table(values: Array) -> Array:
    """Return the (104, ...) of the table, of (104, ...) or of (208, ...)."""
    return values[ROW_IN_FULL] if len(values) == N_FULL_ROWS else values


def noise_V(skin: Skin, volts: Array, level: float, frames: int) -> Array:
    """Return (rows,) standard deviations of what noise does to the mean of some frames."""
    size = np.sqrt(np.mean(volts**2)) * np.ones(len(volts)) if skin.front_end.noise == "N3" else np.abs(volts)
    return np.asarray(level * size / np.sqrt(frames))
