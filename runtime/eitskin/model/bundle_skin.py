"""Which skin a bundle was made for: the description in its ``skin.toml``, or the paper's where there is none.

Bundles that are older than descriptions have neither ``skin.toml`` nor ``skin_digest``; their ``grid_id`` says that
they are the paper's.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from eitskin.errors import BundleError, MismatchError
from eitskin_proto.files.plain import stated
from eitskin_proto.files.reading import LARGEST_TOML
from eitskin_proto.sensor.ids import PROTOCOL_ID
from eitskin_proto.skin.skin import PAPER, Skin

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
