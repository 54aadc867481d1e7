"""A bundle's statistics of healthy frames: the correlation of rows, and thresholds that touches do not exceed.

The distribution of rows is a statistic of the training data (:mod:`eitskin_export.consistency`). Thresholds and limits
are computed here, because they depend on the runtime's arithmetic. One frame in ``RATE`` of unseen touches and
deformations exceeds the thresholds; half of these frames choose them, the other half measure. The runtime needs ten
such frames of fourteen, so that noise alone reports no electrode; a static scene that is itself one of these few does.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin.health.correction import NAMES
from eitskin.health.electrodes import AGREEING_FRAMES, WINDOW, ElectrodeWatch
from eitskin.health.imputation import Consistency as Deployed
from eitskin.health.untouched import estimates
from eitskin_proto.files.arrays import pack_arrays
from eitskin_proto.sensor.row_gaussian import RATIO_RANGE, log_of_ratio
from eitskin_proto.sensor.table import N_ROWS
from eitskin_sim.measurement.consistency import VARIANCE_FLOOR
from eitskin_training.gate.untouched import Bends
from eitskin_training.recipes import Recipe
from eitskin_training.samples.batches import TrainingData, consistency_of, noisy_change

Array = npt.NDArray[np.float64]


def row_statistics(data: TrainingData, recipe: Recipe, bends: Bends) -> dict[str, Array]:
    """Return the arrays of a bundle's consistency.npz that are statistics of training data, by name.

    Args:
        data: The data set.
        recipe: Its noise.
        bends: Untouched sheets.

    Raises:
        ValueError: The training data has a single deformation.
    """
    trained = np.unique(data.deformation[data.train])
    if trained.size < 2:
        raise ValueError(f"the training data has {trained.size} deformation, expected 2 or more; draw more of them")
    found = consistency_of(data, recipe)
    logs = np.concatenate([bends.train, np.zeros((1, N_ROWS))])
    left = unpredicted(data, trained)
    return {
        "mean": found.mean,
        "covariance": found.covariance,
        "ratio_range": np.array(RATIO_RANGE),
        "reference": np.asarray(data.reference, dtype=np.float64),
        "untouched_mean": logs.mean(axis=0),
        "untouched_covariance": np.cov(logs, rowvar=False) + VARIANCE_FLOOR * np.eye(N_ROWS),
        "predicted_mean": left.mean(axis=0),
        "predicted_covariance": np.cov(left, rowvar=False) + VARIANCE_FLOOR * np.eye(N_ROWS),
    }


def unpredicted(data: TrainingData, deformations: npt.NDArray[np.integer]) -> Array:
    """Return (n, 104) what of l of untouched deformations their predicted reference does not explain."""
    return np.asarray(log_of_ratio(data.untouched[deformations], data.reference) - data.log_predicted[deformations])


RATE: Final = 1e-4
"""Share of healthy frames, touches that cover electrodes among them, that may exceed a threshold."""

THRESHOLD_FRAMES: Final = 16_000
"""MeasuredConsistency frames that choose the thresholds, and as many that measure them."""

MAX_DISTANCE_RATIO_OF_UNTOUCHED: Final = 1.2
"""Times the farthest held-out deformation's distance: what still counts as an untouched sheet."""

SNR_DB: Final = 50.0
"""N2 noise of these frames. Noise that differs from frame to frame does not add up to ten of fourteen."""

HALF_LARGEST: Final = 65504.0
"""Of half precision."""


@dataclass(frozen=True, slots=True)
class MeasuredConsistency:
    """A bundle's consistency.npz and what was measured of it."""

    arrays: dict[str, npt.NDArray[np.floating]]
    false_alarm_rate: float
    """Share of the measuring frames that exceed a threshold."""
    frames: int
    """How many of them there were."""

    def to_npz(self) -> bytes:
        """Return the arrays as the bytes of an .npz file; float64, since the precision has a condition of 1e7."""
        return pack_arrays(self.arrays)

    def facts(self) -> dict[str, object]:
        """Return what a manifest states."""
        return {
            "false_alarm_rate_per_frame": self.false_alarm_rate,
            "frames": self.frames,
            "thresholds": [round(float(value), 3) for value in self.arrays["thresholds"]],
            "named_after_frames": [AGREEING_FRAMES, WINDOW],
            "filling": [list(self.arrays[name].shape) for name in NAMES] if NAMES[0] in self.arrays else None,
            "drift_error_percent": [round(100.0 * float(limit[0]), 2) for limit in self.arrays["drift_limits"]],
        }


def healthy(
    data: TrainingData,
    recipe: Recipe,
    bends: Bends,
    projection_inverse: Array,
    filling: Mapping[str, npt.NDArray[np.floating]] | None = None,
) -> MeasuredConsistency:
    """Return what a bundle says of healthy frames.

    Args:
        data: The data set.
        recipe: Its noise.
        bends: Untouched sheets.
        projection_inverse: (104, 104) (J J^T + tau I)^-1 of the bundle's projection.
        filling: What corrects filled-in rows, of an adapted run; stored in half precision.
    """
    rng = np.random.default_rng([data.seed, 0xE1EC])
    rows = np.concatenate([*data.held_out.values(), data.validation])
    rows = rng.permutation(rows)[: 2 * THRESHOLD_FRAMES]
    change = noisy_change(data, rows, ("N2",), SNR_DB, rng)
    arrays: dict[str, npt.NDArray[np.floating]] = {
        **row_statistics(data, recipe, bends),
        "drift_limits": np.ones((2, 2)),
        "projection_inverse": projection_inverse,
        "thresholds": np.ones(2),
    }
    arrays |= {name: _half(value) for name, value in (filling or {}).items()}
    arrays["drift_limits"] = _drift_limits(Deployed.of(arrays), data, bends)
    seen = evidence(Deployed.of(arrays), change)
    choose, measure = seen[::2], seen[1::2]
    thresholds = np.quantile(choose, 1.0 - RATE, axis=0) if len(choose) else np.full(2, np.inf)
    alarms = float((measure > thresholds).any(axis=1).mean()) if len(measure) else 0.0
    return MeasuredConsistency({**arrays, "thresholds": thresholds}, alarms, len(measure))


def _half(value: npt.NDArray[np.floating]) -> npt.NDArray[np.float16]:
    """Return weights in half precision, which has eleven bits: a filled-in row changes by 1e-3 of its correction.

    Raises:
        ValueError: A weight is too large for half precision, or not finite.
    """
    if not (np.abs(value) <= HALF_LARGEST).all():
        raise ValueError(
            f"a weight of the imputation is {np.abs(value).max()}; expected at most {HALF_LARGEST}: adapt again"
        )
    return np.asarray(value, dtype=np.float16)


def _drift_limits(deployed: Deployed, data: TrainingData, bends: Bends) -> Array:
    """Return (2, 2) rms error of the common factor and largest distance, on deformations that taught nothing.

    The first row is without a prediction, the second with one.
    """
    logs_apart = np.concatenate([bends.choose, bends.measure])
    found = []
    for predicted, logs in ((False, logs_apart), (True, unpredicted(data, np.unique(data.deformation[data.apart])))):
        seen = estimates(deployed, logs, predicted=predicted)
        found.append(
            [float(np.sqrt(np.mean(seen[:, 0] ** 2))), MAX_DISTANCE_RATIO_OF_UNTOUCHED * float(seen[:, 1].max())]
        )
    return np.array(found)


def evidence(deployed: Deployed, change: npt.NDArray[np.float32]) -> Array:
    """Return (n, 2) largest surprise and the whole frame's of healthy frames, the way the runtime computes them."""
    watch = ElectrodeWatch(deployed, deployed.reference, np.zeros(N_ROWS))
    found = np.empty((len(change), 2))
    for number, frame in enumerate(change):
        surprise, total = watch.surprise(frame)
        found[number] = surprise.max(), total
    return found
