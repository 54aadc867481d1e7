"""A number with its uncertainty: its value, and the distribution of the true one.

::

    thickness_mm = 2.0                                      exactly
    thickness_mm = {value = 2.0, uniform = 0.2}             from 1.8 to 2.2, all alike
    gauge_factor = {value = 0.0, normal = 0.5}              standard deviation 0.5
    contact_impedance_ohm_m2 = {value = 1e-4, log_normal = 0.5}    times exp(0.5 e)

A quantity of the electrodes may be one number for all or a list of sixteen; their deviations are independent.
"""

from dataclasses import dataclass
from typing import Final, Literal, get_args

import numpy as np
import numpy.typing as npt

Law = Literal["exact", "normal", "uniform", "log_normal"]
"""The distribution of the true value around the stated one."""

LAWS: Final[tuple[Law, ...]] = get_args(Law)


@dataclass(frozen=True, slots=True)
class Quantity:
    """A value and its uncertainty."""

    value: float | tuple[float, ...]
    """One number, or one for each electrode."""
    law: Law = "exact"
    spread: float = 0.0
    """Standard deviation (normal), half the width (uniform), standard deviation of the logarithm (log_normal)."""

    def nominal(self, count: int) -> npt.NDArray[np.float64]:
        """Return (count,) stated values.

        Raises:
            ValueError: The quantity has a list of another length.
        """
        return np.array(np.broadcast_to(np.asarray(self.value, dtype=np.float64), (count,)))

    def draw(self, generator: np.random.Generator, count: int) -> npt.NDArray[np.float64]:
        """Return (count,) values as they might truly be, each off by itself; as many numbers are drawn in any case.

        Raises:
            ValueError: The quantity has a list of another length.
        """
        stated = self.nominal(count)
        normal, uniform = generator.standard_normal(count), generator.uniform(-1.0, 1.0, count)
        if self.law == "normal":
            return stated + self.spread * normal
        if self.law == "uniform":
            return stated + self.spread * uniform
        if self.law == "log_normal":
            return np.asarray(stated * np.exp(self.spread * normal))
        return stated
