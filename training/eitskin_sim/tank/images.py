"""Images of a tank by the classical solvers: relative changes of conductivity, of either sign.

Tikhonov's takes no bounds. l1 and sparse Bayesian learning look for effective contrasts
(:mod:`eitskin_sim.solvers.operators`) from -2, an insulator's, to 2, a perfect conductor's: a tank holds both at once.
"""

from collections.abc import Callable, Mapping
from typing import Final

import numpy as np

from eitskin_sim.arrays import Array
from eitskin_sim.solvers.l1 import l1_image
from eitskin_sim.solvers.operators import SATURATED_CONTRAST
from eitskin_sim.solvers.sbl import sbl_image
from eitskin_sim.tank.model import CELLS, TankModel

SBL_NOISE: Final = 0.2
"""Relative to the changes' root mean square, as on sheets: the linearisation's error. In 32 simulated tanks with one to
four objects of 4 to 7 mm, the best image within the objects left 20 % of the changes (median); a sheet's has 5 %."""


def tikhonov(model: TankModel, change: Array) -> Array:
    """Return the (n,) image of one matrix."""
    return np.asarray(model.matrix @ change)


def l1(model: TankModel, change: Array) -> Array:
    """Return the (n,) sparse image within the bounds."""
    return signed_l1(model.relative, change)


def sbl(model: TankModel, change: Array) -> Array:
    """Return the (n,) most probable image within the bounds, its clusters learned."""
    return sbl_image(
        model.relative, change, CELLS, lower=-SATURATED_CONTRAST, upper=SATURATED_CONTRAST, noise=SBL_NOISE
    )


def signed_l1(operator: Array, change: Array) -> Array:
    """Return argmin 1/2 ||A x - d||^2 + lambda |x|_1 within the bounds: what rises and what falls are cells apart."""
    rising, falling = np.split(l1_image(np.hstack([operator, -operator]), change, upper=SATURATED_CONTRAST), 2)
    return np.asarray(rising - falling)


IMAGES: Final[Mapping[str, Callable[[TankModel, Array], Array]]] = {"tikhonov": tikhonov, "l1": l1, "sbl": sbl}
"""Every solver by its name, from (104,) relative changes to (n,) cells."""
