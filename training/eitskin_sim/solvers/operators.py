"""The input of every classical solver for one bend: the relative Jacobian on pixels or units, and the data.

    A = (dV / d sigma) * sigma0 / V_ref        d = V / V_ref - 1   or   log(V / V_ref)        d ~ A x

with x the relative change of conductivity of a cell. Linearisation overpredicts a touch of contrast 50 by a factor of
23, because contrast saturates: a disc of c times the background's conductivity acts like a faint one of relative
change 2 (c - 1) / (c + 1), which is 1.92 for c = 50 and below 2 for any c. So x is that *effective* contrast, and the
solvers that take bounds look for it in [0, ``SATURATED_CONTRAST``]. This bound is worth more than any choice of
regularisation.

Tikhonov, which takes no bounds, uses the logarithm: it is what makes the large negative changes (down to -0.995) and
the rows that change most comparable with the linear model. Everything is float64: at the factors used here float32
would be off by 1e-3 and more.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.normalise import relative_change
from eitskin_proto.skin.grid import Grid
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.arrays import Array
from eitskin_sim.fem.forward import flat_metric
from eitskin_sim.fem.jacobian import relative_jacobian
from eitskin_sim.scene.nominal import nominal_electrodes, nominal_sheet
from eitskin_sim.surface.predict import fit_cloud

Cells = Literal["pixels", "units"]
"""The unknowns: the map's pixels, or its touch units."""

SATURATED_CONTRAST: Final = 2.0
"""Effective contrast of a perfectly conducting touch: the polarisability of a disc, 2 (c - 1) / (c + 1), as c grows."""

LOWEST_RATIO: Final = 1e-3
"""V / V_ref is cut off here before a logarithm; it reaches 5e-4 under a touch."""


@dataclass(frozen=True, slots=True)
class Operators:
    """One bend, linearised about its untouched sheet."""

    relative_jacobian: Array
    """(104, n) relative change of each voltage with the relative change of each cell's conductivity."""
    untouched_voltages: Array
    """(104,) V under 1 A, of the same mesh."""
    cells: Cells
    """The unknowns."""
    grid: Grid
    """The map that has them."""

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the cells."""
        return self.grid.shape if self.cells == "pixels" else self.grid.units

    def to_map(self, values: Array) -> Array:
        """Return the (rows, columns) map of (n,) values of the cells."""
        if self.cells == "units":
            return np.asarray(self.grid.map_from_units(values), dtype=np.float64)
        return np.asarray(values.reshape(self.grid.shape), dtype=np.float64)


def build_operators(
    metric: Callable[[Array], Array] = flat_metric,
    cells: Cells = "pixels",
    skin: Skin = PAPER,
) -> Operators:
    """Return the operators of a skin, as it is stated, with a given metric.

    Args:
        metric: (n, 2) flat points in mm -> (n, 3) first fundamental form.
        cells: The unknowns.
        skin: Whose layer, electrodes and map.

    Raises:
        ValueError: The cells are unknown.
    """
    if cells not in ("pixels", "units"):
        raise ValueError(f"cells are 'pixels' or 'units', found {cells!r}")
    shape = skin.grid.shape if cells == "pixels" else skin.grid.units
    voltages, relative = relative_jacobian(nominal_sheet(skin), nominal_electrodes(skin), metric, shape=shape)
    return Operators(relative, voltages, cells, skin.grid)


def operators_of_cloud(cloud_mm: npt.ArrayLike, cells: Cells = "pixels", skin: Skin = PAPER) -> Operators:
    """Return the operators of the sheet that a cloud shows.

    Args:
        cloud_mm: (3, rows, columns) mm, in any pose.
        cells: The unknowns.
        skin: Whose cloud.

    Raises:
        ValueError: The cloud is malformed, or the cells are unknown.
    """
    return build_operators(fit_cloud(cloud_mm, skin.grid).metric, cells, skin)


def linear_data(voltages: Array, reference: Array) -> Array:
    """Return (104,) V / V_ref - 1, 0 in the reference's weak rows."""
    return relative_change(voltages, reference)


def log_data(voltages: Array, reference: Array) -> Array:
    """Return (104,) log(V / V_ref), cut off at log ``LOWEST_RATIO``, 0 in the reference's weak rows."""
    return np.asarray(np.log(np.maximum(1.0 + relative_change(voltages, reference), LOWEST_RATIO)))
