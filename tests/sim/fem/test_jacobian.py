import numpy as np
import pytest

from eitskin_proto.skin.skin import PAPER
from eitskin_sim.fem.forward import assemble
from eitskin_sim.fem.jacobian import (
    COARSE_MM,
    cell_mesh,
    cell_of_element,
    flat_jacobian,
    jacobian,
    relative_jacobian,
)
from eitskin_sim.scene.bend import bend_metric
from eitskin_sim.scene.parts import Bend, Electrodes, Sheet

BEND = Bend(angle_deg=120, axis_deg=30, twist_deg=20, stretch_along=1.1)


@pytest.mark.parametrize(("contact", "shape"), [("patch", PAPER.grid.shape), ("edge", PAPER.grid.units)])
def test_jacobian_is_the_derivative_by_central_differences(contact: str, shape: tuple[int, int]) -> None:
    sheet, electrodes = Sheet(), Electrodes(contact)
    mesh = cell_mesh(sheet, electrodes, shape, 9.0)
    system = assemble(mesh, sheet, electrodes, bend_metric(BEND, sheet))
    cells = cell_of_element(mesh, shape)
    sigma = np.where(cells % 7 == 0, 20.0, 1.0)  # touches all over, one under a contact
    found = jacobian(system.factorise(sigma), sigma, cells, shape[0] * shape[1])
    columns = shape[1]
    for cell in (0, 3 * columns // 14, columns // 2, (shape[0] // 2) * columns + columns // 3, shape[0] * columns - 1):
        step = 1e-3 * sigma[cells == cell][0]
        high, low = (system.factorise(sigma + sign * step * (cells == cell)).voltages() for sign in (1.0, -1.0))
        difference = (high - low) / (2 * step)
        # Central differences with a step of 1e-3 are off by about 1e-6 of the largest.
        np.testing.assert_allclose(found[:, cell], difference, atol=5e-6 * np.abs(difference).max())


def test_uniform_change_of_conductivity_scales_voltages_with_edge_contacts_of_no_impedance() -> None:
    electrodes = Electrodes("edge", contact_impedance_ohm_m2=1e-9)
    _, found = relative_jacobian(Sheet(), electrodes, shape=PAPER.grid.shape, element_size_mm=6.0)
    # V is proportional to 1 / sigma, so the relative Jacobian sums to -1 over the pixels.
    np.testing.assert_allclose(found.sum(axis=1), -1.0, atol=1e-3)


def test_units_and_pixels_tell_of_the_same_places() -> None:
    pixels, (_, units) = flat_jacobian(PAPER), relative_jacobian(Sheet(), Electrodes(), shape=PAPER.grid.units)
    gathered = np.zeros_like(units)
    np.add.at(gathered.T, PAPER.grid.unit_of_pixel.ravel(), pixels.T)
    # A unit's pixels cover it but for a rim of up to half a pixel.
    assert np.corrcoef(gathered.ravel(), units.ravel())[0, 1] > 0.95


def test_coarse_jacobian_is_within_its_stated_error() -> None:
    coarse, fine = (
        relative_jacobian(
            Sheet(), Electrodes(), bend_metric(BEND, Sheet()), shape=PAPER.grid.units, element_size_mm=size_mm
        )[1]
        for size_mm in (COARSE_MM, 1.5)
    )
    assert np.linalg.norm(coarse - fine) < 1.5e-3 * np.linalg.norm(fine)
