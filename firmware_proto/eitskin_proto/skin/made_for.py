"""Whether something that was made for one skin may be used with another: bundles, references, clouds, data.

What they must agree about is the sheet: its size, its map and where its electrodes are, which is what ``grid_id``
stands for. All else that a description says is how well that sheet is known, or what it will meet: it may differ. So a
network that learned from random devices of a sheet serves every such sheet, ideal or not.

A skin that was calibrated is the one it was calibrated from, known better: it keeps that one's ``grid_id``, though its
electrodes were found elsewhere, and takes what was made for that.
"""

from eitskin_proto.errors import MismatchError
from eitskin_proto.files.arrays import Arrays, text
from eitskin_proto.files.plain import stated
from eitskin_proto.sensor.ids import PROTOCOL_ID
from eitskin_proto.skin.skin import PAPER, Skin


def check_made_for(what: str, skin: Skin, *, grid_id: object, skin_digest: object, hint: str) -> None:
    """Refuse what was made for another skin.

    Args:
        what: What to call it: a path, mostly.
        skin: The one in use.
        grid_id: What it carries.
        skin_digest: What it carries; None if it is older than that, and the paper's.
        hint: What to do.

    Raises:
        MismatchError: With what was found and what was expected.
    """
    if skin_digest is None and grid_id == PAPER.grid_id:
        skin_digest = PAPER.digest
    if skin_digest == skin.calibrated_from != "":
        return  # calibrated before skins kept the grid_id that was stated
    if grid_id != skin.grid_id:
        expected = f"{skin.grid_id} ({skin.name})"
        raise MismatchError(f"{what}: grid_id", found=stated(grid_id), expected=expected, hint=hint)


def check_arrays_made_for(what: str, skin: Skin, arrays: Arrays, hint: str) -> None:
    """Refuse arrays of a file whose ``protocol_id``, ``grid_id`` or ``skin_digest`` is of another release or skin.

    Args:
        what: What to call them: a path, mostly.
        skin: The one in use.
        arrays: By name; those that it lacks are not held against anything. A digest without a ``grid_id`` must be that
            of a description which is known to be of this sheet.
        hint: What to do.

    Raises:
        MismatchError: With what was found and what was expected.
        ValueError: One of them is no text.
    """
    if "protocol_id" in arrays and (found := text(arrays, "protocol_id")) != PROTOCOL_ID:
        raise MismatchError(f"{what}: protocol_id", found=stated(found), expected=PROTOCOL_ID, hint=hint)
    given = {name: text(arrays, name) for name in ("grid_id", "skin_digest") if name in arrays}
    digest = given.get("skin_digest")
    if digest is not None and "grid_id" not in given and digest not in _of_this_sheet(skin):
        why = f"without grid_id nothing tells that it is of the same sheet; store that too, or {hint}"
        raise MismatchError(
            f"{what}: skin_digest", found=stated(digest), expected=f"{skin.digest} ({skin.name})", hint=why
        )
    check_made_for(what, skin, grid_id=given.get("grid_id", skin.grid_id), skin_digest=digest, hint=hint)


def _of_this_sheet(skin: Skin) -> set[str]:
    """Return digests of descriptions of a skin's sheet: its own, what it was calibrated from, and shipped ones."""
    from eitskin_proto.skin.toml import NAMED, named  # noqa: PLC0415 -- few files have a digest alone

    shipped = {one.digest for one in map(named, NAMED) if one.grid_id == skin.grid_id}
    return {skin.digest, skin.calibrated_from or skin.digest} | shipped
