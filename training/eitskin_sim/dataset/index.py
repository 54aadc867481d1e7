"""``index.json`` of a data set: its parameters, with checked ids."""

from pathlib import Path
from typing import Any, Final

from eitskin_proto.errors import MismatchError, ProtocolError
from eitskin_proto.files.plain import plain, quoted, stated
from eitskin_proto.files.reading import FileError, read_json
from eitskin_proto.sensor.ids import PROTOCOL_ID
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_proto.skin.toml import parse
from eitskin_proto.skin.touch_kind import TouchKind
from eitskin_sim.freeform.touches import TOUCH_KIND_OF_DRAW, TOUCH_KINDS

FORMAT: Final = "eitskin-dataset"
VERSION: Final = 1
VERSION_OF_SOFT: Final = 2
"""Of data sets whose touches are not hard ones alone, which a reader of version 1 would take for such."""
HINT: Final = "make it again with 'eitskin dataset'"

MAX_SHARDS: Final = 10_000


def is_soft(index: dict[str, Any]) -> bool:
    """Return whether there are other touches than the paper's hard ones."""
    return bool(index.get("touch_kind", "hard") != "hard")


def touch_kind_of(index: dict[str, Any]) -> TouchKind:
    """Return which way the touches change conductance.

    Raises:
        ValueError: There are no such touches.
    """
    found = index.get("touch_kind", "hard")
    if not isinstance(found, str) or found not in TOUCH_KINDS:
        raise ValueError(f"touch_kind is {quoted(found)}, expected one of {', '.join(TOUCH_KINDS)}")
    return skin_of(index).touch_kind if found == "skin" else TOUCH_KIND_OF_DRAW[found]


def skin_of(index: dict[str, Any]) -> Skin:
    """Return the skin that a data set was made for; one made before skins had descriptions is of the paper's.

    Raises:
        ValueError: The description is none, or not that of the digest.
    """
    if "skin_digest" not in index:
        return PAPER
    skin = parse(str(index.get("skin")))
    if skin.digest != index["skin_digest"]:
        raise ValueError(f"skin_digest is {quoted(index['skin_digest'])}, its description has {skin.digest}")
    return skin


def read_index(folder: Path) -> dict[str, Any]:
    """Return ``index.json``, its ids checked.

    Raises:
        MismatchError: It was made for another protocol, grid or version.
        ProtocolError: The folder holds no finished data set.
        OSError: The file cannot be read.
    """
    path = folder / "index.json"
    if folder.is_dir() and not path.exists():
        raise ProtocolError(
            f"{folder} is not a finished data set: index.json is missing; finish it with 'eitskin dataset'"
        )
    try:
        index = read_json(path)
    except FileError as error:
        raise ProtocolError(f"{error}; {HINT}") from error
    if not isinstance(index, dict) or index.get("format") != FORMAT:
        raise ProtocolError(f"{path} is not the index of a data set; {HINT}")
    version = VERSION_OF_SOFT if is_soft(index) else VERSION
    try:
        skin = skin_of(index)
    except ValueError as error:
        raise ProtocolError(f"{path}: {plain(str(error))}; {HINT}") from error
    for name, expected in (("version", version), ("protocol_id", PROTOCOL_ID), ("grid_id", skin.grid_id)):
        if index.get(name) != expected:
            raise MismatchError(
                f"data set {folder}: {name}", found=stated(index.get(name)), expected=expected, hint=HINT
            )
    shards = index.get("deformations")
    if not isinstance(shards, list) or not 1 <= len(shards) <= MAX_SHARDS:
        raise ProtocolError(
            f"{path}: deformations found {quoted(shards)}, expected a list of up to {MAX_SHARDS}; {HINT}"
        )
    return index
