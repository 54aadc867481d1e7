"""Recorded presses of a known stamp as training samples, in addition to those of a calibrated model.

A network sees dV alone, so a real sheet's readings are converted to the twin's, V = V0_twin V_press / V0_real. Where
the sheet was scanned instead of flat, V0_twin is what the forward model makes of the flat one's for that scan. A few
presses among many simulated samples would hardly count: they are repeated until they make up ``PRESS_SHARE`` of them,
under noise of their own each time. Every ``HELD_OUT_STRIDE``-th press is held out, and measures the benefit of the
others.
"""

from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.errors import MismatchError, SkinError
from eitskin_proto.files.arrays import read_npz, save_arrays
from eitskin_proto.files.digest import id_of
from eitskin_proto.files.writing import replacing
from eitskin_proto.sensor.table import N_FULL_ROWS, ROW_IN_FULL
from eitskin_proto.skin.cloud import flat_cloud, network_input
from eitskin_proto.skin.grid import Grid
from eitskin_proto.skin.skin import Skin
from eitskin_proto.skin.toml import parse, to_toml
from eitskin_proto.skin.touch_kind import TouchKind, knows, touch_kind_of
from eitskin_sim.arrays import Array
from eitskin_sim.calibration.recording import LaterReading, Recording
from eitskin_sim.freeform.sheet import inverted_sheet
from eitskin_sim.freeform.voltages import set_voltages
from eitskin_sim.scene.parts import Bend
from eitskin_sim.scene.touch_table import DISC, RECTANGLE, gather
from eitskin_sim.surface.predict import predicted_log
from eitskin_training.samples.batches import TrainingData

NAME: Final = "presses.npz"

LARGEST_FILE: Final = 64 << 20

PRESS_SHARE: Final = 0.2
"""Of the samples that are learned from, after these have joined."""

HELD_OUT_STRIDE: Final = 4
MIN_PRESSES: Final = 4
"""Presses, so that there is one to be kept apart."""

MIN_COSINE_OF_SAME_PLACE: Final = 0.98
MAX_COSINE_OF_OTHER_PLACE: Final = 0.3
"""Cosine of what two presses change, without what is common to all rows: of two at places far apart, and of two at one
place."""

MAX_DISTANCE_OF_SAME_PLACE: Final = 0.5
MIN_DISTANCE_OF_OTHER_PLACE: Final = 3.0
"""Distances, in sizes of the stamp, below which places are the same and above which they differ."""


def check(recording: Recording) -> None:
    """Refuse presses that are too few, or of which two contradict each other.

    Raises:
        SkinError: In one line, with the presses.
    """
    presses = recording.presses
    if len(presses) < MIN_PRESSES:
        raise SkinError(
            f"{len(presses)} presses are recorded, expected at least {MIN_PRESSES}: every fourth is held out"
        )
    places = np.array([one.xy_mm for one in presses])
    changes = directions(ratios(recording))
    alike = changes @ changes.T
    sizes = max(presses[0].stamp_mm or (1.0,))
    apart = np.linalg.norm(places[:, None] - places, axis=2) / sizes
    for one, other in zip(*np.triu_indices(len(presses), 1), strict=True):
        cosine, away = float(alike[one, other]), float(apart[one, other])
        if (away <= MAX_DISTANCE_OF_SAME_PLACE and cosine < MAX_COSINE_OF_OTHER_PLACE) or (
            away >= MIN_DISTANCE_OF_OTHER_PLACE and cosine > MIN_COSINE_OF_SAME_PLACE
        ):
            read = "unlike" if away <= MAX_DISTANCE_OF_SAME_PLACE else "the same"
            both = f"{press_name(recording, int(one))} and {press_name(recording, int(other))}"
            raise SkinError(
                f"{both} contradict each other: they read {read} (cosine {cosine:.2f}); leave out the one at the "
                "wrong place"
            )


def press_name(recording: Recording, number: int) -> str:
    """Return a press as people read of it."""
    place = recording.presses[number].xy_mm
    assert place is not None
    return f"press {number} at ({place[0]:g}, {place[1]:g}) mm"


def directions(of_reference: Array) -> Array:
    """Return (p, 104) how rows change, without what is common to all of them, each press's of length 1.

    Args:
        of_reference: (p, 104) V over those untouched.
    """
    logs = np.log(of_reference)
    found = logs - logs.mean(axis=1, keepdims=True)
    return np.asarray(found / np.maximum(np.linalg.norm(found, axis=1, keepdims=True), 1e-12))


def write(folder: Path, recording: Recording, data: TrainingData) -> None:
    """Write presses as samples beside a data set's.

    Args:
        folder: Of their own.
        recording: With presses.
        data: What they are to be learned with.

    Raises:
        SkinError: The data set has no labels of touches anywhere.
    """
    if data.labels_kind != "area":
        raise SkinError(
            "a bundle of units cannot learn from recorded presses, because presses lie anywhere, not on units"
        )
    count = len(recording.presses)
    learned = count - len(_kept(count))
    repeats = max(round(PRESS_SHARE / (1.0 - PRESS_SHARE) * len(data.train) / learned), 1)
    cloud = flat_cloud(data.skin.grid) if recording.cloud_mm is None else recording.cloud_mm
    lies = np.zeros((1, len(data.reference)), np.float32)
    if recording.cloud_mm is not None:
        lies = predicted_log([cloud], data.skin)
    arrays: dict[str, npt.NDArray[np.generic]] = {
        "voltages_V": data.reference * np.exp(lies.astype(np.float64)) * ratios(recording),
        "clouds": network_input(cloud, data.skin.grid)[None],
        "log_predicted": lies,
        "labels": _labels(recording, data.skin.grid),
        "places_mm": np.array([one.xy_mm for one in recording.presses]),
        "reference_V": data.reference,
        "repeats": np.array(repeats),
        "touch_kind": np.array(data.touch_kind),
        "skin": np.array(to_toml(data.skin)),
    }
    folder.mkdir(parents=True, exist_ok=True)
    with replacing(folder / NAME) as file:
        save_arrays(file, arrays)


def load(folder: str | Path) -> TrainingData:
    """Return what :func:`write` wrote.

    Raises:
        FileError: It is damaged.
        OSError: It is not there.
    """
    path = Path(folder) / NAME
    arrays = read_npz(path, LARGEST_FILE)
    try:
        skin, reference = parse(str(arrays["skin"])), arrays["reference_V"].astype(np.float64)
        lies = arrays["log_predicted"].astype(np.float64)
        kind = touch_kind_of(str(arrays["touch_kind"]))
        count = len(arrays["voltages_V"])
        rows = np.setdiff1d(np.arange(count), _kept(count))
        return TrainingData(
            voltages=arrays["voltages_V"].astype(np.float32),
            deformation=np.zeros(count, dtype=np.intp),
            touch_set=np.arange(count),
            reference=reference,
            untouched=reference * np.exp(lies),
            clouds=arrays["clouds"].astype(np.float32),
            log_predicted=lies.astype(np.float32),
            labels_kind="area",
            labels=arrays["labels"].astype(np.uint8),
            train=np.repeat(rows, int(arrays["repeats"])),
            validation=np.empty(0, dtype=np.intp),
            held_out={},
            digest=id_of(path.read_bytes()),
            seed=0,
            skin=skin,
            touch_kind=kind,
        )
    except (KeyError, ValueError, TypeError) as error:
        raise SkinError(f"{path} is damaged ({error}); remove it, and give the recording again") from error


def held_out_rows(data: TrainingData) -> npt.NDArray[np.intp]:
    """Return the rows of presses, loaded by themselves, that were kept apart."""
    return _kept(len(data.voltages))


def _kept(count: int) -> npt.NDArray[np.intp]:
    return np.arange(HELD_OUT_STRIDE // 2, count, HELD_OUT_STRIDE)


def ratios(recording: Recording) -> Array:
    """Return (p, 104) V of presses over the reference's.

    Raises:
        SkinError: A row of one has turned its sign.
    """
    reference = recording.reference_V
    rows = reference[ROW_IN_FULL] if len(reference) == N_FULL_ROWS else reference
    found = np.array([one.voltages_V for one in recording.presses]) / rows
    if bad := [str(number) for number in np.flatnonzero((found <= 0.0).any(axis=1))]:
        raise SkinError(f"press {', '.join(bad)}: a row has changed its sign since the reference; leave it out")
    return np.asarray(found)


def _labels(recording: Recording, grid: Grid) -> npt.NDArray[np.uint8]:
    """Return (p, pixels) the share of each that the stamp covers, in 1/255."""
    pieces = [piece(one, 0.5) for one in recording.presses]
    shares = gather(pieces).area_table(grid).toarray()
    return np.asarray(np.rint(255.0 * np.clip(shares, 0.0, 1.0)), dtype=np.uint8)


def piece(press: LaterReading, contrast: float) -> Array:
    """Return the (1, 8) row of a table of touches that a press is, hard at its border."""
    assert press.xy_mm is not None
    assert press.stamp_mm is not None
    (x, y), size = press.xy_mm, press.stamp_mm
    return np.array([[DISC if len(size) == 1 else RECTANGLE, x, y, size[0], size[-1], 0.0, contrast, 0.0]])


MODEL_PRESS_CONTRAST: Final = 0.5
"""Contrast of the model's presses."""

MIN_SIGN_COSINE: Final = 0.5
"""Cosine of the measured and the modelled change above which the direction is known."""


def check_ways(recording: Recording, skin: Skin, known: TouchKind, who: str) -> None:
    """Refuse presses that go opposite ways on a skin of one kind of touches, or a way that skin or bundle do not know.

    A skin's raising touches do not contradict presses, because they are also the default of its file.

    Args:
        recording: With presses.
        skin: Whose sheet it is.
        known: Which touches the bundle knows.
        who: What to call the bundle.

    Raises:
        SkinError: Two contradict each other, or a row has turned its sign; in one line, with the presses.
        MismatchError: One goes a way that the bundle, or a skin whose touches lower conductance, does not know.
    """
    found = ways(recording, skin)
    lower, higher = ([k for k, way in enumerate(found) if way == one] for one in ("lower", "raise"))
    if lower and higher and skin.touch_kind != "both":
        fewer, more = sorted((lower, higher), key=len)
        one, other = ("lowers", "raises") if fewer is lower else ("raises", "lowers")
        few, many = press_name(recording, fewer[0]), press_name(recording, more[0])
        raise SkinError(
            f"{few} {one} conductance and {many} {other} it; leave out the wrong one, or set kind = 'both' in "
            f"[touches] of the file of skin {skin.name}"
        )
    knowing: list[tuple[TouchKind, str]] = [(known, f"as {who} knows")]
    if skin.touch_kind == "lower":
        knowing.insert(0, ("lower", f"from [touches] of skin {skin.name}"))
    hint = "use a bundle and a skin for such touches, or leave out --presses"
    ways_of: list[tuple[list[int], TouchKind]] = [(lower, "lower"), (higher, "raise")]
    for numbers, way in ways_of:
        for kind, source in knowing if numbers else ():
            if not knows(kind, way):
                what = f"{press_name(recording, numbers[0])}: touches"
                raise MismatchError(what, found=way, expected=f"{kind}, {source}", hint=hint)


def ways(recording: Recording, skin: Skin) -> list[TouchKind | None]:
    """Return the direction in which each press changed conductance; None where it is unknown.

    Args:
        recording: With presses.
        skin: Whose sheet it is.

    Raises:
        SkinError: A row has turned its sign.
    """
    read, sheet = directions(ratios(recording)), inverted_sheet(Bend(), skin=skin)
    table = gather([piece(one, MODEL_PRESS_CONTRAST) for one in recording.presses])
    lowered = directions(set_voltages([sheet], table, skin=skin)[0] / sheet.untouched_V)
    alike = np.sum(read * lowered, axis=1)
    return ["lower" if one > MIN_SIGN_COSINE else "raise" if one < -MIN_SIGN_COSINE else None for one in alike]
