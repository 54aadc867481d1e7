"""Judges a measured sample whose map shows no touch by the untouched samples of its file.

No model of the sheet enters: its allowances for drift, stretch and mesh would explain more than noise leaves, and p
would be near 1 in every sample. With r the sample's dV less the mean of the n untouched samples of its shape, and C
the covariance of single samples about that mean ::

    chi-squared = r^T C^-1 r / (1 + 1 / n)

C comes from few samples, so this scatters otherwise than 104 rows of known noise would. The scatter is measured: each
tenth of the untouched samples is compared with the others, and p is that of a multiple of a chi-squared distribution
with the same mean and variance.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.noise_law import noise_of, own_sd
from eitskin_sim.verification.residual import Noise
from eitskin_sim.verification.verdict import LEVEL, Verdict, p_value

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]

PARTS: Final = 10
"""Into which untouched samples are divided."""

MIN_SAMPLES: Final = 8
"""Untouched samples from which noise is taken."""

MAX_FREEDOM: Final = 1000
"""Degrees of freedom of samples that hardly scatter."""


class UntouchedSamples:
    """All samples of a file, compared with the untouched ones.

    Args:
        changes: (n, 104) dV.
        shapes: (n,) the shape of the sheet in each.
        known: Numbers of the untouched ones; each shares its shape with another.
    """

    def __init__(self, changes: Array, shapes: Index, known: Index) -> None:
        self.noise = _noise(changes[known], shapes[known])
        """Of dV, with what rows share."""
        self._chi_squared = _chi_squared(changes, shapes, changes[known], shapes[known])
        part = np.arange(len(known)) % PARTS
        for number in np.unique(part):
            own, others = known[part == number], known[part != number]
            self._chi_squared[own] = _chi_squared(changes[own], shapes[own], changes[others], shapes[others])
        mean, variance = np.nanmean(self._chi_squared[known]), np.nanvar(self._chi_squared[known], ddof=1)
        self._freedom = int(np.clip(np.rint(2.0 * mean**2 / variance), 1, MAX_FREEDOM))
        self._scale = float(mean) / self._freedom

    @classmethod
    def of(cls, changes: Array, shapes: Index, untouched: npt.NDArray[np.bool_]) -> "UntouchedSamples | None":
        """Return the samples (n, 104) of shapes (n,), by which are untouched (n,); None if too few differ."""
        _, shape, count = np.unique(shapes[untouched], return_inverse=True, return_counts=True)
        known = np.flatnonzero(untouched)[count[shape] > 1]
        return cls(changes, shapes, known) if len(np.unique(changes[known], axis=0)) >= MIN_SAMPLES else None

    def verdict(self, number: int) -> Verdict[None] | None:
        """Return whether noise explains a sample; None where no other untouched sample has its shape."""
        found = float(self._chi_squared[number]) / self._scale
        if np.isnan(found):
            return None
        return Verdict((), found, self._freedom, p_value(found, self._freedom), LEVEL, 0, 0.0)


def _noise(changes: Array, shapes: Index) -> Noise:
    """Return the noise of samples (n, 104) about the mean of their shapes (n,)."""
    groups = [changes[shapes == shape] for shape in np.unique(shapes)]
    apart = [(own - own.mean(axis=0)) * np.sqrt(len(own) / (len(own) - 1.0)) for own in groups if len(own) > 1]
    sd, shared = noise_of(np.concatenate(apart))
    return Noise("measured", measured=own_sd(sd, shared), shared=shared if shared.size else None)


def _chi_squared(changes: Array, shapes: Index, others: Array, their_shapes: Index) -> Array:
    """Return (n,) chi-squared of samples (n, 104) by others (m, 104); NaN where none of them has the shape."""
    inverse = np.linalg.inv(_noise(others, their_shapes).covariance(others[0], others[0]))
    found = np.full(len(changes), np.nan)
    for shape in np.unique(shapes):
        alike, own = others[their_shapes == shape], shapes == shape
        if len(alike):
            rest = changes[own] - alike.mean(axis=0)
            found[own] = np.einsum("nr,rs,ns->n", rest, inverse, rest) / (1.0 + 1.0 / len(alike))
    return found
