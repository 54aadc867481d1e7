"""Keeps denormals out of the arithmetic: float32 below 1.2e-38, which a processor computes many times slower.

They cannot come in with a frame. Code that writes dV computes V / V0 - 1 in double precision, and next to 1 such
numbers are 2**-53 apart: dV is 0 or at least 1.1e-16. Clouds, predictions and a bundle's numbers come from elsewhere;
in them every number below ``SMALLEST`` is set to 0 once, on input. A product of the two is then 0 or at least 1e-36. A
frame pays nothing.
"""

from typing import Final, TypeVar

import numpy as np
import numpy.typing as npt

SMALLEST: Final = 1e-20
"""The smallest number of the shipped bundles' matrices is 9e-9."""

Real = TypeVar("Real", np.float32, np.float64)


def flushed(values: npt.NDArray[Real]) -> npt.NDArray[Real]:
    """Return an array as it is, or a copy with 0 for everything that is smaller than ``SMALLEST``."""
    small = is_small(values)
    return np.where(small, values.dtype.type(0), values) if small.any() else values


def is_small(values: npt.NDArray[np.floating]) -> npt.NDArray[np.bool_]:
    """Return which elements are neither 0 nor of a size that is computed with; False for NaN."""
    return np.asarray((values != 0) & (np.abs(values) < SMALLEST))
