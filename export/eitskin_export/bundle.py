"""Writes the file that the runtime loads: graphs, projection, gate and a manifest with their checksums.

A bundle is a ZIP whose members are stored, not compressed (weights do not shrink) ::

    manifest.json    format, version, ids, sha256 of every other member, recipe, seeds, metrics
    skin.toml        its skin; the digest and the grid's id are in the manifest
    geometry.onnx    cloud -> bias            head.onnx        dv, bias -> map
    head_int8.onnx   the same, 8-bit          tikhonov.npy     (pixels, 104) projection on the flat sheet
    gate.npz         the touch gate

Its id is the first 16 hex digits of the manifest's sha256, so the id identifies every byte. Members carry a fixed
date, so the same contents give the same file.
"""

import io
import json
import zipfile
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin.model.bundle import SKIN_FILE, load_bundle
from eitskin_proto.files.digest import id_of, sha256_of
from eitskin_proto.files.writing import replacing
from eitskin_proto.sensor.ids import PROTOCOL_ID
from eitskin_proto.sensor.table import N_ROWS
from eitskin_proto.skin.grid import Grid
from eitskin_proto.skin.skin import Skin
from eitskin_proto.skin.toml import to_toml

VERSION: Final = 1
"""Version of the manifest."""

MANIFEST: Final = "manifest.json"
"""The member that lists the others."""

_DATE: Final = (1980, 1, 1, 0, 0, 0)


def projection_bytes(projection: npt.NDArray[np.floating], grid: Grid) -> bytes:
    """Return a projection as the bytes of a float32 .npy file.

    Raises:
        ValueError: The shape is not (pixels, 104), or a value is not finite.
    """
    if projection.shape != (grid.n_pixels, N_ROWS) or not np.isfinite(projection).all():
        raise ValueError(
            f"projection has shape {projection.shape}; expected ({grid.n_pixels}, {N_ROWS}) finite numbers"
        )
    buffer = io.BytesIO()
    np.save(buffer, projection.astype("<f4"))
    return buffer.getvalue()


def manifest(files: dict[str, bytes], facts: dict[str, Any], skin: Skin) -> bytes:
    """Return the manifest of some members.

    Args:
        files: Name and contents of every other member.
        facts: What else to state: labels, head, gate, recipe, seeds, metrics and so on.
        skin: What it is for.
    """
    content = {
        "format": "eitskin-bundle",
        "version": VERSION,
        "protocol_id": PROTOCOL_ID,
        "grid_id": skin.grid_id,
        "skin_digest": skin.digest,
        **facts,
        "files": {name: {"sha256": sha256_of(data), "bytes": len(data)} for name, data in files.items()},
    }
    return (json.dumps(content, indent=1, allow_nan=False) + "\n").encode()


def write(path: Path, files: dict[str, bytes], facts: dict[str, Any], skin: Skin) -> str:
    """Write a bundle in one rename and return its id.

    Args:
        path: Where; by custom it ends in ``.eitskin``.
        files: Name and contents of every member but the manifest and the skin.
        facts: See :func:`manifest`.
        skin: What it is for.
    """
    files = {SKIN_FILE: to_toml(skin).encode(), **files}
    head = manifest(files, facts, skin)
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as stream, zipfile.ZipFile(stream, "w", zipfile.ZIP_STORED) as archive:
        for name, data in {MANIFEST: head, **files}.items():
            archive.writestr(zipfile.ZipInfo(name, date_time=_DATE), data)
    return id_of(head)


def read(path: Path) -> tuple[dict[str, bytes], dict[str, Any], Skin]:
    """Return the members of a bundle, its facts and its skin, as :func:`write` took them.

    Raises:
        BundleError: A member is missing or is not the one that the manifest vouches for.
        OSError: The file cannot be read.
    """
    found = load_bundle(path, lazily=True)
    files, facts = dict(found.files), {**found.manifest}
    del facts["files"]
    for name in ("format", "version", "protocol_id", "grid_id", "skin_digest"):
        facts.pop(name, None)
    files.pop(SKIN_FILE, None)
    return files, facts, found.skin


def amend(path: Path, metrics: dict[str, Any]) -> str:
    """Add metrics to a bundle's card, the graphs as they are, and return its new id.

    Args:
        path: The bundle; replaced in one rename.
        metrics: What to add to, or replace in, the manifest's ``metrics``.

    Raises:
        SkinError: It is no whole bundle.
        OSError: The file cannot be read or written.
    """
    files, facts, skin = read(path)
    return write(path, files, {**facts, "metrics": {**facts.get("metrics", {}), **metrics}}, skin)
