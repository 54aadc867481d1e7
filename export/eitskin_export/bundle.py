"""Writes the one file that the runtime loads: graphs, projection, gate and a manifest that can vouch for all of them.

A bundle is a ZIP whose members are stored, not compressed (weights do not shrink) ::

    manifest.json    format, version, ids, sha256 of every other member, recipe, seeds, metrics
    geometry.onnx    cloud -> bias            head.onnx        dv, bias -> map
    head_int8.onnx   the same, 8-bit          tikhonov.npy     (1350, 104) projection on the flat sheet
    gate.npz         touched or not

Its id is the first 16 hex digits of the manifest's sha256: whoever has the id has every byte. Members carry a fixed
date, so the same contents give the same file.
"""

import hashlib
import io
import json
import os
import zipfile
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.grid import N_PIXELS
from eitskin_proto.ids import GRID_ID, PROTOCOL_ID
from eitskin_proto.table import N_ROWS

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
        "files": {
            name: {"sha256": hashlib.sha256(data).hexdigest(), "bytes": len(data)} for name, data in files.items()
        },
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
    beside = path.with_name(path.name + ".new")
    with zipfile.ZipFile(beside, "w", zipfile.ZIP_STORED) as archive:
        for name, data in {MANIFEST: head, **files}.items():
            archive.writestr(zipfile.ZipInfo(name, date_time=_DATE), data)
    os.replace(beside, path)
    return hashlib.sha256(head).hexdigest()[:16]
