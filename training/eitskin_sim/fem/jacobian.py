"""The derivative of every voltage by every pixel's or unit's conductivity, by adjoint fields.

For drive k and measure m with the fields x_k and x_m of 1 A through either pair,

    dV[k, m] / d sigma_c = - sum over e in c of  x_m . S_e x_k  +  d kappa_e / d sigma  (U - x)_m . M_e (U - x)_k

with S_e the stiffness at sigma = 1 and M_e the contact's mass: where a face contact lies on the cell, its effective
impedance changes with the conductivity under it. By reciprocity the 16 drive fields are all the adjoint fields there
are, so the cost is one factorisation. A cell's derivative adds the same conductivity at every point of the cell.
"""

from functools import lru_cache
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array

from eitskin_proto.sensor.table import TABLE
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.arrays import Array, Index
from eitskin_sim.fem.forward import Factor, assemble, flat_metric
from eitskin_sim.fem.mesh import MERGE_MM, Metric, TensorMesh, graded_lines
from eitskin_sim.fem.meshing import CAP_MM, REFERENCE_MM, electrode_lines, on_sheet
from eitskin_sim.scene.nominal import flat_metric_of, nominal_electrodes, nominal_sheet
from eitskin_sim.scene.parts import Electrodes, Sheet

COARSE_MM: Final = 4.5
"""The element size for classical solvers: 0.1 s a Jacobian, within 1e-3 (edge contacts 4e-3) of the converged one."""


def cell_mesh(
    sheet: Sheet,
    electrodes: Electrodes,
    shape: tuple[int, int] = PAPER.grid.shape,
    element_size_mm: float = COARSE_MM,
) -> TensorMesh:
    """Return a mesh whose lines hold a grid of cells, as well as the electrodes.

    Args:
        sheet: The flat layer.
        electrodes: On its border.
        shape: Rows along y and columns along x of the grid: those of a map's pixels or units.
        element_size_mm: As in a scene.
    """
    density = REFERENCE_MM / element_size_mm
    lines = []
    for fixed, extent, count in zip(electrode_lines(sheet, electrodes), sheet.size_mm, shape[::-1], strict=True):
        grid = [(float(at), CAP_MM) for at in np.linspace(0.0, extent, count + 1)]
        lines.append(graded_lines(on_sheet(fixed + grid, extent), CAP_MM, density))
    return TensorMesh(*lines)


def cell_of_element(mesh: TensorMesh, shape: tuple[int, int]) -> Index:
    """Return the (n_elements,) cell, row * columns + column, of each element's middle.

    Raises:
        ValueError: A line of the grid is no line of the mesh.
    """
    found = []
    for lines, count, name in ((mesh.y_lines_mm, shape[0], "y"), (mesh.x_lines_mm, shape[1], "x")):
        grid = np.linspace(0.0, lines[-1], count + 1)
        gap = np.abs(lines[:, None] - grid).min(axis=0).max()
        if gap > 2 * MERGE_MM:
            raise ValueError(f"a grid line along {name} is {gap:g} mm off the mesh's; it must be within {MERGE_MM:g}")
        found.append(np.searchsorted(grid, (lines[:-1] + lines[1:]) / 2) - 1)
    return np.asarray((found[0][:, None] * shape[1] + found[1]).ravel())


def jacobian(factor: Factor, sigma: Array, cells: Index, n_cells: int, table: npt.NDArray[np.uint8] = TABLE) -> Array:
    """Return (rows, n_cells) dV / d sigma in V / (S/m) under 1 A.

    Args:
        factor: The scene, factorised.
        sigma: (n_elements,) S/m that the factor was made with.
        cells: (n_elements,) cell of each element.
        n_cells: How many cells there are.
        table: (rows, 2) drives and measures.
    """
    rows = factor.element_powers(sigma)[:, table[:, 0], table[:, 1]]
    gather = csr_array((1.0 / sigma, (cells, np.arange(len(sigma)))), (n_cells, len(sigma)))
    return np.asarray(-(gather @ rows).T)


def relative_jacobian(
    sheet: Sheet,
    electrodes: Electrodes,
    metric: Metric = flat_metric,
    *,
    shape: tuple[int, int],
    element_size_mm: float = COARSE_MM,
) -> tuple[Array, Array]:
    """Return an untouched sheet's (104,) V under 1 A, and (104, cells) their relative change per that of each cell.

    Args:
        sheet: The flat layer.
        electrodes: On its border.
        metric: The bent surface's first fundamental form.
        shape: Rows and columns of the cells: of a map's pixels or units.
        element_size_mm: As in a scene.
    """
    mesh = cell_mesh(sheet, electrodes, shape, element_size_mm)
    factor = assemble(mesh, sheet, electrodes, metric).factorise()
    sigma, voltages = np.full(mesh.n_elements, sheet.conductivity_S_per_m), factor.voltages()
    found = jacobian(factor, sigma, cell_of_element(mesh, shape), shape[0] * shape[1])
    return voltages, sheet.conductivity_S_per_m * found / voltages[:, None]


@lru_cache(maxsize=4)
def flat_jacobian(skin: Skin) -> Array:
    """Return the (104, pixels) relative Jacobian of a skin's flat sheet, as it is stated."""
    electrodes = nominal_electrodes(skin)
    return relative_jacobian(nominal_sheet(skin), electrodes, flat_metric_of(skin), shape=skin.grid.shape)[1]
