"""Which skin a bundle is used with: its own, or one that its owner knows better by now."""

from pathlib import Path

from eitskin.errors import MismatchError
from eitskin.model.bundle import Bundle, load_bundle
from eitskin_proto.skin.made_for import check_made_for
from eitskin_proto.skin.skin import Skin

Given = Skin | str | Path | None
"""A description, or the path of its file; None for the bundle's."""


def bundle_and_skin(bundle: Bundle | str | Path | None, wanted: Given) -> tuple[Bundle, Skin]:
    """Return a bundle, read if it is a path or the shipped one, and the skin to use with it.

    Raises:
        BundleError: See :func:`eitskin.model.bundle.load_bundle`.
        MismatchError: See there, and :func:`use_skin`.
        ValueError: The skin's file is wrong.
        OSError: There is no such file.
    """
    found = bundle if isinstance(bundle, Bundle) else load_bundle(bundle, lazily=True)
    return found, use_skin(found, wanted)


def use_skin(bundle: Bundle, wanted: Given) -> Skin:
    """Return the skin to use with a bundle: the bundle's own, or one that is the same, or the same known better.

    Args:
        bundle: A bundle.
        wanted: A description, or the path of its file; None for the bundle's.

    Raises:
        MismatchError: The bundle was made for another one.
        ValueError: The file's content is wrong.
        OSError: There is no such file.
    """
    if wanted is None:
        return bundle.skin
    from eitskin_proto.skin import toml  # noqa: PLC0415 -- few need it

    skin = wanted if isinstance(wanted, Skin) else toml.load(wanted)
    hint = "take a bundle of this skin, or make one: eitskin build SKIN.toml --out FILE.eitskin"
    own = bundle.skin
    check_made_for(str(bundle.path), skin, grid_id=own.grid_id, skin_digest=own.digest, hint=hint)
    if own.grid != skin.grid:
        raise MismatchError(f"{bundle.path}: sheet and map", found=own.grid, expected=skin.grid, hint=hint)
    return skin
