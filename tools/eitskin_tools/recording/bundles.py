"""Which bundle a recording was made with, and which reference: found among those that are shipped, or named."""

from pathlib import Path

from eitskin.model.bundle import Bundle, default_path, load_bundle
from eitskin.reference.captured import Reference, parsed
from eitskin_proto.errors import MismatchError
from eitskin_proto.skin.made_for import check_made_for
from eitskin_proto.skin.skin import Skin
from eitskin_proto.skin.touch_kind import TouchKind
from eitskin_tools.recording.layout import RecordingError
from eitskin_tools.recording.told import Told


def bundle_of(script: Told, named: str | Path | None = None) -> Bundle:
    """Return the bundle that a recording was made with.

    Args:
        script: The recording.
        named: A file, which may be another bundle of the same skin; None looks among those that are shipped.

    Raises:
        RecordingError: None that is shipped is the one that was running.
        MismatchError: The bundle is of another skin.
        BundleError: It cannot be read.
    """
    if named is not None:
        return for_skin(load_bundle(named), script)
    wanted = script.told("bundle")
    kinds: tuple[TouchKind, ...] = ("raise", "lower")
    paths = [default_path(labels, touches) for labels in ("area", "units") for touches in kinds]
    for path in paths:
        if path.exists() and (found := load_bundle(path, lazily=True)).id == wanted:
            return found
    raise RecordingError(
        f"{script.path} was made with bundle {wanted[:16]}, none of the shipped ones; name it with --bundle FILE"
    )


def for_skin(bundle: Bundle, script: Told) -> Bundle:
    """Return a bundle, or refuse it.

    Raises:
        MismatchError: It is of another skin than the recording.
    """
    own, grid_id = bundle.skin, script.told("grid_id")
    hint = "name a bundle of the skin that was recorded"
    if grid_id and grid_id != own.grid_id:
        raise MismatchError(f"{script.path}: grid_id", found=grid_id, expected=own.grid_id, hint=hint)
    reference = reference_of(script, script.reference())
    ids = {"grid_id": reference.grid_id, "skin_digest": reference.skin_digest}
    check_made_for(str(script.path), own, **ids, hint=hint)
    return bundle


def reference_of(script: Told, content: bytes, skin: Skin | None = None) -> Reference:
    """Return a recorded reference.

    Raises:
        BadReference: It cannot be used.
        MismatchError: It is of another device or configuration than the frames, or of another skin.
    """
    found = parsed(content, f"of {script.path}", "record anew", skin)
    found.check(script.hello)
    return found
