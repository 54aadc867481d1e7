"""The one reference: the mean of N frames of the flat, untouched sheet, with their spread and where they come from.

Every dV divides by it, so it belongs to one device in one configuration, and to one skin; another serial number or
digest is refused.
It is kept as JSON with a checksum, written to a new file that then takes the old one's name: a power cut leaves the
old reference or the new one, never half of one. ::

    {"format": "eitskin-reference", "version": 1, "protocol_id", "grid_id", "skin_digest", "serial_number",
     "configuration_digest", "configuration_name", "captured_utc", "frames", "voltages_V": [104], "spread_V": [104],
     "table": {"name", "electrodes": [rows][4] or null}, "shared_V": [k][rows], "steady_frames",
     "scan": {"cloud_mm": [3][rows][columns], "predicted_V": [104], "predicted_flat_V": [104]}, "sha256"}

``table`` is there where a device measures other rows than the project's own (:mod:`eitskin_proto.sensor.row_table`).
``shared_V`` is there where rows are noisy together (:mod:`eitskin_proto.sensor.noise_law`).
``steady_frames`` is there since frames of rest are averaged (:mod:`eitskin.reference.steadiness`).
``scan`` is there where the sheet was scanned when the reference was taken (:mod:`eitskin.reference.scanned`); such a
file has version 2, so that releases that would ignore the scan refuse it.

A row is *weak* if its voltage is under a ten-thousandth of the largest or not above its own noise. It carries no
information, is filled in from the others (:mod:`eitskin.reference.row_noise`), and every report of a reference names
it.
"""

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin.errors import BadReference, MismatchError
from eitskin.reference.judgement import Judgement
from eitskin.reference.read import capture_again, read_reference
from eitskin.reference.row_noise import WEIGHED_SPREAD, lost_rows, weighed_rows
from eitskin.reference.scanned import ReferenceScan
from eitskin_proto.fields import Fields
from eitskin_proto.files.digest import sha256_of_values
from eitskin_proto.files.plain import stated
from eitskin_proto.files.reading import FileError, parse_json
from eitskin_proto.files.writing import write_bytes
from eitskin_proto.sensor.ids import PROTOCOL_ID
from eitskin_proto.sensor.noise_law import MAX_COMPONENTS
from eitskin_proto.sensor.row_table import ADJACENT_104, MAX_ROWS, RowTable, numbered, row_map
from eitskin_proto.skin.made_for import check_made_for
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_proto.wire.messages import Hello

FORMAT: Final = "eitskin-reference"
VERSION: Final = 1
SCANNED_VERSION: Final = 2
"""Of a reference with a scan."""

MOST_FRAMES: Final = (1 << 31) - 1

DEFAULT_FRAMES: Final = 100
"""Half a second at 200 frames/s: the mean's noise is a tenth of a frame's."""

SMALLEST_V: Final = 1e-9
"""The largest row must be above this; a front end that is not connected reads zeros."""

LARGEST_FILE: Final = 1 << 20
"""Bytes; a reference has about 5000, with the scan of the largest skin 600,000."""


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """A reference: the voltages of the flat, untouched sheet, and their origin."""

    voltages_V: npt.NDArray[np.float64]
    """(rows,) V, mean."""
    spread_V: npt.NDArray[np.float64]
    """(rows,) V, standard deviation of a single frame."""
    frames: int
    """Number of averaged frames."""
    serial_number: str
    configuration_digest: int
    configuration_name: str
    captured_utc: str
    """Wall clock, for people."""
    judgement: Judgement | None = None
    """Findings of the check at capture; not stored."""
    grid_id: str = PAPER.grid_id
    skin_digest: str = PAPER.digest
    """Digest of the skin's description."""
    scan: ReferenceScan | None = None
    """Scan of the sheet at capture; None if it was flat."""
    table: RowTable = ADJACENT_104
    """Its rows."""
    shared_V: npt.NDArray[np.float64] | None = None
    """(rows, k) V, components of a frame's noise that rows share, part of ``spread_V``; None where nobody measured."""
    steady_frames: int | None = None
    """Frames over which a mean gains before the sheet drifts; None where nobody measured."""

    def __repr__(self) -> str:
        return f"<Reference of {self.frames} frames of {self.serial_number}, captured {self.captured_utc}>"

    def flat(self) -> "Reference":
        """Return the reference of the flat sheet: this one, or the one converted with its scan."""
        if self.scan is None:
            return self
        factor = self.scan.flattening()
        shared = None if self.shared_V is None else self.shared_V * factor[:, None]
        spread = self.spread_V * factor
        return replace(self, voltages_V=self.voltages_V * factor, spread_V=spread, shared_V=shared, scan=None)

    @property
    def weak(self) -> npt.NDArray[np.intp]:
        """Rows that carry no information."""
        return np.flatnonzero(lost_rows(self.voltages_V, self.spread_V))

    def report(self) -> list[str]:
        """Return lines for people that describe this reference."""
        relative = self.spread_V / np.maximum(np.abs(self.voltages_V), SMALLEST_V)
        lines = [
            f"reference: {self.frames} frames of {self.serial_number}, configuration {self.configuration_name}/"
            f"{self.configuration_digest:08x}, skin {self.skin_digest}, captured {self.captured_utc}, median spread "
            f"{np.median(relative):.2%}"
        ]
        if self.scan is not None:
            shift = float(np.sqrt(np.mean(np.log(self.scan.flattening()) ** 2)))
            lines.append(f"reference: scanned when it was captured; differs from a flat sheet by {shift:.2%} (rms)")
        if self.weak.size:
            names = ", ".join(map(self._row_name, self.weak[:8].tolist()))
            more = f" and {self.weak.size - 8} more" if self.weak.size > 8 else ""
            lines.append(f"reference: {self.weak.size} weak rows, filled in from the others: {names}{more}")
        weighed = int(weighed_rows(self.voltages_V, self.spread_V).sum())
        if weighed:
            lines.append(f"reference: {weighed} rows vary by more than {WEIGHED_SPREAD:.0%} and get less weight")
        if self.shared_V is not None:
            share = float(np.sum(self.shared_V**2) / np.sum(self.spread_V**2))
            lines.append(f"reference: rows share {share:.0%} of their noise, in {self.shared_V.shape[1]} components")
        if not self.spread_V.any():
            lines.append("reference: all its frames are identical, so a front end that hangs goes unnoticed")
        if self.judgement is not None:
            lines += [f"reference: {line}" for line in (*self.judgement.refusals, *self.judgement.remarks)]
        return lines

    def _row_name(self, row: int) -> str:
        electrodes = self.table.electrodes
        return f"{row}" if electrodes is None else f"{row} (drive {electrodes[row, 0]}, measure {electrodes[row, 2]})"

    def in_table(self, table: RowTable, *, signed: bool = True) -> "Reference":
        """Return this reference in the rows of a table.

        Args:
            table: The rows in use.
            signed: Whether the device's voltages have a sign.

        Raises:
            MismatchError: It lacks some of them.
        """
        try:
            mapped = row_map(self.table, table, signed=signed)
        except ValueError as error:
            hint = f"{error}; capture one of these rows: eitskin reference --port PORT --bundle BUNDLE --out FILE"
            raise MismatchError("reference: its rows", found=self.table.name, expected=table.name, hint=hint) from error
        if mapped is None:
            return replace(self, table=table)
        voltages_V = np.zeros(table.rows)
        mapped.apply(self.voltages_V, voltages_V)
        shared_V = None if self.shared_V is None else np.zeros((table.rows, self.shared_V.shape[1]))
        if shared_V is not None and self.shared_V is not None:
            for before, after in zip(self.shared_V.T, shared_V.T, strict=True):
                mapped.apply(before, after)
        spread_V = mapped.spread(self.spread_V)
        return replace(self, voltages_V=voltages_V, spread_V=spread_V, shared_V=shared_V, table=table)

    def answer(self) -> dict[str, object]:
        """Return the fields of the answer to the control request ``reference``."""
        found = {} if self.judgement is None else self.judgement.fields()
        return {"frames": self.frames, "weak_rows": self.weak.tolist(), **found}

    def check_skin(self, skin: Skin) -> None:
        """Refuse a reference of another skin.

        Args:
            skin: The skin in use.

        Raises:
            MismatchError: The skins differ; the text has both ids and the command that captures a new reference.
        """
        hint = "capture one of this skin: eitskin reference --port PORT --bundle BUNDLE --out FILE"
        check_made_for("reference", skin, grid_id=self.grid_id, skin_digest=self.skin_digest, hint=hint)

    def check(self, hello: Hello) -> None:
        """Refuse a reference of another device or configuration.

        Raises:
            BadReference: A row is not finite.
            MismatchError: They differ; the text has both values and the command that captures a new reference.
        """
        hint = "capture one of this device: eitskin reference --port PORT --out FILE"
        bad = np.flatnonzero(~np.isfinite(self.voltages_V))
        if bad.size:
            raise BadReference(f"reference: row {bad[0]} is {self.voltages_V[bad[0]]} V, expected a finite one; {hint}")
        if self.serial_number != hello.serial_number:
            raise MismatchError(
                "reference: serial_number", found=self.serial_number, expected=hello.serial_number, hint=hint
            )
        if self.configuration_digest != hello.configuration_digest:
            raise MismatchError(
                "reference: the device's configuration",
                found=f"{self.configuration_name}/{self.configuration_digest:08x} when it was captured",
                expected=f"{hello.configuration_name}/{hello.configuration_digest:08x} as the device is now",
                hint=hint,
            )


def stored(reference: Reference) -> bytes:
    """Return what a reference's file holds; the same reference gives the same bytes."""
    content: dict[str, Any] = {
        "format": FORMAT,
        "version": VERSION if reference.scan is None else SCANNED_VERSION,
        "protocol_id": PROTOCOL_ID,
        "grid_id": reference.grid_id,
        "skin_digest": reference.skin_digest,
        "serial_number": reference.serial_number,
        "configuration_digest": f"{reference.configuration_digest:08x}",
        "configuration_name": reference.configuration_name,
        "captured_utc": reference.captured_utc,
        "frames": reference.frames,
        "voltages_V": reference.voltages_V.tolist(),
        "spread_V": reference.spread_V.tolist(),
    }
    if reference.table.id != ADJACENT_104.id:
        electrodes = reference.table.electrodes
        content["table"] = {
            "name": reference.table.name, "electrodes": None if electrodes is None else electrodes.tolist()
        }  # fmt: skip
    if reference.scan is not None:
        content["scan"] = reference.scan.stored()
    if reference.shared_V is not None:
        content["shared_V"] = reference.shared_V.T.tolist()
    if reference.steady_frames is not None:
        content["steady_frames"] = reference.steady_frames
    content["sha256"] = sha256_of_values(content)
    return (json.dumps(content, indent=1) + "\n").encode("ascii")


def save(reference: Reference, path: str | Path) -> None:
    """Write a reference to a file, atomically.

    Raises:
        BadReference: The file cannot be written.
    """
    where = Path(path)
    try:
        write_bytes(where, stored(reference), mode=0o600)
    except FileError as error:
        raise BadReference(str(error)) from error
    except OSError as error:
        raise BadReference(f"{where} cannot be written: {error.strerror or error}") from error


def load(path: str | Path, skin: Skin | None = None) -> Reference:
    """Return the reference of a file.

    Args:
        path: The file.
        skin: Whose it must be; None for anybody's.

    Raises:
        BadReference: It cannot be read, is damaged, or holds values that cannot be used.
        MismatchError: It is of another version or protocol_id, or of another skin.
    """
    where = Path(path)
    return parsed(read_reference(where, FORMAT, LARGEST_FILE), str(where), capture_again(where), skin)


def parsed(raw: bytes, where: str, hint: str, skin: Skin | None = None) -> Reference:
    """Return the reference of a file's bytes.

    Args:
        raw: What :func:`stored` gave.
        where: They come from.
        hint: What to do if they cannot be used.
        skin: Whose it must be; None for anybody's. What is raised is as of :func:`load`.
    """
    try:
        content = parse_json(raw)
    except FileError as error:
        raise BadReference(f"reference {where} is damaged: it {error}; {hint}") from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise BadReference(f"{where} is not a reference; {hint}")
    version = SCANNED_VERSION if "scan" in content else VERSION
    for name, expected in (("version", version), ("protocol_id", PROTOCOL_ID)):
        if content.get(name) != expected:
            raise MismatchError(
                f"reference {where}: {name}", found=stated(content.get(name)), expected=expected, hint=hint
            )
    if skin is not None:
        ids = {name: content.get(name) for name in ("grid_id", "skin_digest")}
        check_made_for(f"reference {where}", skin, **ids, hint=f"{hint}, with a bundle of this skin")
    claimed = content.pop("sha256", None)
    try:
        found = sha256_of_values(content)
    except (TypeError, ValueError, RecursionError) as error:
        raise BadReference(f"reference {where} is damaged ({error}); {hint}") from error
    if claimed != found:
        raise BadReference(
            f"reference {where} is damaged: sha256 found {found[:16]}, expected {stated(claimed)[:16]}; {hint}"
        )
    fields = Fields(content, "")
    try:
        table = _table(content)
        reference = Reference(
            voltages_V=np.array(fields.numbers("voltages_V", table.rows)),
            spread_V=np.array(fields.numbers("spread_V", table.rows)),
            table=table,
            shared_V=_shared(content, table.rows),
            steady_frames=fields.whole("steady_frames", None, low=1, high=MOST_FRAMES),
            frames=fields.whole("frames", low=1, high=MOST_FRAMES),
            serial_number=fields.text("serial_number", least=0, longest=16),
            configuration_digest=int(fields.text("configuration_digest", longest=8), 16),
            configuration_name=fields.text("configuration_name", least=0, longest=16),
            captured_utc=fields.text("captured_utc", least=0, longest=64),
            grid_id=fields.text("grid_id", longest=16),
            skin_digest=fields.text("skin_digest", PAPER.digest, longest=16),
            scan=ReferenceScan.parse(content["scan"]) if "scan" in content else None,
        )
        lost_rows(reference.voltages_V, reference.spread_V)  # refuses voltages of no front end
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise BadReference(f"reference {where} is malformed ({error}); {hint}") from error
    if not float(np.abs(reference.voltages_V).max()) >= SMALLEST_V:
        raise BadReference(f"reference {where}: no row reaches {SMALLEST_V:g} V; {hint}")
    return reference


def _shared(content: dict[str, Any], rows: int) -> npt.NDArray[np.float64] | None:
    """Return (rows, k) V that rows' noise shares; None of a reference that does not say.

    Raises:
        TypeError: It is no table of numbers.
        ValueError: The same, or of other rows.
    """
    if "shared_V" not in content:
        return None
    found = np.array(content["shared_V"], dtype=np.float64)
    if found.ndim != 2 or found.shape[1] != rows or len(found) > MAX_COMPONENTS or not np.isfinite(found).all():
        raise ValueError(f"shared_V of shape {found.shape}, expected at most {MAX_COMPONENTS} finite rows of {rows}")
    return found.T


def _table(content: dict[str, Any]) -> RowTable:
    """Return the rows of a reference.

    Raises:
        KeyError: Something is missing.
        TypeError: It is not what it should be.
        ValueError: The same.
    """
    if "table" not in content:
        return ADJACENT_104
    name, electrodes = str(content["table"]["name"])[:16], content["table"]["electrodes"]
    if electrodes is None:
        return numbered(len(content["voltages_V"]))
    if len(electrodes) > MAX_ROWS:
        raise ValueError(f"{len(electrodes)} rows, expected at most {MAX_ROWS}")
    return RowTable.of(electrodes, name)


def taken(reference: Reference | str | Path | None, skin: Skin) -> Reference | None:
    """Return a reference of this skin, read from a file if that is what it is.

    Raises:
        BadReference: See :func:`load`.
        MismatchError: See :func:`load`.
    """
    if isinstance(reference, str | Path):
        return load(reference, skin)
    if reference is not None:
        reference.check_skin(skin)
    return reference
