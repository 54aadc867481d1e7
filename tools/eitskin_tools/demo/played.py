"""What the demonstration plays on: a bundle, and a sheet that it knows, touched as it knows touches."""

from math import isfinite
from pathlib import Path
from typing import Any

from eitskin_proto.errors import MismatchError
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_proto.skin.touch_kind import TouchKind, knows


def choose(bundle: Path | None, touches: TouchKind | None) -> tuple[Path | None, TouchKind]:
    """Return the bundle and the touches to show: presses as a finger's, where nothing is said and they are known.

    Args:
        bundle: What was named; None for a shipped one.
        touches: What was named.

    Raises:
        BundleError: It cannot be read, or no shipped one knows these touches.
        MismatchError: The named one knows others.
    """
    from eitskin.model.bundle import default_path, load_bundle
    from eitskin.model.skin_in_use import knowing

    if touches is not None:
        return knowing(touches, bundle).path, touches
    if bundle is None:
        pressed = default_path("area", "lowering")
        return (pressed, "lowering") if pressed.exists() else (None, "raising")
    return bundle, "raising" if load_bundle(bundle, lazily=True).touch_kind == "raising" else "lowering"


def skin_of(bundle: Path | None, touches: TouchKind = "raising") -> Skin:
    """Return the sheet that is played on: the paper's ideal one where the bundle is for it, else the bundle's own.

    Args:
        bundle: A bundle; None for the shipped one.
        touches: "raising" or "lowering"; a bundle knows both, or these.

    Raises:
        BundleError: It cannot be read.
        MismatchError: It knows other touches.
    """
    from eitskin.model.bundle import load_bundle

    found = load_bundle(bundle, lazily=True)
    if not knows(found.touch_kind, touches):
        hint = "show those that it knows: --touches"
        raise MismatchError(f"{found.path}: touches", found=found.touch_kind, expected=touches, hint=hint)
    return (PAPER if found.skin.grid_id == PAPER.grid_id else found.skin).touched(touches)


def uses_prediction(bundle: Path | None) -> bool:
    """Return whether a bundle's network takes V_pred."""
    from eitskin.model.bundle import load_bundle

    return bool(load_bundle(bundle, lazily=True).uses_prediction)


def script_of(scene: Path | None, bundle: Path | None, touches: TouchKind) -> Any:
    """Return the script that the virtual skin plays."""
    from eitskin_tools.scripted_scene import script

    return script.script_of(scene, skin_of(bundle, touches))


def told(script: Any) -> str:
    """Return for people what the demonstration's touches do to conductance; nothing of a scene's, which says itself."""
    from eitskin_tools.scripted_scene.choreography import LOWERED, RAISED

    if not isfinite(script.period_s):
        return ""
    if script.skin.touch_kind == "raising":
        return f", where conductance is {RAISED:g} times as high"
    return f", as of a finger: conductance falls to {100 * LOWERED:g} %"
