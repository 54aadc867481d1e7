"""Chooses the bundle and the skin that go together.

A bundle is used with its own skin, or with another description of the same sheet. If no bundle is named, the shipped
one that knows the skin's touches is used.
"""

from pathlib import Path

from eitskin.errors import BundleError, MismatchError
from eitskin.model.bundle import Bundle, default_path, load_bundle
from eitskin_proto.skin.made_for import check_made_for
from eitskin_proto.skin.skin import Skin
from eitskin_proto.skin.touch_kind import TouchKind, knows

SkinChoice = Skin | str | Path | None
"""A description, or the path of its file; None for the bundle's."""


def bundle_and_skin(
    bundle: Bundle | str | Path | None, wanted: SkinChoice, touches: TouchKind | None = None
) -> tuple[Bundle, Skin]:
    """Return a bundle, read if it is a path or a shipped one, and the skin to use with it.

    Args:
        bundle: The path or name of one, which must know the skin's touches where these lower conductance; one that was
            chosen and read, which is taken; None takes the shipped one that knows the skin's touches.
        wanted: See :func:`use_skin`.
        touches: Which touches the bundle must know, whatever the skin says; None for the skin's.

    Raises:
        BundleError: See :func:`eitskin.model.bundle.load_bundle`, and :func:`knowing`.
        MismatchError: The bundle that is named knows only touches that raise conductance, and the skin's lower it; see
            also there, and :func:`use_skin`.
        ValueError: The skin's file is wrong.
        OSError: There is no such file.
    """
    skin = None if wanted is None else _read(wanted)
    if touches is not None:
        bundle = knowing(touches, bundle)
    if isinstance(bundle, Bundle):
        return bundle, use_skin(bundle, skin)
    if bundle is None:
        found = knowing("raise" if skin is None else skin.touch_kind)
        return found, use_skin(found, skin)
    found = load_bundle(bundle, lazily=True)
    used = use_skin(found, skin)
    if skin is not None:
        check_touches(found, skin)
    return found, used


def check_touches(bundle: Bundle, skin: Skin) -> None:
    """Refuse a bundle that would miss every touch of a skin; a file that says nothing has touches that raise.

    Raises:
        MismatchError: The skin's touches lower conductance, and the bundle does not know such.
    """
    if skin.touch_kind != "lower" or knows(bundle.touch_kind, "lower"):
        return
    expected = f"lower, from [touches] of skin {skin.name}"
    hint = "take a bundle that knows them, or make one: eitskin build SKIN.toml --out FILE.eitskin"
    raise MismatchError(f"{bundle.path}: touches", found=bundle.touch_kind, expected=expected, hint=hint)


def knowing(touches: TouchKind, bundle: Bundle | str | Path | None = None) -> Bundle:
    """Return a bundle that knows some touches.

    Args:
        touches: Which way they change conductance; for both ways, a bundle that knows those that raise it will do.
        bundle: A bundle, its file or name; None takes the shipped one.

    Raises:
        ValueError: There are no such touches.
        BundleError: None that is shipped knows them, or one cannot be read.
        MismatchError: The file's bundle knows others; or see :func:`eitskin.model.bundle.load_bundle`.
    """
    own = default_path("area", touches)
    named = bundle or (own if own.exists() else default_path())
    found = named if isinstance(named, Bundle) else load_bundle(named, lazily=True)
    if knows(found.touch_kind, "raise" if touches == "both" else touches):
        return found
    make = "make one: eitskin build SKIN.toml --out FILE.eitskin"
    if bundle is None:
        raise BundleError(
            f"no shipped bundle detects touches that {touches} conductance ({own} is missing): name one with "
            f"--bundle, or {make}"
        )
    hint = f"name another, or {make}"
    raise MismatchError(f"{found.path}: touches", found=found.touch_kind, expected=touches, hint=hint)


def use_skin(bundle: Bundle, wanted: SkinChoice) -> Skin:
    """Return the skin to use with a bundle: its own, another description of the same sheet, or that sheet calibrated.

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
    skin = _read(wanted)
    hint = "take a bundle of this skin, or make one: eitskin build SKIN.toml --out FILE.eitskin"
    own = bundle.skin
    check_made_for(str(bundle.path), skin, grid_id=own.grid_id, skin_digest=own.digest, hint=hint)
    if own.grid != skin.grid:
        raise MismatchError(f"{bundle.path}: sheet and map", found=own.grid, expected=skin.grid, hint=hint)
    return skin


def _read(wanted: Skin | str | Path) -> Skin:
    from eitskin_proto.skin import toml  # noqa: PLC0415 -- few need it

    return wanted if isinstance(wanted, Skin) else toml.load(wanted)
