"""Writes the one file that the runtime loads: graphs, projection, gate and a manifest that can vouch for all of them.

A bundle is a ZIP whose members are stored, not compressed (weights do not shrink) ::

    manifest.json    format, version, ids, sha256 of every other member, recipe, seeds, metrics
    geometry.onnx    cloud -> bias            head.onnx        dv, bias -> map
    head_int8.onnx   the same, 8-bit          tikhonov.npy     (1350, 104) projection on the flat sheet
    gate.npz         touched or not

Its id is the first 16 hex digits of the manifest's sha256: whoever has the id has every byte. Members carry a fixed
date, so the same contents give the same file.
"""

import io
import json
import zipfile
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin.errors import BundleError
from eitskin.model.bundle import load_bundle
from eitskin_proto.errors import SkinError
from eitskin_proto.files.digest import id_of, sha256_of
from eitskin_proto.files.writing import replacing
from eitskin_proto.sensor.grid import N_PIXELS
from eitskin_proto.sensor.ids import GRID_ID, PROTOCOL_ID
from eitskin_proto.sensor.table import N_ROWS

VERSION: Final = 1
"""Version of the manifest."""

MANIFEST: Final = "manifest.json"
"""The member that lists the others."""

_DATE: Final = (1980, 1, 1, 0, 0, 0)


def projection_bytes(projection: npt.NDArray[np.floating]) -> bytes:
    """Return a projection as the bytes of a float32 .npy file.

    Raises:
        ValueError: The shape is not (1350, 104), or a value is not finite.
    """
    if projection.shape != (N_PIXELS, N_ROWS) or not np.isfinite(projection).all():
        raise ValueError(f"projection has shape {projection.shape}; expected ({N_PIXELS}, {N_ROWS}) finite numbers")
    buffer = io.BytesIO()
    np.save(buffer, projection.astype("<f4"))
    return buffer.getvalue()


def manifest(files: dict[str, bytes], facts: dict[str, Any]) -> bytes:
    """Return the manifest of some members.

    Args:
        files: Name and contents of every other member.
        facts: What else to state: labels, head, gate, recipe, seeds, metrics and so on.
    """
    content = {
        "format": "eitskin-bundle",
        "version": VERSION,
        "protocol_id": PROTOCOL_ID,
        "grid_id": GRID_ID,
        **facts,
        "files": {name: {"sha256": sha256_of(data), "bytes": len(data)} for name, data in files.items()},
    }
    return (json.dumps(content, indent=1, allow_nan=False) + "\n").encode()


def write(path: Path, files: dict[str, bytes], facts: dict[str, Any]) -> str:
    """Write a bundle in one rename and return its id.

    Args:
        path: Where; by custom it ends in ``.eitskin``.
        files: Name and contents of every member but the manifest.
        facts: See :func:`manifest`.
    """
    head = manifest(files, facts)
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as stream, zipfile.ZipFile(stream, "w", zipfile.ZIP_STORED) as archive:
        for name, data in {MANIFEST: head, **files}.items():
            archive.writestr(zipfile.ZipInfo(name, date_time=_DATE), data)
    return id_of(head)


def read(path: Path) -> tuple[dict[str, bytes], dict[str, Any]]:
    """Return the members of a bundle and its facts, as :func:`write` took them.

    Raises:
        SkinError: A member is missing or is not the one that the manifest vouches for.
        OSError: The file cannot be read.
    """
    try:
        found = load_bundle(path, lazily=True)
        files, facts = dict(found.files), {**found.manifest}
    except BundleError as error:
        raise SkinError(f"{path} is no bundle ({error}); make one with 'eitskin export'") from error
    del facts["files"]
    for name in ("format", "version", "protocol_id", "grid_id"):
        del facts[name]
    return files, facts


def amend(path: Path, metrics: dict[str, Any]) -> str:
    """Add metrics to a bundle's card, the graphs as they are, and return its new id.

    Args:
        path: The bundle; replaced in one rename.
        metrics: What to add to, or replace in, the manifest's ``metrics``.

    Raises:
        SkinError: It is no whole bundle.
        OSError: The file cannot be read or written.
    """
    files, facts = read(path)
    return write(path, files, {**facts, "metrics": {**facts.get("metrics", {}), **metrics}})
