"""The file that ``eitskin surface`` writes: a cloud, its skin and, if requested, its prediction.

::

    CLOUD.npz   magic "eitskin-cloud", version 1, grid_id, skin_digest, cloud (3, rows, columns) float64 mm, laid
                on the flat sheet
                rotation (3, 3), translation_mm (3,): what laid it there, cloud = rotation points + translation_mm
                predicted, predicted_flat (104,) float64 V under 1 A: with --predict
                for people: size_mm, noise_mm, outline_sigma_mm, corner
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
"""Tolerance for a rotation's unit lengths and right angles."""


class CloudFileError(SkinError):
    """A file that holds no cloud."""


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """A cloud and its prediction."""

    cloud_mm: Array
    """(3, rows, columns), aligned with the flat sheet."""
    predicted_V: Array | None = None
    """(104,), V_pred under 1 A; None without a prediction."""
    predicted_flat_V: Array | None = None
    """(104,), voltages of the same model's flat sheet; None without a prediction."""
    rotation: Array | None = None
    """(3, 3), rotation from the measured points to ``cloud_mm``; None if unknown."""
    translation_mm: Array | None = None
    """(3,), translation after the rotation; None if unknown."""

    @property
    def measured_mm(self) -> Array:
        """(3, rows, columns), the cloud in the frame of the measured points; ``cloud_mm`` if that is unknown."""
        if self.rotation is None or self.translation_mm is None:
            return self.cloud_mm
        moved = self.cloud_mm - self.translation_mm[:, None, None]
        return np.asarray(np.einsum("ji,jrc->irc", self.rotation, moved))


def save_surface(
    path: str | Path, surface: Surface, about: Mapping[str, Any] | None = None, skin: Skin = PAPER
) -> None:
    """Write a cloud file.

    Args:
        path: The file.
        surface: The cloud and its prediction.
        about: Further fields, for people.
        skin: The skin of the surface.

    Raises:
        FileError: The path is not a regular file.
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
    """Return cloud and prediction of a file that ``eitskin surface`` wrote.

    Args:
        path: The file.
        skin: The expected skin.

    Raises:
        CloudFileError: The file cannot be read, or holds no cloud.
        MismatchError: The cloud belongs to another skin.
    """
    try:
        file = read_npz(path, LARGEST_FILE)
        if str(file["magic"]) != MAGIC:
            raise CloudFileError(f"{path} is not a cloud: make one with 'eitskin surface'")
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
        raise CloudFileError(f"{path} is not a cloud ({error}): make one with 'eitskin surface'") from error


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
