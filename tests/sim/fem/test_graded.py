"""Touches both ways in the forward model: graded borders, slopes, symmetry, superposition."""

from functools import cache

import numpy as np
import pytest

from eitskin_sim.fem.borders.cut_elements import factorise
from eitskin_sim.fem.borders.graded import plateau
from eitskin_sim.fem.forward import assemble
from eitskin_sim.fem.jacobian import cell_mesh, cell_of_element, jacobian
from eitskin_sim.fem.solve import solve_scene
from eitskin_sim.scene.bend import bend_metric
from eitskin_sim.scene.parts import Bend, Electrodes, Scene, Sheet, Touch
from eitskin_sim.scene.shapes import Disc, Ellipse, Polygon, Rect, Shape

pytestmark = [pytest.mark.slow, pytest.mark.heavy]

BEND = Bend(angle_deg=70.0, axis_deg=-30.0, twist_deg=10.0, stretch_along=1.08, stretch_across=0.97, nonuniformity=0.05)
DISC = Disc(70.3, 45.1, 8.0)
SHAPES: tuple[Shape, ...] = (
    DISC,
    Ellipse(70.0, 45.0, 20.0, 12.0, 30.0),
    Rect(60.2, 40.1, 76.9, 56.3),
    Polygon(((60.0, 40.0), (80.0, 42.0), (70.0, 58.0))),
)


def change(touches: tuple[Touch, ...], size_mm: float, bend: Bend = BEND) -> np.ndarray:
    touched = solve_scene(Scene(bend=bend, touches=touches, element_size_mm=size_mm)).voltages
    return np.asarray(touched / bare(size_mm, bend) - 1.0)


@cache
def bare(size_mm: float, bend: Bend) -> np.ndarray:
    return solve_scene(Scene(bend=bend, element_size_mm=size_mm)).voltages


def off(found: np.ndarray, exact: np.ndarray) -> float:
    return float(np.linalg.norm(found - exact) / np.linalg.norm(exact))


# That a border shows at all is seen from the sharp touch, which is much further off.
@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: type(shape).__name__)
@pytest.mark.parametrize("contrast", [0.3, 20.0])
def test_every_sign_border_and_shape_agrees_with_a_mesh_twice_as_fine(shape: Shape, contrast: float) -> None:
    sharp = change((Touch((shape,), contrast=contrast),), 3.0)
    for border, apart in ((1.0, 0.002), (6.0, 0.05)):
        own = (Touch((shape,), contrast=contrast, border_mm=border),)
        coarse, fine = change(own, 3.0), change(own, 1.5)
        assert off(coarse, fine) < 0.01
        assert off(sharp, fine) > apart


@pytest.fixture(scope="module")
def cells() -> tuple[object, np.ndarray]:
    sheet, electrodes = Sheet(), Electrodes()
    mesh = cell_mesh(sheet, electrodes)
    system = assemble(mesh, sheet, electrodes, bend_metric(BEND, sheet))
    bare = system.factorise()
    matrix = jacobian(bare, np.ones(mesh.n_elements), cell_of_element(mesh, (30, 45)), 1350)
    return system, matrix / bare.voltages()[:, None]


# To first order a touch's change is the Jacobian times log c, so what is left falls with its square, and is even in it.
@pytest.mark.parametrize("border", [0.0, 4.0])
def test_a_weak_touch_changes_voltages_by_the_jacobian_to_first_order(cells, border: float) -> None:
    system, matrix = cells
    bare = system.factorise().voltages()
    pixels = np.zeros((30, 45))
    pixels[12:18, 18:24] = 1.0
    shape = Rect(60.0, 40.0, 80.0, 60.0)
    if border:  # pixels of 3.3 mm say little of a border of 4: half of the outer ones, their corners a quarter
        pixels = np.zeros((30, 45))
        x, y = (np.arange(45) + 0.5) * 10 / 3, (np.arange(30) + 0.5) * 10 / 3
        fine = (np.arange(10) + 0.5) / 3 - 5 / 3
        where = np.stack(np.broadcast_arrays((x[:, None] + fine)[None, None], (y[:, None] + fine)[..., None, None]), -1)
        pixels = plateau(shape.distance_mm(where)[0], border).mean(axis=(1, 3))
    linear = matrix @ pixels.ravel()
    left = []
    for log in (0.02, 0.04, -0.04):
        found = factorise(system, (Touch((shape,), contrast=float(np.exp(log)), border_mm=border),)).voltages()
        left.append((found / bare - 1.0 - log * linear) / np.linalg.norm(linear))
    if border:
        assert max(np.linalg.norm(left[1]), np.linalg.norm(left[2])) < 0.04 * 0.06
        return
    assert np.linalg.norm(left[1]) < 0.04 * 0.05
    assert np.linalg.norm(left[1]) / np.linalg.norm(left[0]) == pytest.approx(4.0, rel=0.1)
    assert np.linalg.norm(left[2] - left[1]) < 0.3 * np.linalg.norm(left[1])  # third order, 4 % of log c apart
