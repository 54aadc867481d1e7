"""Another network in a bundle: a smaller one besides, or one that learned on in place of its own.

A smaller one is the solver ``vd2t-small``, what a stream falls to before it falls to a matrix. Both learned the same
kind of touch on the same skin. Of its bundle two graphs are taken, the head in 8 bits where nearly the same is shown;
gate, projection and what healthy frames look like stay the larger one's. The manifest's ``small`` says where they are
from, with their card.

One that takes the place of the bundle's own brings its graphs and what is known of them. Gate, projection and healthy
frames ask nothing of a network, and stay.
"""

from pathlib import Path
from typing import Any, Final

from eitskin.errors import BundleError
from eitskin.model.bundle import OF_SMALL, Bundle, load_bundle
from eitskin.model.engine import HEADS, QUANTISED, default_solver, flipped_pixels, solvers
from eitskin_export.bundle import read, write
from eitskin_proto.errors import SkinError

CARD: Final = ("card", "phantoms", "int8", "held_out")
"""What is kept of the smaller one's metrics."""

GRAPHS: Final = ("geometry.onnx", "head.onnx", "head_int8.onnx")
"""A network's members."""

OF_NETWORK: Final = ("head", "recipe", "seeds", "data_digest", "training", "build")
"""What a manifest says of its network."""

OF_FRAMES: Final = ("electrodes",)
"""Of a manifest's metrics, what is not of the network."""

FLIPPED_PIXELS: Final = 2.0
"""A smaller head is taken in 8 bits where these show fewer pixels than this on the other side of half height: it is
there to be fast, where a larger one's rule is half as much."""


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
    whole, part = _that_go_together(large, small)
    chosen = {"large": HEADS[default_solver(whole)], "small": _fast_head(part)}
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


def replaced(bundle: Path, newer: Path, out: Path) -> dict[str, Any]:
    """Write a bundle with another's network in place of its own, and return what was done.

    Args:
        bundle: Whose gate, projection and healthy frames stay. A smaller network that it had is left out.
        newer: A bundle of the same skin, labels and touches.
        out: Where; may be ``bundle``.

    Returns:
        path, bundle and bytes of the new one; ``large_head_bytes`` that a frame reads.

    Raises:
        SkinError: They do not go together, or one is no whole bundle.
        OSError: A file cannot be read or written.
    """
    _, after = _that_go_together(bundle, newer)
    files, facts, skin = read(bundle)
    files = {name: data for name, data in files.items() if name not in (*GRAPHS, *OF_SMALL)}
    files |= {name: after.files[name] for name in GRAPHS if name in after.files}
    facts = {name: value for name, value in facts.items() if name not in ("small", *OF_NETWORK)}
    facts |= {name: after.manifest[name] for name in OF_NETWORK if name in after.manifest}
    own = facts.get("metrics", {})
    metrics = {name: one for name, one in after.manifest.get("metrics", {}).items() if name not in OF_FRAMES}
    facts["metrics"] = metrics | {name: own[name] for name in OF_FRAMES if name in own}
    identity = write(out, files, facts, skin)
    head = files[HEADS[default_solver(load_bundle(out))]]
    return {"path": str(out), "bundle": identity, "bytes": out.stat().st_size, "large_head_bytes": len(head)}


def _fast_head(part: Bundle) -> str:
    """Return the member of a smaller network's head that is taken."""
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
