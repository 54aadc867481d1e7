"""Checks whether a bundle, reference, cloud or data set of one skin fits another skin.

Both must have the same sheet: size, map and electrode places, which ``grid_id`` identifies. The rest of a description
may differ, because it only says how well the sheet is known and what touches it. So a network trained on random devices
of a sheet fits every such sheet.

A calibrated skin keeps the ``grid_id`` of the original, even if its electrodes moved, and accepts what was made for it.
"""

from eitskin_proto.errors import MismatchError
from eitskin_proto.files.arrays import Arrays, text
from eitskin_proto.files.plain import stated
from eitskin_proto.sensor.ids import PROTOCOL_ID
from eitskin_proto.skin.skin import PAPER, Skin


def check_made_for(what: str, skin: Skin, *, grid_id: object, skin_digest: object, hint: str) -> None:
    """Refuse an artefact of another skin.

    Args:
        what: Name of the artefact in the message, such as its path.
        skin: The skin in use.
        grid_id: The artefact's ``grid_id``.
        skin_digest: The artefact's ``skin_digest``; None for old ones of the paper's skin.
        hint: What the user can do.

    Raises:
        MismatchError: The skins differ; with both ids.
    """
    if skin_digest is None and grid_id == PAPER.grid_id:
        skin_digest = PAPER.digest
    if skin_digest == skin.calibrated_from != "":
        return  # calibrated before skins kept the grid_id that was stated
    if grid_id != skin.grid_id:
        length, width = skin.outline.size_mm
        expected = f"{skin.grid_id} of skin {skin.name!r}, {length:g} x {width:g} mm"
        raise MismatchError(f"{what}: grid_id", found=stated(grid_id), expected=expected, hint=hint)


def check_arrays_made_for(what: str, skin: Skin, arrays: Arrays, hint: str) -> None:
    """Refuse arrays of a file whose ``protocol_id``, ``grid_id`` or ``skin_digest`` is of another release or skin.

    Args:
        what: Name of the file in the message, such as its path.
        skin: The skin in use.
        arrays: Arrays by name; missing ids are not checked. A digest without a ``grid_id`` must be the skin's.
        hint: What the user can do.

    Raises:
        MismatchError: An id differs; with both ids.
        ValueError: An id is not a text.
    """
    if "protocol_id" in arrays and (found := text(arrays, "protocol_id")) != PROTOCOL_ID:
        raise MismatchError(f"{what}: protocol_id", found=stated(found), expected=PROTOCOL_ID, hint=hint)
    given = {name: text(arrays, name) for name in ("grid_id", "skin_digest") if name in arrays}
    digest = given.get("skin_digest")
    if digest is not None and "grid_id" not in given and digest not in (skin.digest, skin.calibrated_from):
        why = f"without grid_id nothing shows that it belongs to the same sheet; store grid_id too, or {hint}"
        raise MismatchError(
            f"{what}: skin_digest", found=stated(digest), expected=f"{skin.digest} ({skin.name})", hint=why
        )
    check_made_for(what, skin, grid_id=given.get("grid_id", skin.grid_id), skin_digest=digest, hint=hint)
