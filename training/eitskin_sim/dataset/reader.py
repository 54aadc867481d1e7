"""The data set on disk, and its reader.

A folder of plain files; every array is an ``.npy`` inside an uncompressed ``.npz`` ::

    index.json          format, version, protocol_id, grid_id, skin (its TOML), skin_digest, set, seed, sizes, digest;
                        per deformation: its bend, split, file, number of samples, SHA-256 of the file
    touches.npz         on the unit grid  units (T, n / 8) uint8, packed bits, unit 0 first
                        there, not hard   contrast_class (T, units) uint8 of touched units, contrast (classes,) float64
                        anywhere          pieces (P, 7) float64 and first (T + 1,) int64   (scene.touch_table)
                        there, not hard   pieces (P, 8), with the width of their borders
                        and               validation (T,) bool, reference (104,) float64 V, flat and untouched
    deformation-0000.npz  touch_set (n,) int32, voltages (n, 104) float32 V at 1 A, free of noise;
                        untouched (104,) float64 V; cloud (3, rows, columns) float32 mm as measured, in the agreed pose

A sample takes 420 bytes; 1350 labels as float32 would take 5,400. Labels are made from the touch set, noise is added
when a batch is made. ``index.json`` is written last: a folder without it is unfinished, and 'eitskin dataset' resumes
it.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt

from eitskin_proto.errors import MismatchError, ProtocolError, SkinError
from eitskin_proto.files.arrays import parse_npz
from eitskin_proto.files.digest import sha256_of
from eitskin_proto.files.plain import plain, quoted, stated
from eitskin_proto.files.reading import read_bytes
from eitskin_proto.sensor.table import N_ROWS
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_proto.skin.touch_kind import TouchKind
from eitskin_sim.dataset.index import HINT, is_soft, read_index, skin_of, touch_kind_of
from eitskin_sim.dataset.plan import SET_NAMES, SetName
from eitskin_sim.scene.parts import Bend
from eitskin_sim.scene.touch_table import TouchTable
from eitskin_sim.unit_grid.patterns import UnitContrasts, unpack

PIECE_COLUMNS: Final = {False: 7, True: 8}
"""Of a table of touches that are hard ones alone, or may be soft: these have a border."""

LARGEST_FILE: Final = 1 << 30
"""Bytes of a file; 700,000 free touch sets take 120 MB."""

Arrays = dict[str, npt.NDArray[Any]]


@dataclass(frozen=True, slots=True)
class DataSet:
    """A data set in memory: N samples at D deformations of T touch sets."""

    set_name: SetName
    seed: int
    digest: str
    """Stands for every file."""
    reference_V: npt.NDArray[np.float64]
    """(104,) flat and untouched."""
    untouched_V: npt.NDArray[np.float64]
    """(D, 104)"""
    clouds: npt.NDArray[np.float32]
    """(D, 3, rows, columns) mm, as measured, in the agreed pose."""
    bends: tuple[Bend, ...]
    deformation_split: tuple[str, ...]
    """(D,) "train", "kept" (family A) or "other" (family B)."""
    voltages_V: npt.NDArray[np.float32]
    """(N, 104) touched, free of noise."""
    deformation: npt.NDArray[np.int32]
    """(N,)"""
    touch_set: npt.NDArray[np.int32]
    """(N,) the same number recurs at several deformations."""
    touch_split: npt.NDArray[np.bool_]
    """(T,) True for a touch set that is held out."""
    units: npt.NDArray[np.bool_]
    """(T, units) touched units; (0, units) for touches anywhere."""
    free: TouchTable
    """Touches anywhere; empty on the unit grid."""
    unit_contrasts: UnitContrasts | None = None
    """Of touches on the unit grid, where they are not the paper's of 50."""
    skin: Skin = PAPER
    """The skin for which it was made."""
    touch_kind: TouchKind = "raise"
    """Which way its touches change conductance."""
    drift: npt.NDArray[np.float32] | None = None
    """(N,) by which each sample's resistances had changed since the reference, of random devices; None of the nominal
    one."""

    @property
    def labels_kind(self) -> Literal["units", "area"]:
        """Hard labels of units, or touched shares of area."""
        return "area" if self.set_name == "free" else "units"

    def rows(
        self,
        deformations: Literal["train", "kept", "other", "all"] = "train",
        touches: Literal["train", "validation", "all"] = "train",
    ) -> npt.NDArray[np.int64]:
        """Return the numbers of the samples of one split of deformations and one of touch sets."""
        wanted = np.array([deformations in ("all", split) for split in self.deformation_split])[self.deformation]
        if touches != "all":
            wanted &= self.touch_split[self.touch_set] == (touches == "validation")
        return np.flatnonzero(wanted)

    def labels(self, rows: npt.NDArray[np.integer]) -> npt.NDArray[np.float32]:
        """Return the (n, rows, columns) maps of some samples."""
        sets = self.touch_set[rows]
        if self.labels_kind == "units":
            return np.asarray(self.skin.grid.map_from_units(self.units[sets]), dtype=np.float32)
        unique, back = np.unique(sets, return_inverse=True)
        maps = np.minimum(self.free.chosen(unique).area_table(self.skin.grid).toarray(), 1.0).astype(np.float32)
        return np.asarray(maps[back].reshape(-1, *self.skin.grid.shape))

    def label_table_u8(self) -> npt.NDArray[np.uint8]:
        """Return (T, pixels) labels of every touch set, 255 where a pixel is touched all over."""
        if self.labels_kind == "units":
            maps = self.skin.grid.map_from_units(np.uint8(255) * self.units)
            return np.asarray(maps, dtype=np.uint8).reshape(-1, self.skin.grid.n_pixels)
        table = self.free.area_table(self.skin.grid)
        table.data = np.rint(255.0 * np.minimum(table.data, 1.0)).astype(np.uint8)
        return np.asarray(table.toarray())


def load(path: str | Path) -> DataSet:
    """Return the data set in a folder, every file checked.

    Raises:
        MismatchError: It was made for another protocol, grid or version, or a file has changed.
        ProtocolError: The folder holds no finished data set.
        OSError: A file cannot be read.
    """
    folder = Path(path)
    index = read_index(folder)
    try:
        return _assembled(index, _read(folder, index["touches"]), [_read(folder, e) for e in index["deformations"]])
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        if isinstance(error, SkinError):
            raise
        raise ProtocolError(f"data set {folder} is damaged: {_told(error)}; {HINT}") from error


def _assembled(index: dict[str, Any], touches: Arrays, shards: list[Arrays]) -> DataSet:
    """Return the data set of its files' arrays, after checking them against each other."""
    skin, unit_bits, pieces = skin_of(index), touches.get("units"), touches.get("pieces", np.empty((0, 7)))
    n_units = skin.grid.n_units
    units = np.empty((0, n_units), dtype=np.bool_)
    if unit_bits is not None:
        units = unpack(_of(unit_bits, "u", (None, -(-n_units // 8))), n_units)
    first = _of(touches.get("first", np.zeros(1, dtype=np.int64)), "i", (None,))
    held_out = _of(touches["validation"], "b", (None,))
    if first[0] != 0 or np.any(np.diff(first) < 0) or first[-1] != len(pieces):
        raise ValueError("the pieces of touches do not follow each other")
    for shard in shards:
        count = len(_of(shard["touch_set"], "i", (None,)))
        _of(shard["voltages"], "f", (count, N_ROWS))
        if count and not 0 <= shard["touch_set"].min() <= shard["touch_set"].max() < len(held_out):
            raise ValueError("a sample names a touch set that is not there")
    name, soft = index["set"], is_soft(index)
    sets = len(first) - 1 if name == "free" else len(units)
    if name not in SET_NAMES or sets != len(held_out):
        raise ValueError(f"set {quoted(name)} with {sets} touch sets and {len(held_out)} that are told apart")
    return DataSet(
        set_name=name,
        seed=int(index["seed"]),
        digest=str(index["digest"]),
        reference_V=_of(touches["reference"], "f", (N_ROWS,)),
        untouched_V=np.array([_of(shard["untouched"], "f", (N_ROWS,)) for shard in shards]),
        clouds=np.array([_of(shard["cloud"], "f", (3, *skin.grid.shape)) for shard in shards]),
        bends=tuple(bend_from_json(entry["bend"]) for entry in index["deformations"]),
        deformation_split=tuple(str(entry["split"]) for entry in index["deformations"]),
        voltages_V=np.concatenate([shard["voltages"] for shard in shards]),
        deformation=np.repeat(
            np.arange(len(shards), dtype=np.int32), [len(shard["touch_set"]) for shard in shards]
        ).astype(np.int32),
        touch_set=np.concatenate([shard["touch_set"] for shard in shards]),
        touch_split=held_out,
        units=units,
        free=TouchTable(_of(pieces, "f", (None, PIECE_COLUMNS[soft and name == "free"])), first),
        unit_contrasts=_unit_contrasts(touches, units) if soft and name != "free" else None,
        skin=skin,
        touch_kind=touch_kind_of(index),
        drift=_drift(index, shards),
    )


def _drift(index: dict[str, Any], shards: list[Arrays]) -> npt.NDArray[np.float32] | None:
    if index.get("devices", "ideal") == "ideal":
        return None
    return np.concatenate([_of(one["drift"], "f", one["touch_set"].shape) for one in shards])


def _unit_contrasts(touches: Arrays, units: npt.NDArray[np.bool_]) -> UnitContrasts:
    """The contrasts of units, where the touches are not hard ones."""
    number = _of(touches["contrast_class"], "u", units.shape)
    contrast = _of(touches["contrast"], "f", (None,))
    if len(contrast) > 255 or np.any(contrast <= 0) or np.any(number[units] >= len(contrast)):
        raise ValueError("the contrasts of units are not those of their classes")
    return UnitContrasts(number.astype(np.uint8), contrast)


def _read(folder: Path, entry: dict[str, Any]) -> Arrays:
    name = entry["file"]
    if not isinstance(name, str) or Path(name).name != name:
        raise ValueError(f"a file is called {quoted(name)}, expected one in the folder")
    path = folder / name
    content = read_bytes(path, LARGEST_FILE)
    found = sha256_of(content)
    if found != entry["sha256"]:
        raise MismatchError(f"{path}: sha256", found=found[:16], expected=stated(entry["sha256"])[:16], hint=HINT)
    return parse_npz(content, LARGEST_FILE, name)


def _of(values: npt.NDArray[Any], kind: str, shape: tuple[int | None, ...]) -> npt.NDArray[Any]:
    """Return an array that has a kind and a shape, of which None leaves a size open; floats are finite."""
    fits = len(values.shape) == len(shape) and all(
        wanted in (None, size) for wanted, size in zip(shape, values.shape, strict=True)
    )
    if values.dtype.kind != kind or not fits:
        raise ValueError(f"an array is {values.dtype} {values.shape}, expected kind {kind} of shape {shape}")
    if kind == "f" and not np.isfinite(values).all():
        raise ValueError("an array holds numbers that are not finite")
    return values


def _told(error: Exception) -> str:
    return f"{quoted(error.args[0])} is missing" if isinstance(error, KeyError) and error.args else plain(str(error))


def bend_from_json(value: dict[str, Any]) -> Bend:
    """Return the bend that ``dataclasses.asdict`` made JSON of.

    Raises:
        ValueError: A number is none, or not finite.
        TypeError: A key is unknown.
    """
    for name, number in value.items():
        if name != "bumps_mm" and (
            isinstance(number, bool) or not isinstance(number, int | float) or not abs(number) < 1e9
        ):
            raise ValueError(f"a bend's {quoted(name)} is {quoted(number)}, expected a finite number")
    bumps = tuple((float(x), float(y), float(height), float(sigma)) for x, y, height, sigma in value["bumps_mm"])
    return Bend(**{**value, "bumps_mm": bumps})
