"""Reads a bundle, the file with everything needed to turn voltages into maps, and checks it before use.

::

    NAME.eitskin (ZIP)
      manifest.json     format, version, ids, labels, touches, recipe, seeds, metrics, sha256 of every file
      skin.toml         which skin it is for (optional; without it, the paper's, whose sizes are below)
      taught.npz        touches learned from presses, taught_2.npz ... in further shapes of the sheet (optional)
      geometry.onnx     cloud (1, 3, 30, 45) -> bias (1, H)                   runs when a cloud arrives
      head.onnx         dv (1, 104) [, log_predicted (1, 104)], bias (1, H) -> map (1, 1350)   runs a frame
      head_int8.onnx    the same, dynamic int8 (optional)
      small_*.onnx      both graphs of a smaller network, gentle_*.onnx of one for faint touches (optional)
      tikhonov.npy      (1350, 104) the projection for the flat sheet (optional without a network)
      l1.npz            operators of a sparse solver (optional); the projection beside it takes logarithms
      gate.npz          the touch gate (optional)
      consistency.npz   statistics of healthy frames, to detect failing electrodes and drift (optional)

A bundle has a network (manifest: ``head``), or a solver that needs none: ``tikhonov.npy``, ``l1.npz`` or
``taught.npz``. Frames have 104 rows, or as many as a taught bundle's manifest says (``rows``).

A bundle is data: nothing in it is executed or unpickled, sizes are bounded before anything is read. Its id is the
SHA-256 of the manifest, which holds the SHA-256 of everything else. Files are read when they are asked for, and checked
each time: a session keeps its own copy of the weights, so a second copy in Python would only cost memory.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin.errors import BundleError, MismatchError
from eitskin.model.manifest import EXTRA_NETWORKS, LABELS, manifest_of
from eitskin_proto.files.archive import BadArchiveError, Member, members
from eitskin_proto.files.arrays import parse_npy, parse_npz
from eitskin_proto.files.digest import id_of, sha256_of
from eitskin_proto.files.plain import plain, quoted, stated
from eitskin_proto.files.reading import LARGEST_TOML, FileError, is_name, opened
from eitskin_proto.sensor.ids import PROTOCOL_ID
from eitskin_proto.sensor.row_table import ADJACENT_104, RowTable, numbered, table_of
from eitskin_proto.sensor.table import N_ROWS
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_proto.skin.skin import Skin as SkinDescription
from eitskin_proto.skin.touch_kind import TOUCH_KINDS, TouchKind, touch_kind_of

TAUGHT_FILE: Final = "taught.npz"
"""Touches learned from presses (:mod:`eitskin.model.taught`), in the first shape of the sheet."""

MOST_SHAPES: Final = 9
"""Shapes in which a sheet is taught, at most."""

L1_FILE: Final = "l1.npz"
"""Operators of the sparse solver (:mod:`eitskin.model.sparse`)."""

SHIPPED: Final = {
    ("area", "raise"): "free",
    ("units", "raise"): "units",
    ("area", "lower"): "press",
    ("units", "lower"): "units-press",
}
"""Labels and which way touches change conductance -> the shipped bundle's name."""

HOME: Final = Path(__file__).parents[1] / "bundles"
"""Where they lie."""

NETWORK: Final = ("geometry.onnx", "head.onnx", "tikhonov.npy")
"""Files that a bundle with a network has."""

WITHOUT_NETWORK: Final = (TAUGHT_FILE, L1_FILE, "tikhonov.npy")
"""Files of which one without a network has at least one."""

LARGEST_MANIFEST: Final = 1 << 20
LARGEST_FILE: Final = 64 << 20
LARGEST_BUNDLE: Final = 256 << 20
"""Bounds in bytes on a file, and on all of them; a default bundle is a few MB."""

LARGEST_ARRAYS: Final = 16 << 20
"""Bytes of all arrays of a gate, or of the statistics of healthy frames."""

EXPORT_HINT: Final = "make it again with 'eitskin export'"


def taught_file(number: int) -> str:
    """Return the file of a taught shape, counted from 0."""
    return f"taught_{number + 1}.npz" if number else TAUGHT_FILE


def graphs_of(name: str) -> tuple[str, str]:
    """Return the files of an additional network: its geometry graph and its head."""
    return f"{name}_geometry.onnx", f"{name}_head.onnx"


class Files(Mapping[str, bytes]):
    """The files of a bundle by name; each access reads and checks one.

    Args:
        path: Of the bundle.
        digests: SHA-256 of every file.
    """

    def __init__(self, path: Path, digests: Mapping[str, str]) -> None:
        self._path = path
        self._digests = digests

    def __getitem__(self, name: str) -> bytes:
        expected = self._digests[name]
        with _members(self._path) as archive:
            data = _member(archive, name, LARGEST_FILE, self._path)
        found = sha256_of(data)
        if found != expected:
            raise BundleError(
                f"{self._path}: {name} is damaged: sha256 found {found[:16]}, expected {stated(expected)[:16]}; "
                f"copy the bundle again, or {EXPORT_HINT}"
            )
        return data

    def __contains__(self, name: object) -> bool:
        return name in self._digests

    def __iter__(self) -> Iterator[str]:
        return iter(self._digests)

    def __len__(self) -> int:
        return len(self._digests)


@dataclass(frozen=True, slots=True)
class Bundle:
    """A checked bundle."""

    path: Path
    manifest: dict[str, Any]
    files: Mapping[str, bytes]
    id: str
    """16 hex digits."""
    skin: SkinDescription
    """Which skin it was made for."""

    def __repr__(self) -> str:
        return f"<Bundle {self.id} of {self.labels} labels: {self.path}>"

    @property
    def labels(self) -> str:
        """Meaning of a map's values: ``area`` or ``units``."""
        return str(self.manifest["labels"])

    @property
    def touch_kind(self) -> TouchKind:
        """The touches that it knows; ``raise`` for old bundles that do not say."""
        return touch_kind_of(self.manifest.get("touches", "raise"))

    @property
    def rows(self) -> int:
        """Rows of a frame: 104, or as many as it was taught with."""
        return int(self.manifest.get("rows", N_ROWS))

    @property
    def table(self) -> RowTable:
        """Rows of a frame; of a bundle that was taught with rows alone, their number."""
        stated = self.manifest.get("table")
        try:
            found = table_of(stated) if stated is not None else ADJACENT_104 if self.has_network else None
        except ValueError as error:
            raise BundleError(f"{self.path}: {error}; {EXPORT_HINT}") from error
        if found is None:
            found = ADJACENT_104 if "tikhonov.npy" in self.files and self.rows == N_ROWS else numbered(self.rows)
        if found.rows != self.rows:
            raise BundleError(f"{self.path}: {found.name} has {found.rows} rows, expected {self.rows}; {EXPORT_HINT}")
        return found

    @property
    def has_network(self) -> bool:
        """Whether there are graphs; else clouds only place touches in space."""
        return self.manifest.get("head") is not None

    @property
    def bias_width(self) -> int:
        """H, the width of the first fusion layer; 0 without a network."""
        return int(self.manifest["head"]["bias"]) if self.has_network else 0

    @property
    def beside(self) -> dict[str, int]:
        """The same width for each additional network, by name."""
        return {
            name: int(self.manifest[name]["bias"]) for name in EXTRA_NETWORKS if self.manifest.get(name) is not None
        }

    @property
    def uses_prediction(self) -> bool:
        """Whether the head takes the predicted reference of the deformed sheet."""
        return self.has_network and "log_predicted" in self.manifest["head"]["inputs"]

    def tikhonov(self) -> npt.NDArray[np.float32]:
        """Return the (pixels, 104) projection.

        Raises:
            BundleError: It has another shape or type, or is not finite.
        """
        try:
            matrix = parse_npy(self.files["tikhonov.npy"], "tikhonov.npy")
        except FileError as error:
            raise BundleError(f"{self.path}: {error}; {EXPORT_HINT}") from error
        expected = self.skin.grid.n_pixels, self.rows
        if matrix.shape != expected or matrix.dtype.kind != "f":
            found = f"{matrix.shape} {matrix.dtype}"
            raise BundleError(f"tikhonov.npy: found {found}, expected {expected} float32; {EXPORT_HINT}")
        if not np.isfinite(matrix).all():
            raise BundleError(f"tikhonov.npy: holds values that are not finite; {EXPORT_HINT}")
        return np.ascontiguousarray(matrix, dtype=np.float32)

    def gate_arrays(self) -> dict[str, npt.NDArray[np.generic]] | None:
        """Return the touch gate's arrays, or None for a bundle without a gate."""
        return self._archive("gate.npz")

    def taught_arrays(self) -> list[dict[str, npt.NDArray[np.generic]]]:
        """Return what was learned from presses in each shape of the sheet; empty for a bundle that was not taught."""
        names = [taught_file(number) for number in range(MOST_SHAPES)]
        return [arrays for name in names if (arrays := self._archive(name)) is not None]

    def l1_arrays(self) -> dict[str, npt.NDArray[np.generic]] | None:
        """Return the operators of the sparse solver, or None for a bundle without it."""
        return self._archive(L1_FILE)

    def consistency_arrays(self) -> dict[str, npt.NDArray[np.generic]] | None:
        """Return the arrays that describe healthy frames, or None for a bundle without them."""
        return self._archive("consistency.npz")

    def _archive(self, name: str) -> dict[str, npt.NDArray[np.generic]] | None:
        if name not in self.files:
            return None
        try:
            arrays = parse_npz(self.files[name], LARGEST_ARRAYS, name)
        except FileError as error:
            raise BundleError(f"{self.path}: {error}; {EXPORT_HINT}") from error
        for key, array in arrays.items():
            if array.dtype.kind not in "fiub":
                raise BundleError(
                    f"{self.path}: {name}: {quoted(key)} is {array.dtype}, expected numbers; {EXPORT_HINT}"
                )
        return arrays


def default_path(labels: str = "area", touches: TouchKind = "raise") -> Path:
    """Return where the shipped bundle for these labels and touches is; for ``both``, that which knows ``raise``.

    Raises:
        ValueError: There are no such labels, or no such touches.
    """
    if labels not in LABELS:
        raise ValueError(f"labels {labels!r} do not exist; expected one of {', '.join(LABELS)}")
    if touches not in TOUCH_KINDS:
        raise ValueError(f"touches {touches!r} do not exist; expected one of {', '.join(TOUCH_KINDS)}")
    name = SHIPPED[labels, "lower" if touches == "lower" else "raise"]
    return HOME / f"{name}.eitskin"


def shipped() -> tuple[str, ...]:
    """Return the names of the bundles that are there, in order."""
    return tuple(sorted(path.stem for path in HOME.glob("*.eitskin")))


def load_bundle(path: str | Path | None = None, *, lazily: bool = False) -> Bundle:
    """Return a bundle after checking every byte.

    Args:
        path: The file, or the name of a shipped bundle: ``free``, ``press``, ``units``; None takes ``free``.
        lazily: Check each part only when it is used.

    Raises:
        BundleError: The bundle cannot be read, is damaged or incomplete.
        MismatchError: It has another format version or protocol_id, or ids other than its skin's.
    """
    where = default_path() if path is None else HOME / f"{path}.eitskin" if is_name(path, shipped()) else Path(path)
    with _members(where) as archive:
        raw = _member(archive, "manifest.json", LARGEST_MANIFEST, where)
        sizes = {name: member.entry.file_size for name, member in archive.items()}
    manifest = manifest_of(raw, where, EXPORT_HINT)
    besides = [file for name in EXTRA_NETWORKS if manifest.get(name) is not None for file in graphs_of(name)]
    alone = manifest.get("head") is None
    required = besides if alone else (*NETWORK, *besides)
    if alone and not any(name in manifest["files"] for name in WITHOUT_NETWORK):
        raise BundleError(
            f"{where} has no solver: expected a network, or {' or '.join(WITHOUT_NETWORK)}; {EXPORT_HINT}"
        )
    missing = [name for name in (*required, *manifest["files"]) if name not in sizes or name not in manifest["files"]]
    if missing:
        raise BundleError(f"{where} lacks {', '.join(map(plain, dict.fromkeys(missing)))}; {EXPORT_HINT}")
    if (claimed := sum(sizes[name] for name in manifest["files"])) > LARGEST_BUNDLE:
        raise BundleError(f"{where} claims {claimed} bytes, expected at most {LARGEST_BUNDLE}; {EXPORT_HINT}")
    files = Files(where, {name: str(entry["sha256"]) for name, entry in manifest["files"].items()})
    skin = skin_of(manifest, files, where, EXPORT_HINT)
    if not lazily:
        for name in files:
            files[name]
    return Bundle(where, manifest, files, id_of(raw), skin)


@contextmanager
def _members(where: Path) -> Iterator[Mapping[str, Member]]:
    """Give the members of an archive, open while the block lasts."""
    try:
        with opened(where, LARGEST_BUNDLE) as stream:
            yield members(stream)
    except FileNotFoundError as error:
        raise BundleError(
            f"no bundle {where}; expected a file, or one of the shipped: {', '.join(shipped())}; "
            "'eitskin build' makes one for another sheet"
        ) from error
    except OSError as error:
        raise BundleError(f"{where} cannot be read: {error.strerror or error}") from error
    except FileError as error:
        raise BundleError(f"no bundle: {error}") from error
    except BadArchiveError as error:
        raise BundleError(f"{where} is not an intact bundle ({error}); {EXPORT_HINT}") from error


def _member(found: Mapping[str, Member], name: str, largest: int, where: Path) -> bytes:
    if name not in found:
        raise BundleError(f"{where} has no {name}; {EXPORT_HINT}")
    return found[name].read(largest)


SKIN_FILE: Final = "skin.toml"
"""The description within a bundle."""


def skin_of(manifest: Mapping[str, Any], files: Mapping[str, bytes], where: Path, hint: str) -> Skin:
    """Return the skin of a bundle, whose ids agree with it.

    Args:
        manifest: Of the bundle.
        files: Its files; the description is read if there is one.
        where: The bundle, for messages.
        hint: What to do about it.

    Raises:
        BundleError: The description cannot be read.
        MismatchError: protocol_id is another one, or grid_id or skin_digest are not those of the description.
    """
    take = f"take a bundle of this release, or {hint}"
    if manifest.get("protocol_id") != PROTOCOL_ID:
        found = stated(manifest.get("protocol_id"))
        raise MismatchError(f"{where}: protocol_id", found=found, expected=PROTOCOL_ID, hint=take)
    skin = _described(files[SKIN_FILE], where, hint) if SKIN_FILE in files else PAPER
    expected = {"grid_id": skin.grid_id, "skin_digest": skin.digest}
    for name, value in expected.items():
        found = manifest.get(name, PAPER.digest if name == "skin_digest" and skin is PAPER else None)
        if found != value:
            raise MismatchError(f"{where}: {name}", found=stated(found), expected=value, hint=take)
    return skin


def _described(raw: bytes, where: Path, hint: str) -> Skin:
    from eitskin_proto.skin import toml  # noqa: PLC0415 -- the paper's bundles do without

    try:
        if len(raw) > LARGEST_TOML:
            raise ValueError(f"{len(raw)} bytes, expected at most {LARGEST_TOML}")
        return toml.parse(raw.decode("utf-8"))
    except ValueError as error:  # UnicodeDecodeError is one
        raise BundleError(f"{where}: {SKIN_FILE}: {error}; {hint}") from error
