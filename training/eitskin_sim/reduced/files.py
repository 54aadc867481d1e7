"""Reduced models in files."""

from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.files.arrays import read_npz
from eitskin_proto.files.reading import FileError
from eitskin_proto.files.writing import replacing
from eitskin_proto.sensor.table import N_ELECTRODES
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.reduced.model import ReducedModel, cloud_digest

FORMAT: Final = "eitskin-reduced"
VERSION: Final = 1
LARGEST_FILE: Final = 64 << 20


class ReducedError(ValueError):
    """A reduced model's file is not one, or is of another sheet."""


def save(model: ReducedModel, path: str | Path) -> None:
    """Write a model to a file, 17 MB; H is symmetric, and kept whole."""
    with replacing(Path(path)) as file:
        np.savez(
            file,
            format=FORMAT,
            version=VERSION,
            coupling=model.coupling,
            loads=model.loads,
            untouched=model.untouched,
            contacts=model.contacts.astype(np.int64),
            polynomials=model.polynomials,
            skin_digest=model.skin_digest,
            grid_id=model.grid_id,
            cloud_digest=model.cloud_digest,
        )


def load(path: str | Path, skin: Skin = PAPER, cloud_mm: npt.ArrayLike | None = None) -> ReducedModel:
    """Return the model of a file.

    Args:
        path: As :func:`save` wrote it.
        skin: Whose sheet it must be of.
        cloud_mm: The cloud it must be of; None takes any.

    Raises:
        ReducedError: It is none, or of another skin or cloud.
        OSError: It cannot be read.
    """
    try:
        file = read_npz(path, LARGEST_FILE)
        if str(file["format"]) != FORMAT or int(file["version"]) != VERSION:
            raise ReducedError(f"{path} is no reduced model of version {VERSION}; make it anew from the cloud")
        model = ReducedModel(
            coupling=np.asarray(file["coupling"], dtype=np.float32),
            loads=np.asarray(file["loads"], dtype=np.float64),
            untouched=np.asarray(file["untouched"], dtype=np.float64),
            contacts=np.asarray(file["contacts"], dtype=np.intp),
            polynomials=np.asarray(file["polynomials"], dtype=np.float64),
            shape=skin.grid.units,
            skin_digest=str(file["skin_digest"]),
            grid_id=str(file["grid_id"]),
            cloud_digest=str(file["cloud_digest"]),
        )
    except (FileError, KeyError, TypeError, ValueError) as error:
        if isinstance(error, ReducedError):
            raise
        raise ReducedError(f"{path} is no reduced model: {error}; make it anew from the cloud") from error
    _check(model, path, skin, cloud_mm)
    return model


def _check(model: ReducedModel, path: str | Path, skin: Skin, cloud_mm: npt.ArrayLike | None) -> None:
    for what, found, expected in (
        ("skin", model.skin_digest, skin.digest), ("grid", model.grid_id, skin.grid_id),
    ):  # fmt: skip
        if found != expected:
            raise ReducedError(
                f"{path} is of {what} {found}, expected {expected} of skin {skin.name!r}; make it anew from the cloud"
            )
    if cloud_mm is not None and model.cloud_digest != (own := cloud_digest(np.asarray(cloud_mm))):
        raise ReducedError(
            f"{path} is of cloud {model.cloud_digest or 'none'}, expected {own}; make it anew from the present cloud"
        )
    size = model.n_units * model.rank
    right = model.coupling.shape == (size, size) and model.untouched.shape == (N_ELECTRODES, N_ELECTRODES)
    if not right or model.n_units != skin.grid.n_units or len(model.polynomials) != len(model.contacts):
        raise ReducedError(f"{path} has matrices of wrong shapes; make it anew from the cloud")
