"""The noise of rows as measured: what rows share, and how noise goes with the signal.

Rows of real sheets are not noisy independently: supply, contacts and drift move many of them together. The covariance
of n frames is kept as each row's standard deviation and a few components ::

    C = diag(own^2) + S S^T        sd^2 = own^2 + sum of squares of S's rows

Components are the eigenvectors of the correlation matrix whose eigenvalues exceed what n frames of independent rows
give by chance, (1 + sqrt(rows / n))^2 times the mean of all others. Sampling makes those eigenvalues too large; they
are shrunk to the value that gives the observed one on average (the spiked model of Johnstone and Paul), and all else
towards the diagonal.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

MAX_COMPONENTS: Final = 12
"""Components of a covariance."""

CHANCE_MARGIN: Final = 1.1
"""Times what chance gives on average: the largest eigenvalue of independent rows is above in one file of a hundred."""

MIN_LEVEL: Final = 1e-9
"""Of the eigenvalues that are not shared, where all of the noise is."""

ROUNDS: Final = 10
"""Of the search for components."""

MIN_OWN_SHARE: Final = 0.05
"""Of a row's variance, that is its own."""

FIRST_COMPONENTS: Final = 5
"""Whose share of the noise is reported."""

SIGNAL_SLOPE: Final = 0.5
"""Of log sd on log V, above which noise goes with the signal more than it is constant."""


@dataclass(frozen=True, slots=True)
class NoiseLaw:
    """How the noise of some untouched frames goes."""

    slope: float
    """Of log standard deviation on log |V| over rows: 1 where noise goes with the signal, 0 where it is constant."""
    median_percent: float
    """Median of rows' standard deviations over their voltages."""
    first_share: float
    """Share of the first five components in the noise of rows, each over its standard deviation."""
    drift_percent: float
    """What all rows change by together (median) from the first half of the frames to the second."""

    @property
    def protocol(self) -> str:
        """Return the drive pattern that suits this noise."""
        return "adjacent" if self.slope > SIGNAL_SLOPE else "opposite"

    def lines(self) -> list[str]:
        """Return the law for people, in two lines."""
        reason = "goes with the signal" if self.protocol == "adjacent" else "is nearly the same in all rows"
        return [
            f"noise: {self.median_percent:.2g} % of a row (median), as V^{self.slope:.2f}; the first "
            f"{FIRST_COMPONENTS} components have {self.first_share:.0%}; common drift {self.drift_percent:.2g} %",
            f"noise: {self.protocol} drive suits it, because noise {reason}",
        ]


def shared_noise(covariance: Array, frames: int) -> Array:
    """Return (rows, k) components S that rows share, k from 0 to ``MAX_COMPONENTS``.

    Args:
        covariance: (rows, rows) of single frames, about their mean.
        frames: How many frames it is of.
    """
    sd = np.sqrt(np.diag(covariance))
    safe = np.where(sd > 0.0, sd, 1.0)
    size, vectors = np.linalg.eigh(covariance / np.outer(safe, safe))
    gamma = len(sd) / max(frames - 1, 1)
    level, count = 1.0, 0
    for _ in range(ROUNDS):  # of the level of what is not shared, which decides what is
        more = np.count_nonzero(size > level * CHANCE_MARGIN * (1.0 + np.sqrt(gamma)) ** 2)
        if more <= count or count == MAX_COMPONENTS:
            break
        count = min(int(more), MAX_COMPONENTS)
        others = max(len(size) - count * (1.0 + gamma), len(size) / 4.0)  # components hold chance too
        level = max(float(size[:-count].sum()) / others, MIN_LEVEL)
    chosen = slice(len(size) - count, None)
    large = size[chosen] / level + 1.0 - gamma
    true = (large + np.sqrt(np.maximum(large**2 - 4.0 * size[chosen] / level, 0.0))) / 2.0
    shared = vectors[:, chosen] * np.sqrt(level * np.maximum(true - 1.0, 0.0))
    share = np.maximum(np.sum(shared**2, axis=1) / (1.0 - MIN_OWN_SHARE), 1.0)
    return np.asarray(safe[:, None] * shared / np.sqrt(share)[:, None])


def own_sd(sd: Array, shared: Array) -> Array:
    """Return (rows,) the part of standard deviations (rows,) that rows do not share, by components (rows, k)."""
    return np.asarray(np.sqrt(np.maximum(sd**2 - np.sum(shared**2, axis=1), 0.0)))


def noise_of(changes: Array) -> tuple[Array, Array]:
    """Return (rows,) standard deviations and (rows, k) components of untouched changes (n, rows), n at least 2."""
    apart = changes - changes.mean(axis=0)
    covariance = apart.T @ apart / (len(changes) - 1)
    return np.sqrt(np.diag(covariance)), shared_noise(covariance, len(changes))


def noise_law(readings_V: Array) -> NoiseLaw:
    """Return how noise goes in untouched frames (n, rows), n at least 4, from one frame to the next.

    Raises:
        ValueError: There are fewer frames, or the readings do not vary.
    """
    if readings_V.ndim != 2 or len(readings_V) < 4:
        raise ValueError(f"noise of readings {readings_V.shape}, expected at least 4 frames")
    volts = np.abs(readings_V.mean(axis=0))
    apart = np.diff(readings_V, axis=0) / np.sqrt(2.0)
    sd = np.sqrt(np.mean(apart**2, axis=0))
    there = (sd > 0.0) & (volts > 0.0)
    if there.sum() < 3:
        raise ValueError(f"{int(there.sum())} rows vary, expected at least 3: the front end repeats itself")
    slope = float(np.polyfit(np.log(volts[there]), np.log(sd[there]), 1)[0])
    variance = np.linalg.svd(apart[:, there] / sd[there], compute_uv=False) ** 2
    half = len(readings_V) // 2
    drift = np.median(np.log(np.abs(readings_V[half:].mean(axis=0)[there] / readings_V[:half].mean(axis=0)[there])))
    return NoiseLaw(
        slope,
        100.0 * float(np.median(sd[there] / volts[there])),
        float(variance[:FIRST_COMPONENTS].sum() / variance.sum()),
        100.0 * float(abs(drift)),
    )
