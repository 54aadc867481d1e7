"""Reads a file of measurements: voltages, the reference, scans, and the truth where it is known.

::

    MEASURED.npz  reference_V (104,) V         untouched and flat, or as its scan shows
                  reference_cloud_mm (3, 30, 45) mm   the scan of the sheet when the reference was taken (optional)
                  voltages_V (n, 104) V        one sample each, in the order they were measured
                  cloud_mm (k, 3, 30, 45) mm   scans, in any pose
                  cloud_index (n,)             the scan of each sample, -1 for none; without scans both are left out
                  truth (n, 30, 45)            touched share of every pixel (optional)
                  kind (n,) text               "single", "untouched", anything; figures are by it (optional)
                  touch_kind text              "lower" or "raise": which way touches change conductance (optional)
                  protocol_id, grid_id, skin_digest text   checked against this release and its sheet (optional)

A recording, ``FILE.mcap``, is read too: its first reference, its frames that were published with that, its clouds. So
are the same arrays in a ``.mat`` file of MATLAB, and a ``.csv`` file of numbers alone: a line a sample, the first of
them the reference.

Rows are those of :data:`eitskin_proto.sensor.table.TABLE`; of 208 the reciprocals are averaged. Other arrays are left
alone and named in the report.
"""

import codecs
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, cast

import numpy as np
import numpy.typing as npt

from eitskin_proto.errors import MismatchError, SkinError
from eitskin_proto.files.arrays import Array, Arrays, numbers, read_npz, text
from eitskin_proto.files.plain import quoted
from eitskin_proto.files.reading import opened
from eitskin_proto.sensor.normalise import weak_rows
from eitskin_proto.sensor.table import N_FULL_ROWS, N_ROWS, RECIPROCAL_IN_FULL, ROW_IN_FULL
from eitskin_proto.skin.cloud import align_cloud, check_cloud
from eitskin_proto.skin.made_for import check_arrays_made_for
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_proto.skin.touch_kind import EARLIER_WORDS, TouchKind

TOUCH_KINDS: Final[tuple[TouchKind, ...]] = ("lower", "raise")
"""The kinds of touch."""

LARGEST_FILE: Final = 1 << 30
"""Bytes: 80,000 samples with their truth."""

UNTOUCHED: Final = "untouched"
"""The kind of samples that nothing touches."""

ROUNDING: Final = 1e-6
"""A share may be this far outside 0 to 1."""

ARRAYS: Final = (
    "reference_V", "reference_cloud_mm", "voltages_V", "cloud_mm", "cloud_index", "truth", "kind", "touch_kind",
    "protocol_id", "grid_id", "skin_digest",
)  # fmt: skip
"""Arrays that are read."""


class MeasuredFileError(SkinError, ValueError):
    """A file that holds no measured samples that can be judged."""


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """Measured samples, checked."""

    reference_V: Array
    """(104,)"""
    reference_cloud_mm: Array | None
    """(3, 30, 45)"""
    voltages_V: Array
    """(n, 104)"""
    clouds_mm: Array
    """(k, 3, 30, 45)"""
    cloud_index: npt.NDArray[np.intp]
    """(n,) from -1, no scan, to k - 1."""
    truth: Array | None
    """(n, 30, 45) touched shares."""
    kinds: tuple[str, ...]
    """Of every sample; where the file has none, by the truth, or ``unknown``."""
    skin: Skin
    touch_kind: TouchKind | None
    """None where the file does not say."""
    ignored: tuple[str, ...]
    """Names of arrays that are none of a measured file's."""
    ending: str = ""
    """What is wrong with the end or the middle of a recording, as a clause."""


def load_measured(path: str | Path, skin: Skin = PAPER) -> Measured:
    """Return the samples of a measured file.

    Args:
        path: The file.
        skin: Whose samples they are; maps and clouds have its shapes.

    Raises:
        MeasuredFileError: An array is missing, has another shape, is not finite, or contradicts another one.
        MismatchError: The file was made for another table or grid.
        FileError: It is no intact file of plain arrays.
        OSError: It cannot be read.
    """
    ending, suffix = "", Path(path).suffix.lower()
    if suffix == ".mcap":
        arrays, ending = _of_recording(path)
    elif suffix in (".mat", ".csv", ".txt"):
        arrays = _of_matlab(path) if suffix == ".mat" else _of_text(path)
    else:
        arrays = read_npz(path, LARGEST_FILE)
    try:
        hint = "write it again with the rows and the grid that 'eitskin --version' names"
        check_arrays_made_for(str(path), skin, arrays, hint)
        return replace(_measured(arrays, skin), ending=ending)
    except MismatchError:
        raise
    except ValueError as error:
        raise MeasuredFileError(f"{path}: {error}") from error


def _of_recording(path: str | Path) -> tuple[Arrays, str]:
    """Return the samples of a recording, no truth but what the gate said then, and what is wrong with its end."""
    from eitskin_tools.command_line.needs import require

    require("a recording", ("mcap",))
    from eitskin_tools.recording.convert import measured_arrays
    from eitskin_tools.recording.script import Script

    script = Script(path)
    arrays, later = measured_arrays(script)
    return arrays, script.ending + (f"; {later} frames with a later reference are left out" if later else "")


def _of_matlab(path: str | Path) -> Arrays:
    """Return the arrays of a file of MATLAB; texts as such, and row vectors without their first dimension.

    Raises:
        MeasuredFileError: It is none of version 7 or older.
    """
    from scipy.io import loadmat

    with opened(path, LARGEST_FILE) as stream:
        try:
            found = loadmat(cast("Any", stream))
        except Exception as error:  # scipy's readers raise whatever a damaged file leads them to
            raise MeasuredFileError(f"{path}: no file of MATLAB up to version 7; save it with -v7") from error
    arrays = {name: value for name, value in found.items() if isinstance(value, np.ndarray)}
    for name in ("reference_V", "cloud_index"):
        if name in arrays:
            arrays[name] = arrays[name].reshape(-1)
    if "kind" in arrays:
        arrays["kind"] = np.array([str(np.squeeze(one)).strip() for one in arrays["kind"].reshape(-1)])
    if "touch_kind" in arrays:
        arrays["touch_kind"] = np.array(str(np.squeeze(arrays["touch_kind"])))
    return arrays


def _of_text(path: str | Path) -> Arrays:
    """Return the samples of a text file of numbers, behind a line of names or none.

    Raises:
        MeasuredFileError: A line is something else, or there are fewer than two.
    """
    with opened(path, LARGEST_FILE) as stream:
        data = stream.read()
    encoding = "utf-16" if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) else "utf-8-sig"
    lines = [line for line in data.decode(encoding, "replace").splitlines() if line.strip()]
    mark = next((mark for mark in (";", "\t", ",") if lines and mark in lines[-1]), None)
    rows: list[list[float]] = []
    for number, line in enumerate(lines, 1):
        words = (line if mark == "," else line.replace(",", ".")).strip().removesuffix(mark or " ").split(mark)
        try:
            rows.append([float(word) for word in words])
        except ValueError:
            if number == 1:
                continue  # names of the columns
            raise MeasuredFileError(f"{path}: line {number} holds {line[:40]!r}, expected numbers") from None
    lengths = sorted({len(row) for row in rows})
    if len(rows) < 2 or lengths not in ([N_ROWS], [N_FULL_ROWS]):
        raise MeasuredFileError(
            f"{path}: found {len(rows)} lines of {' or '.join(map(str, lengths)) or 'no'} numbers, expected 2 or more, "
            f"each of {N_ROWS} or {N_FULL_ROWS} V, of which the first is the reference"
        )
    return {"reference_V": np.array(rows[0]), "voltages_V": np.array(rows[1:])}


def _measured(arrays: Arrays, skin: Skin) -> Measured:
    for name in ("reference_V", "voltages_V"):
        if name not in arrays:
            there = ", ".join(quoted(name) for name in list(arrays)[:12]) or "no array"
            raise ValueError(f"lacks {name}; found {there}; a measured file has {', '.join(ARRAYS[:5])}")
    reference = _voltages(arrays, "reference_V", (N_ROWS,))
    weak_rows(reference)  # refuses a reference that cannot be used
    voltages = _voltages(arrays, "voltages_V", (None, N_ROWS))
    n = len(voltages)
    if not n:
        raise ValueError("voltages_V holds no sample; expected at least one")
    clouds, index = _clouds(arrays, n, skin)
    at_reference = (
        numbers(arrays, "reference_cloud_mm", skin.grid.cloud_shape) if "reference_cloud_mm" in arrays else None
    )
    if at_reference is not None:
        _check_cloud(at_reference, "reference_cloud_mm", skin)
    truth = _truth(arrays, n, skin) if "truth" in arrays else None
    return Measured(
        reference_V=reference,
        reference_cloud_mm=at_reference,
        voltages_V=voltages,
        clouds_mm=clouds,
        cloud_index=index,
        truth=truth,
        kinds=_kinds(arrays, n, truth),
        skin=skin,
        touch_kind=_touch_kind(arrays),
        ignored=tuple(sorted(set(arrays) - set(ARRAYS))),
    )


def _voltages(arrays: Arrays, name: str, shape: tuple[int | None, ...]) -> Array:
    """Return V in the order of the table; of a full scan, means of reciprocals, which no sheet reads far apart."""
    found = arrays[name].shape
    if len(found) == len(shape) and found[-1] == N_FULL_ROWS:
        whole = numbers(arrays, name, (*shape[:-1], N_FULL_ROWS))
        row, reciprocal = whole[..., ROW_IN_FULL], whole[..., RECIPROCAL_IN_FULL]
        if np.mean(np.abs(row - reciprocal) > 0.5 * np.abs(row + reciprocal)) > 0.5:
            raise ValueError(
                f"{name} has {N_FULL_ROWS} rows of which most differ threefold from their reciprocals, expected the "
                "same: order them by drive, then by measured pair; beside decimal commas, separate by semicolons"
            )
        return np.asarray(0.5 * (row + reciprocal))
    return numbers(arrays, name, shape)


def _clouds(arrays: Arrays, n: int, skin: Skin) -> tuple[Array, npt.NDArray[np.intp]]:
    given = [name for name in ("cloud_mm", "cloud_index") if name in arrays]
    if not given:
        return np.zeros((0, *skin.grid.cloud_shape)), np.full(n, -1)
    if len(given) == 1:
        raise ValueError(f"has only {given[0]}; expected both cloud_mm and cloud_index, or neither")
    clouds = numbers(arrays, "cloud_mm", (None, *skin.grid.cloud_shape))
    for number, cloud in enumerate(clouds):
        _check_cloud(cloud, f"cloud_mm[{number}]", skin)
    index = arrays["cloud_index"]
    if index.dtype.kind not in "iu" or index.shape != (n,):
        raise ValueError(f"cloud_index is {index.dtype} of shape {index.shape}, expected whole numbers ({n},)")
    outside = np.flatnonzero((index < -1) | (index >= len(clouds)))
    if outside.size:
        raise ValueError(
            f"cloud_index[{outside[0]}] is {index[outside[0]]}, expected -1 for no scan, or from 0 to "
            f"{len(clouds) - 1}: cloud_mm holds {len(clouds)}"
        )
    return clouds, np.asarray(index, dtype=np.intp)


def _check_cloud(cloud: Array, name: str, skin: Skin) -> None:
    try:
        align_cloud(check_cloud(cloud, skin.grid), skin.grid)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from error


def _truth(arrays: Arrays, n: int, skin: Skin) -> Array:
    truth = numbers(arrays, "truth", (n, *skin.grid.shape))
    low, high = float(truth.min()), float(truth.max())
    if low < -ROUNDING or high > 1.0 + ROUNDING:
        raise ValueError(f"truth goes from {low:g} to {high:g}; expected touched shares from 0 to 1")
    return truth


def _kinds(arrays: Arrays, n: int, truth: Array | None) -> tuple[str, ...]:
    touched = None if truth is None else [bool(one.any()) for one in truth]
    if "kind" not in arrays:
        if touched is None:
            return ("unknown",) * n
        return tuple("touched" if one else UNTOUCHED for one in touched)
    found = arrays["kind"]
    if found.dtype.kind not in "US" or found.shape != (n,):
        raise ValueError(f"kind is {found.dtype} of shape {found.shape}, expected texts ({n},)")
    kinds = tuple(str(one) for one in (np.char.decode(found, "utf-8") if found.dtype.kind == "S" else found))
    for number, kind in enumerate(kinds):
        if touched is not None and kind == UNTOUCHED and touched[number]:
            raise ValueError(f"kind[{number}] is {UNTOUCHED!r}, but truth[{number}] has touches; correct one of them")
    return kinds


def _touch_kind(arrays: Arrays) -> TouchKind | None:
    if "touch_kind" not in arrays:
        return None
    found = text(arrays, "touch_kind")
    kind = EARLIER_WORDS.get(found, found)
    if kind not in TOUCH_KINDS:
        raise ValueError(f"touch_kind is {quoted(found)}, expected one of {', '.join(TOUCH_KINDS)}")
    return "lower" if kind == "lower" else "raise"
