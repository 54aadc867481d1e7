"""The file between ``eitskin surface`` and the runtime: a cloud, its prediction where there is one, and its skin.

::

    CLOUD.npz   magic "eitskin-cloud", version 1, grid_id, skin_digest, cloud (3, rows, columns) float64 mm, laid
                on the flat sheet
                rotation (3, 3), translation_mm (3,): what laid it there, cloud = rotation points + translation_mm
                predicted, predicted_flat (104,) float64 V under 1 A: only where they were asked for (--predict)
                and how it was found, for people: size_mm, noise_mm, outline_sigma_mm, corner
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.errors import SkinError
from eitskin_proto.files.arrays import read_npz
from eitskin_proto.files.writing import replacing
from eitskin_proto.sensor.table import N_ROWS
from eitskin_proto.skin.cloud import align_cloud, check_cloud
from eitskin_proto.skin.made_for import check_made_for
from eitskin_proto.skin.skin import PAPER, Skin

Array = npt.NDArray[np.float64]

MAGIC: Final = "eitskin-cloud"
"""First word of a cloud file."""

VERSION: Final = 1
"""Layout of a cloud file."""

LARGEST_FILE: Final = 1 << 20
"""Bytes; the paper's cloud has 36,000, the largest skin's 350,000."""


EXACT: Final = 1e-6
"""What a rotation's rows may be off unit length and right angles."""


class CloudFileError(SkinError):
    """A file that holds no cloud."""


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """A cloud and what the forward model says of it."""

    cloud_mm: Array
    """(3, rows, columns)"""
    predicted_V: Array | None = None
    """(104,) V_pred under 1 A, or None where nothing was predicted."""
    predicted_flat_V: Array | None = None
    """(104,) of the same model's flat sheet; there where a prediction is."""
    rotation: Array | None = None
    """(3, 3) that turned the measured points before they were moved to where ``cloud_mm`` is; None if unknown."""
    translation_mm: Array | None = None
    """(3,) added then; there where the rotation is."""

    @property
    def measured_mm(self) -> Array:
        """(3, rows, columns) in the frame of the measured points; where that is unknown, ``cloud_mm`` as it is."""
        if self.rotation is None or self.translation_mm is None:
            return self.cloud_mm
        moved = self.cloud_mm - self.translation_mm[:, None, None]
        return np.asarray(np.einsum("ji,jrc->irc", self.rotation, moved))


def save_surface(
    path: str | Path, surface: Surface, about: Mapping[str, Any] | None = None, skin: Skin = PAPER
) -> None:
    """Write a cloud file.

    Args:
        path: Where.
        surface: What.
        about: More fields, for people.
        skin: Whose surface it is.

    Raises:
        FileError: It is no regular file.
        OSError: The file cannot be written.
    """
    fields: dict[str, Any] = {
        "magic": MAGIC,
        "version": VERSION,
        "grid_id": skin.grid_id,
        "skin_digest": skin.digest,
        "cloud": surface.cloud_mm,
    }
    if surface.rotation is not None and surface.translation_mm is not None:
        fields |= {"rotation": surface.rotation, "translation_mm": surface.translation_mm}
    if surface.predicted_V is not None and surface.predicted_flat_V is not None:
        fields |= {"predicted": surface.predicted_V, "predicted_flat": surface.predicted_flat_V}
    with replacing(path) as file:
        np.savez(file, **fields, **(about or {}))


def load_surface(path: str | Path, skin: Skin = PAPER) -> Surface:
    """Return the cloud of a file that ``eitskin surface`` wrote, and its prediction.

    Args:
        path: The file.
        skin: Whose surface is expected.

    Raises:
        CloudFileError: The file cannot be read, or is no cloud.
        MismatchError: The cloud was made for another skin.
    """
    try:
        file = read_npz(path, LARGEST_FILE)
        if str(file["magic"]) != MAGIC:
            raise CloudFileError(f"{path} is no cloud: make one with 'eitskin surface'")
        check_made_for(
            str(path),
            skin,
            grid_id=str(file["grid_id"]),
            skin_digest=str(file["skin_digest"]) if "skin_digest" in file else None,
            hint="run 'eitskin surface' again, for this skin",
        )
        predicted = [_rows(file[name]) if name in file else None for name in ("predicted", "predicted_flat")]
        cloud = check_cloud(file["cloud"], skin.grid)
        align_cloud(cloud, skin.grid)  # refuses what has no pose
        return Surface(cloud, *predicted, *_pose(file, cloud, skin))
    except OSError as error:
        raise CloudFileError(
            f"cloud file {path} cannot be read: {error.strerror or error}; make one with 'eitskin surface'"
        ) from error
    except (ValueError, KeyError, TypeError) as error:
        raise CloudFileError(f"{path} is no cloud ({error}): make one with 'eitskin surface'") from error


def _pose(file: Mapping[str, npt.NDArray[Any]], cloud: Array, skin: Skin) -> tuple[Array, Array] | tuple[None, None]:
    """Return how a cloud was laid on the flat sheet, where a file says it."""
    if "rotation" not in file or "translation_mm" not in file:
        return None, None
    rotation, translation = (np.asarray(file[name], dtype=np.float64) for name in ("rotation", "translation_mm"))
    if rotation.shape != (3, 3) or translation.shape != (3,) or not np.isfinite(translation).all():
        raise ValueError(
            f"a rotation {rotation.shape} and a translation {translation.shape}, expected finite (3, 3) and (3,)"
        )
    if not (np.abs(rotation @ rotation.T - np.eye(3)).max() < EXACT and np.linalg.det(rotation) > 0.0):
        raise ValueError("a rotation that stretches or mirrors, expected a proper one")
    check_cloud(Surface(cloud, None, None, rotation, translation).measured_mm, skin.grid)
    return rotation, translation


def _rows(values: npt.NDArray[Any]) -> Array:
    if values.shape != (N_ROWS,) or values.dtype.kind not in "fiu":
        raise ValueError(f"a prediction of shape {values.shape} and {values.dtype}, expected ({N_ROWS},) numbers")
    return np.asarray(values, dtype=np.float64)
