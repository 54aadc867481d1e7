import numpy as np
import pytest

from eitskin_sim.fem.borders.cut_elements import factorise, touch
from eitskin_sim.fem.borders.cut_rule import half_plane_share
from eitskin_sim.fem.forward import System, assemble
from eitskin_sim.fem.mesh import TensorMesh, graded_lines
from eitskin_sim.fem.meshing import electrode_lines
from eitskin_sim.fem.solve import solve_scene
from eitskin_sim.scene.parts import Electrodes, Scene, Sheet, Touch
from eitskin_sim.scene.shapes import Disc, Polygon, Rect, Shape

pytestmark = [pytest.mark.slow, pytest.mark.heavy]

SHEET, ELECTRODES = Sheet(), Electrodes()


def fixed_system(largest_mm: float, density: float = 1.0, extra: tuple[list[float], list[float]] = ([], [])) -> System:
    lines = [
        graded_lines(fixed + [(at, largest_mm) for at in more], largest_mm, density)
        for fixed, more in zip(electrode_lines(SHEET, ELECTRODES), extra, strict=True)
    ]
    return assemble(TensorMesh(*lines), SHEET, ELECTRODES)


SYSTEM = fixed_system(3.0)
UNTOUCHED = SYSTEM.factorise().voltages()


def change(*shapes: Shape, conductivity: float = 50.0) -> np.ndarray:
    return factorise(SYSTEM, (Touch(shapes, conductivity),)).voltages() / UNTOUCHED - 1


def rect(x: float, y: float, size: float) -> Rect:
    return Rect(x, y, x + size, y + size)


@pytest.fixture(scope="module")
def untouched() -> np.ndarray:
    return solve_scene(Scene()).voltages


def size_error_mm(x: float, y: float, conductivity: float, untouched: np.ndarray, found: np.ndarray) -> float:
    """Fit the size of a 10 mm square: the exact change of the voltages with its size is the yardstick."""
    exact, larger = (
        solve_scene(Scene(touches=(Touch((rect(x - g, y - g, 10 + 2 * g),), conductivity),))).voltages / untouched - 1
        for g in (0.0, 0.1)
    )
    slope = (larger - exact) / 0.2
    return float(slope @ (found - exact) / (slope @ slope))


@pytest.mark.parametrize("conductivity", [0.1, 50.0, 200.0])
@pytest.mark.parametrize(("x", "y"), [(71.4, 33.1), (21.7, 14.3)])
def test_square_off_the_mesh_keeps_its_size_within_a_third_of_a_millimetre(
    x: float, y: float, conductivity: float, untouched: np.ndarray
) -> None:
    error = size_error_mm(x, y, conductivity, untouched, change(rect(x, y, 10.0), conductivity=conductivity))
    assert abs(error) < 0.3  # elements of 3 mm; 0.05 to 0.26 was measured


def test_disc_keeps_the_diameter_that_a_finer_mesh_gives(untouched: np.ndarray) -> None:
    disc = Disc(76.4, 38.1, 6.0)
    expected, larger = (
        solve_scene(Scene(touches=(Touch((Disc(76.4, 38.1, radius),)),))).voltages / untouched - 1
        for radius in (6.0, 6.05)
    )
    slope = (larger - expected) / 0.1
    assert abs(slope @ (change(disc) - expected) / (slope @ slope)) < 0.1


def test_touch_that_the_mesh_follows_is_not_cut() -> None:
    x, y = SYSTEM.mesh.x_lines_mm, SYSTEM.mesh.y_lines_mm
    aligned = Rect(float(x[40]), float(y[30]), float(x[45]), float(y[36]))
    touched = touch(SYSTEM, (Touch((aligned,)),))
    assert len(touched.cut) == 0
    assert np.count_nonzero(touched.sigma == 50.0) == 5 * 6


def test_abutting_touches_leave_no_seam() -> None:
    whole = change(Rect(30.3, 40.2, 51.1, 50.7))
    halves = change(Rect(30.3, 40.2, 40.1, 50.7), Rect(40.1, 40.2, 51.1, 50.7))
    # A seam of one element would change it by a tenth; what is left is where the two borders meet the outer one.
    assert np.linalg.norm(halves - whole) < 2e-3 * np.linalg.norm(whole)


def test_blocks_stay_symmetric_semidefinite_and_blind_to_a_constant() -> None:
    shapes = (Disc(41.0, 45.0, 6.0), Polygon(((60.2, 20.1), (80.3, 24.0), (66.0, 41.7))), rect(7.3, 0.0, 11.0))
    touched = touch(SYSTEM, (Touch(shapes, 200.0),))
    blocks = touched.blocks[touched.cut]
    assert len(blocks) > 50
    scale = np.abs(blocks).max(axis=(1, 2))
    assert np.max(np.abs(blocks - np.swapaxes(blocks, 1, 2)).max(axis=(1, 2)) / scale) < 1e-12
    assert np.max(np.abs(blocks.sum(axis=2)).max(axis=1) / scale) < 1e-9
    assert np.min(np.linalg.eigvalsh(blocks)[:, 0] / scale) > -1e-9


def test_share_of_a_half_plane_is_what_counting_gives() -> None:
    rng = np.random.default_rng(1)
    angle = rng.uniform(0, 2 * np.pi, 50)
    normal = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    sizes, distance = rng.uniform(0.5, 2.0, (50, 2)), rng.uniform(-1.0, 1.0, 50)
    offsets = (np.arange(400) + 0.5) / 400 - 0.5
    grid = np.stack(np.meshgrid(offsets, offsets), axis=-1).reshape(-1, 2)
    counted = [np.mean(grid * s @ n + d < 0) for s, n, d in zip(sizes, normal, distance, strict=True)]
    np.testing.assert_allclose(half_plane_share(distance, normal, sizes), counted, atol=4e-3)  # 1/400 of a side
