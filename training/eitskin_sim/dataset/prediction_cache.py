"""A data set's predicted references, computed once and kept beside it.

``predicted.npz`` in the data set's folder ::

    digest         of the data set
    model          eitskin_sim.surface.predict.model()
    flat           (104,) float64 V of the model's flat sheet
    log_predicted  (D, 104) float32

A file whose digest, model or flat voltages are others is old: it is made again. The data set's own digest does not
cover it, because everything in it follows from the clouds.
"""

import contextlib
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.files.arrays import read_npz
from eitskin_proto.files.reading import FileError
from eitskin_proto.files.writing import replacing
from eitskin_sim.dataset.reader import LARGEST_FILE, DataSet
from eitskin_sim.surface.predict import flat_voltages, model, predicted_log

FILE: Final = "predicted.npz"
"""Name of the file in the data set's folder."""


def predicted_log_of(folder: str | Path, data: DataSet) -> npt.NDArray[np.float32]:
    """Return the (D, 104) log |V_pred| / |V_flat| of a data set's deformations, from its folder if they are there.

    Args:
        folder: The data set's folder; without write access nothing is kept, and each call computes.
        data: The data set, of D deformations.
    """
    path, flat = Path(folder) / FILE, flat_voltages(data.skin)
    kept = _read(path, data, flat)
    if kept is not None:
        return kept
    found = predicted_log(data.clouds, data.skin)
    with contextlib.suppress(OSError, FileError), replacing(path) as file:
        np.savez(file, digest=data.digest, model=model(data.skin), flat=flat, log_predicted=found)
    return found


def _read(path: Path, data: DataSet, flat: npt.NDArray[np.float64]) -> npt.NDArray[np.float32] | None:
    """The kept predictions, or None where there are none of this data set and this model."""
    try:
        file = read_npz(path, LARGEST_FILE)
        same = str(file["digest"]) == data.digest and str(file["model"]) == model(data.skin)
        if same and np.allclose(file["flat"], flat, rtol=1e-9, atol=0.0):
            found = np.asarray(file["log_predicted"], dtype=np.float32)
            return found if found.shape == (len(data.clouds), len(flat)) and np.isfinite(found).all() else None
    except (FileNotFoundError, KeyError, ValueError, TypeError):
        return None
    return None
