"""Whether something that was made for one skin may be used with another: bundles, references, clouds, data.

What is made says which skin it is for: ``grid_id``, and ``skin_digest`` since skins have descriptions. What has no
``skin_digest`` is older than that, and the paper's. A skin that was calibrated is the one it was calibrated from, known
better: it takes what was made for that.
"""

from eitskin_proto.errors import MismatchError
from eitskin_proto.files.plain import stated
from eitskin_proto.skin.skin import PAPER, Skin


def check_made_for(what: str, skin: Skin, *, grid_id: object, skin_digest: object, hint: str) -> None:
    """Refuse what was made for another skin.

    Args:
        what: What to call it: a path, mostly.
        skin: The one in use.
        grid_id: What it carries.
        skin_digest: What it carries; None if it has none.
        hint: What to do.

    Raises:
        MismatchError: With what was found and what was expected.
    """
    if skin_digest is None and grid_id == PAPER.grid_id:
        skin_digest = PAPER.digest
    if skin_digest == skin.calibrated_from != "":
        return  # calibration may have moved the electrodes, and so changed grid_id
    if grid_id != skin.grid_id:
        raise MismatchError(f"{what}: grid_id", found=stated(grid_id), expected=skin.grid_id, hint=hint)
    if skin_digest != skin.digest:
        expected = f"{skin.digest} ({skin.name})"
        raise MismatchError(f"{what}: skin_digest", found=stated(skin_digest), expected=expected, hint=hint)
