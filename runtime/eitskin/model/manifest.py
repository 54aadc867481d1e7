"""What a bundle says of itself: its manifest, read and checked."""

from pathlib import Path
from typing import Any, Final

from eitskin.errors import BundleError, MismatchError
from eitskin_proto.files.plain import quoted, stated
from eitskin_proto.files.reading import FileError, parse_json
from eitskin_proto.skin.touch_kind import touch_kind_of

FORMAT: Final = "eitskin-bundle"
VERSION: Final = 1

LABELS: Final = ("area", "units")
"""What a bundle's maps may mean."""

SMALL: Final = "small"
"""What the manifest calls a second, smaller network, for a machine that is too slow."""

GENTLE: Final = "gentle"
"""What it calls one that draws touches which the bundle's own hardly shows (:mod:`eitskin.model.gentle`)."""

BESIDE: Final = (SMALL, GENTLE)
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
    problem = _shape_problem(manifest)
    if problem:
        raise BundleError(f"{where}: manifest.json: {problem}; {hint}")
    return manifest


def _shape_problem(manifest: dict[str, Any]) -> str | None:
    files, head, labels = manifest.get("files"), manifest.get("head"), manifest.get("labels")
    if not isinstance(labels, str) or labels not in LABELS:
        return f"labels found {quoted(labels)}, expected one of {', '.join(LABELS)}"
    try:
        touch_kind_of(manifest.get("touches", "raise"))
    except ValueError as error:
        return f"touches {error}"
    for name in ("gate", "metrics", "recipe", *BESIDE):
        if not isinstance(manifest.get(name), dict | None):
            return f"{name} found {quoted(manifest[name])}, expected an object"
    if not isinstance(files, dict) or len(files) > 32:
        return "files must be an object of at most 32 names"
    if not all(isinstance(entry, dict) and isinstance(entry.get("sha256"), str) for entry in files.values()):
        return "every file needs a sha256"
    if not isinstance(head, dict) or not isinstance(head.get("inputs"), list):
        return "head.inputs must be a list"
    for name, of in (("head", head), *((name, manifest.get(name)) for name in BESIDE)):
        if of is None:
            continue
        bias = of.get("bias")
        if isinstance(bias, bool) or not isinstance(bias, int) or not 1 <= bias <= 65536:
            return f"{name}.bias found {quoted(bias)}, expected a width from 1 to 65536"
    return None
