"""Cut elements of the free generator: between the untouched sheet and the touch, whatever the border does."""

import numpy as np
import pytest
from tests.sim.shared_system import shared_system

from eitskin_sim.fem.borders.cut_blocks import cut_blocks
from eitskin_sim.fem.borders.cut_elements import factorise
from eitskin_sim.fem.borders.cut_touches import find_cuts
from eitskin_sim.fem.forward import Factor, System
from eitskin_sim.freeform.mesh import shared_mesh
from eitskin_sim.freeform.sheet import _tensors, inverted_sheet, sheet_blocks
from eitskin_sim.freeform.touches import touch_pool
from eitskin_sim.scene.bend import metric
from eitskin_sim.scene.family import draw
from eitskin_sim.scene.parts import Bend, Sheet
from eitskin_sim.scene.touch_table import TouchTable, gather

SIZE_MM = 4.0


@pytest.fixture(scope="module")
def pool() -> TouchTable:
    return touch_pool(400, np.random.default_rng(3))


def tensors_of(bend: Bend, system: System) -> np.ndarray:
    return _tensors(lambda xy: metric(bend, Sheet(), xy), system)


def relative(blocks: np.ndarray, untouched: np.ndarray) -> np.ndarray:
    """Return the (n, 8) eigenvalues of blocks relative to untouched ones; a constant potential is left out."""
    root = np.linalg.inv(np.linalg.cholesky(untouched[:, 1:, 1:]))
    return np.linalg.eigvalsh(root @ blocks[:, 1:, 1:] @ np.swapaxes(root, 1, 2))


# Less than the sheet or more than the touch would be no conductor: voltages of the wrong sign came from that.
# The upper bound holds up to the quadrature of 6 x 6 cells, 0.4 % on the steepest functions.
@pytest.mark.parametrize("bend", draw("B", 3, 8))
def test_a_cut_element_conducts_no_less_than_the_sheet_and_no_more_than_the_touch(
    bend: object, pool: TouchTable
) -> None:
    system = shared_system(bend, SIZE_MM)  # type: ignore[arg-type]
    cuts = find_cuts(pool, np.arange(len(pool)), system.mesh)
    element = cuts.element[: cuts.n_cut]
    blocks = cut_blocks(cuts.integrals, element, tensors_of(bend, system), system.stiffness)  # type: ignore[arg-type]
    found = relative(blocks, system.stiffness[element])
    assert len(found) > 5_000
    assert found.min() > 1.0 - 1e-8
    assert (found.max(axis=1) / cuts.sigma[: cuts.n_cut]).max() < 1.02
    assert (found.max(axis=1) / cuts.sigma[: cuts.n_cut]).min() < 0.9


def test_a_touch_as_conductive_as_the_sheet_changes_no_block(pool: TouchTable) -> None:
    bend = draw("A", 1, 8)[0]
    system = shared_system(bend, SIZE_MM)
    pieces = pool.pieces.copy()
    pieces[:, 6] = 1.0
    cuts = find_cuts(TouchTable(pieces, pool.first), np.arange(50), system.mesh)
    element = cuts.element[: cuts.n_cut]
    blocks = cut_blocks(cuts.integrals, element, tensors_of(bend, system), system.stiffness)
    assert np.abs(blocks - system.stiffness[element]).max() < 1e-12 * np.abs(system.stiffness).max()


def test_shares_of_cut_and_covered_elements_add_up_to_the_area() -> None:
    grid = shared_mesh(SIZE_MM)
    piece = np.array([[0.0, 61.3, 44.7, 23.0, 11.0, 33.0, 50.0]])
    cuts = find_cuts(gather([piece]), np.array([0]), grid.mesh)
    areas = grid.mesh.sizes_mm[cuts.element].prod(axis=1)
    # cells at the four corners are cut by one straight line each, not two
    assert (cuts.share * areas).sum() == pytest.approx(23.0 * 11.0, rel=2e-3)


@pytest.mark.parametrize("kind", [0.0, 1.0])
def test_scenes_and_generators_cut_a_touch_alike(kind: float) -> None:
    sheet = inverted_sheet(Bend(), SIZE_MM)
    table = gather([np.array([[kind, 52.3, 41.7, 10.0, 10.0, 0.0, 50.0]])])
    own = Factor(sheet.system, *sheet_blocks(sheet, table, 0)).voltages() / sheet.untouched_V - 1.0
    scene = factorise(sheet.system, table.touches(0)).voltages() / sheet.untouched_V - 1.0
    assert np.linalg.norm(scene - own) < 1e-6 * np.linalg.norm(own)
