"""Measures over how many frames a mean gains before drift takes over: the minimum of the Allan variance.

The Allan variance of means of n frames is half the mean square of the difference of neighbouring means. White noise
halves it whenever n doubles. Where it no longer falls, drift is as large as what is left of the noise.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

LEVELS: Final = 7
"""Means of 1, 2, 4 ... 64 frames."""


def steady_frames(voltages_V: Array, spread_V: Array) -> int:
    """Return over how many frames a mean gains, a power of two; as far as was seen.

    Args:
        voltages_V: (n, rows) V.
        spread_V: (rows,) V, standard deviation of a single frame, by which rows are compared.
    """
    means = voltages_V / np.where(spread_V > 0.0, spread_V, np.inf)
    variances: list[float] = []
    while len(means) > 1 and len(variances) < LEVELS:
        pairs = means[: len(means) // 2 * 2].reshape(-1, 2, means.shape[1])
        variances.append(float(np.square(pairs[:, 1] - pairs[:, 0]).sum()) / len(pairs))
        means = pairs.mean(axis=1)
    rises = np.flatnonzero(np.diff(variances) > 0.0)
    return 1 << (int(rises[0]) if len(rises) else LEVELS - 1)
