"""A smaller network in a bundle, as its solver ``vd2t-small``: what a stream falls to before it falls to a matrix.

Both learned the same kind of touch on the same skin. Of the smaller one's bundle its two graphs are taken, the head in
8 bits where its card says that it shows the same; gate, projection and what healthy frames look like stay the larger
one's. The manifest's ``small`` says where they are from, with their card.
"""

from pathlib import Path
from typing import Any

from eitskin.errors import BundleError
from eitskin.model.bundle import OF_SMALL, Bundle, load_bundle
from eitskin.model.engine import HEADS, default_solver
from eitskin_export.bundle import read, write
from eitskin_proto.errors import SkinError

CARD = ("card", "phantoms", "int8", "held_out")
"""What is kept of the smaller one's metrics."""


def pair(large: Path, small: Path, out: Path) -> dict[str, Any]:
    """Write a bundle with a smaller network besides, in place of one that it had, and return what was done.

    Args:
        large: The bundle that goes on as it is.
        small: A bundle of the same skin, labels and touches.
        out: Where; may be ``large``.

    Returns:
        path, bundle and bytes of the new one; ``large_head_bytes`` and ``small_head_bytes`` that a frame reads.

    Raises:
        SkinError: They do not go together, or one is no whole bundle.
        OSError: A file cannot be read or written.
    """
    try:
        whole, part = load_bundle(large), load_bundle(small)
    except BundleError as error:
        raise SkinError(str(error)) from error
    _check(whole, part)
    chosen = {name: HEADS[default_solver(one)] for name, one in (("large", whole), ("small", part))}
    sizes = {name: len(one.files[chosen[name]]) for name, one in (("large", whole), ("small", part))}
    if sizes["small"] >= sizes["large"]:
        raise SkinError(
            f"{small}: {chosen['small']} has {sizes['small']} bytes, expected fewer than the {sizes['large']} of "
            f"{large}; name the smaller one second"
        )
    files, facts, skin = read(large)
    for name in OF_SMALL:
        files.pop(name, None)
    files |= dict(zip(OF_SMALL, (part.files["geometry.onnx"], part.files[chosen["small"]]), strict=True))
    metrics = part.manifest.get("metrics", {})
    about = {
        "bundle": part.id,
        "bias": part.bias_width,
        "head": chosen["small"],
        "recipe": part.manifest.get("recipe"),
        "metrics": {name: metrics[name] for name in CARD if name in metrics},
    }
    identity = write(out, files, {**facts, "small": about}, skin)
    return {
        "path": str(out),
        "bundle": identity,
        "bytes": out.stat().st_size,
        "large_head_bytes": sizes["large"],
        "small_head_bytes": sizes["small"],
    }


def _check(large: Bundle, small: Bundle) -> None:
    """Refuse two bundles that do not answer the same question in the same way."""
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
