"""Reads and checks a bundle's manifest."""

from pathlib import Path
from typing import Any, Final

from eitskin.errors import BundleError, MismatchError
from eitskin_proto.fields import Fields
from eitskin_proto.files.plain import quoted, stated
from eitskin_proto.files.reading import FileError, parse_json
from eitskin_proto.sensor.row_table import MAX_ROWS
from eitskin_proto.sensor.table import N_ROWS
from eitskin_proto.skin.touch_kind import touch_kind_of

FORMAT: Final = "eitskin-bundle"
VERSION: Final = 1

LABELS: Final = ("area", "units")
"""The kinds of labels of a bundle's maps."""

SOLVERS: Final = ("vd2t", "vd2t-int8", "vd2t-small", "taught", "l1", "tikhonov")
"""Names of a bundle's solvers, from the most accurate to the fastest."""

SMALL: Final = "small"
"""The manifest's name of a second, smaller network, for a machine that is too slow."""

GENTLE: Final = "gentle"
"""Its name of one that draws touches which the bundle's own hardly shows (:mod:`eitskin.model.gentle`)."""

MOST_FILES: Final = 32
LARGEST_WIDTH: Final = 65536
"""Of a network's first layer."""

EXTRA_NETWORKS: Final = (SMALL, GENTLE)
"""Networks that a bundle may hold beside its own."""


def manifest_of(raw: bytes, where: Path, hint: str) -> dict[str, Any]:
    """Return a manifest whose fields are of the kinds that its readers expect.

    Args:
        raw: The file.
        where: The bundle, for messages.
        hint: What to do about it.

    Raises:
        BundleError: It is none, or a field is of another kind.
        MismatchError: It is of another version.
    """
    try:
        manifest = parse_json(raw)
    except FileError as error:
        raise BundleError(f"{where}: manifest.json {error}; {hint}") from error
    if not isinstance(manifest, dict) or manifest.get("format") != FORMAT:
        found = manifest.get("format") if isinstance(manifest, dict) else type(manifest).__name__
        raise BundleError(f"{where}: format found {quoted(found)}, expected {FORMAT!r}; {hint}")
    if manifest.get("version") != VERSION:
        raise MismatchError(
            f"{where}: version",
            found=stated(manifest.get("version")),
            expected=VERSION,
            hint=f"{hint} of this release",
        )
    try:
        _check_fields(manifest)
    except ValueError as error:
        raise BundleError(f"{where}: manifest.json: {error}; {hint}") from error
    return manifest


def _check_fields(manifest: dict[str, Any]) -> None:
    """Raise ValueError where a field is of another kind than its readers expect."""
    fields = Fields(manifest, "")
    fields.choice("labels", LABELS)
    try:
        touch_kind_of(fields.value("touches", "raise"))
    except ValueError as error:
        raise ValueError(f"touches {error}") from error
    for name in ("gate", "metrics", "recipe", *EXTRA_NETWORKS):
        if fields.value(name, None) is not None:
            fields.table(name)
    fields.texts("shapes", None)
    files = fields.table("files")
    networks = [name for name in ("head", *EXTRA_NETWORKS) if fields.value(name, None) is not None]
    fields.whole("rows", N_ROWS, low=1, high=MAX_ROWS)
    if not 0 < len(files) <= MOST_FILES:
        raise fields.wrong("files", f"1 to {MOST_FILES} files")
    for name in files:
        files.table(name).text("sha256")
    if networks:
        fields.table("head").entries("inputs")
    for name in networks:
        fields.table(name).whole("bias", low=1, high=LARGEST_WIDTH)
