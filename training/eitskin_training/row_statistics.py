"""How the rows of healthy frames spread, from the data that a network learned from: what a bundle carries of it.

The Gaussian is that of the training samples with the recipe's noise, the same that filled in missing electrodes while
the network learned. Beside it are two of deformations alone, by which the runtime tells drift from bending: of
l = log(V / V0), and of what l leaves when log(V_pred / V0) is taken off.
"""

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.row_gaussian import RATIO_RANGE, log_of_ratio
from eitskin_proto.sensor.table import N_ROWS
from eitskin_sim.measurement.consistency import FLOOR
from eitskin_training.gate.untouched import Bends
from eitskin_training.recipes import Recipe
from eitskin_training.samples.batches import TrainingData, consistency_of

Array = npt.NDArray[np.float64]


def row_statistics(data: TrainingData, recipe: Recipe, bends: Bends) -> dict[str, Array]:
    """Return the arrays of a bundle's consistency.npz that are statistics of training data, by name.

    Args:
        data: The data set.
        recipe: Its noise.
        bends: Untouched sheets.
    """
    found = consistency_of(data, recipe)
    logs = np.concatenate([bends.train, np.zeros((1, N_ROWS))])
    left = unpredicted(data, np.unique(data.deformation[data.train]))
    return {
        "mean": found.mean,
        "covariance": found.covariance,
        "ratio_range": np.array(RATIO_RANGE),
        "reference": np.asarray(data.reference, dtype=np.float64),
        "untouched_mean": logs.mean(axis=0),
        "untouched_covariance": np.cov(logs, rowvar=False) + FLOOR * np.eye(N_ROWS),
        "predicted_mean": left.mean(axis=0),
        "predicted_covariance": np.cov(left, rowvar=False) + FLOOR * np.eye(N_ROWS),
    }


def unpredicted(data: TrainingData, deformations: npt.NDArray[np.integer]) -> Array:
    """Return (n, 104) what of l of untouched deformations their predicted reference does not explain."""
    return np.asarray(log_of_ratio(data.untouched[deformations], data.reference) - data.log_predicted[deformations])
