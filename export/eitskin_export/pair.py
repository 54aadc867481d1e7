"""Puts another network into a bundle, in addition to its own.

An additional network is a smaller one, the solver ``vd2t-small``, to which a stream switches before it switches to a
matrix; or one for gentle touches, which draws those that the bundle's own hardly shows (:mod:`eitskin.model.gentle`).
All were trained on the same kind of touch on the same skin. Two graphs are copied from its bundle, with the head in 8
bits if its maps are nearly the same; gate, projection and statistics of healthy frames stay the bundle's own. The
manifest's ``small`` or ``gentle`` names their origin, with their card.
"""

from pathlib import Path
from typing import Any, Final

from eitskin.errors import BundleError
from eitskin.model.bundle import Bundle, graphs_of, load_bundle
from eitskin.model.engine import HEADS, QUANTISED, default_solver, flipped_pixels, solvers
from eitskin.model.manifest import GENTLE, SMALL
from eitskin_export.bundle import read, write
from eitskin_proto.errors import SkinError

CARD: Final = ("card", "phantoms", "int8", "held_out")
"""The metrics that are kept of an additional network."""

FLIPPED_PIXELS: Final = 2.0
"""The head of an additional network is used in 8 bits if fewer pixels than this change sides of one half: it must be
fast. The bundle's own head has half this limit."""


def pair(bundle: Path, other: Path, out: Path, name: str = SMALL) -> dict[str, Any]:
    """Write a bundle with another additional network, in place of an earlier one, and return a report.

    Args:
        bundle: The bundle that goes on as it is.
        other: A bundle of the same skin, labels and touches.
        out: Where; may be ``bundle``.
        name: Of the additional network: ``small`` or ``gentle``.

    Returns:
        path, bundle and bytes of the new one; ``large_head_bytes`` and ``small_head_bytes`` or ``gentle_head_bytes``
        that a frame reads.

    Raises:
        SkinError: They do not go together, or one is no whole bundle.
        OSError: A file cannot be read or written.
    """
    whole, part = _that_go_together(bundle, other)
    head = _fast_head(part)
    own_bytes, its_bytes = len(whole.files[HEADS[default_solver(whole)]]), len(part.files[head])
    if name == SMALL and its_bytes >= own_bytes:
        raise SkinError(
            f"{other}: {head} has {its_bytes} bytes, expected fewer than the {own_bytes} of {bundle}; "
            "name the smaller one second"
        )
    files, facts, skin = read(bundle)
    files |= dict(zip(graphs_of(name), (part.files["geometry.onnx"], part.files[head]), strict=True))
    metrics = part.manifest.get("metrics", {})
    about = {
        "bundle": part.id,
        "bias": part.bias_width,
        "head": head,
        "recipe": part.manifest.get("recipe"),
        "metrics": {kept: metrics[kept] for kept in CARD if kept in metrics},
    }
    identity = write(out, files, {**facts, name: about}, skin)
    return {
        "path": str(out),
        "bundle": identity,
        "bytes": out.stat().st_size,
        "large_head_bytes": own_bytes,
        f"{name}_head_bytes": its_bytes,
    }


def carried(bundle: Path, other: Path, out: Path, name: str = GENTLE) -> str:
    """Write a bundle with another bundle's additional network, unchanged; return the new one's id.

    Args:
        bundle: The bundle that goes on as it is.
        other: A bundle with such a network.
        out: Where; may be ``bundle``.
        name: Of that network.

    Raises:
        SkinError: One is no whole bundle.
        OSError: A file cannot be read or written.
    """
    whole = load_bundle(other)
    files, facts, skin = read(bundle)
    files |= {file: whole.files[file] for file in graphs_of(name)}
    return write(out, files, {**facts, name: whole.manifest[name]}, skin)


def _fast_head(part: Bundle) -> str:
    """Return the member of a bundle's head to use when its network is additional to another."""
    names = solvers(part)
    few = QUANTISED in names and flipped_pixels(part) < FLIPPED_PIXELS
    return HEADS[QUANTISED] if few else HEADS[names[0]]


def _that_go_together(one: Path, other: Path) -> tuple[Bundle, Bundle]:
    """Return two bundles, or refuse them where they do not answer the same question in the same way."""
    try:
        large, small = load_bundle(one), load_bundle(other)
    except BundleError as error:
        raise SkinError(str(error)) from error
    for what, found, expected in (
        ("skin", small.skin.digest, large.skin.digest),
        ("labels", small.labels, large.labels),
        ("touches", small.touch_kind, large.touch_kind),
        ("head.inputs", small.manifest["head"]["inputs"], large.manifest["head"]["inputs"]),
    ):
        if found != expected:
            raise SkinError(
                f"{small.path}: {what} found {found}, expected {expected} as in {large.path}; build it with the "
                "larger one's skin and touches"
            )
    return large, small
