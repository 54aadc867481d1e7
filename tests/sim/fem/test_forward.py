from dataclasses import replace

import numpy as np
import pytest

from eitskin_sim.fem.forward import assemble, reciprocity_error
from eitskin_sim.fem.mesh import TensorMesh, graded_lines
from eitskin_sim.fem.solve import factorise_scene, solve_scene
from eitskin_sim.scene.parts import Bend, Electrodes, Scene, Sheet, Touch
from eitskin_sim.scene.shapes import Disc, Rect

COARSE = 3.0
TOUCHES = (Touch((Rect(20.0, 30.0, 33.0, 41.0),)), Touch((Disc(100.0, 60.0, 7.0),), 5.0))


@pytest.mark.parametrize("contact", ["patch", "edge"])
def test_every_drive_puts_one_ampere_in_one_electrode_and_out_of_the_next(contact: str) -> None:
    scene = Scene(electrodes=Electrodes(contact), touches=TOUCHES, element_size_mm=COARSE)
    factor = factorise_scene(scene)
    contacts = factor.system.contacts
    inward = -np.einsum("m,mi,mik->mk", factor.density, contacts.load_m2, factor.contact_drops())
    found = np.zeros((16, 16))
    np.add.at(found, contacts.electrode, inward)
    np.testing.assert_allclose(found, np.eye(16) - np.roll(np.eye(16), 1, axis=0), atol=1e-8)


@pytest.mark.parametrize("contact", ["patch", pytest.param("edge", marks=pytest.mark.slow)])
def test_voltages_converge_and_meet_their_target(contact: str) -> None:
    scene = Scene(electrodes=Electrodes(contact))
    sizes = (6.0, 3.0, 1.5)
    fine = solve_scene(replace(scene, element_size_mm=1.0)).voltages
    error = [np.abs(solve_scene(replace(scene, element_size_mm=size)).voltages / fine - 1).max() for size in sizes]
    slope = np.log2(np.array(error[:-1]) / error[1:])
    assert slope.min() > 2.0, (error, slope)
    assert error[2] < 3e-5  # 1e-5 was measured; the target is 1e-4
    assert error[1] < 2e-4


@pytest.mark.parametrize("contact", ["patch", "edge"])
@pytest.mark.parametrize(
    "bend",
    [
        Bend(angle_deg=350, axis_deg=90),
        Bend(angle_deg=270, axis_deg=20, skew=1.0),
    ],
)
def test_bend_without_stretch_changes_no_voltage(contact: str, bend: Bend) -> None:
    flat = Scene(electrodes=Electrodes(contact), touches=TOUCHES, element_size_mm=6.0)
    assert np.array_equal(solve_scene(replace(flat, bend=bend)).voltages, solve_scene(flat).voltages)


def test_electrode_may_go_round_a_corner_when_it_lies_on_the_border() -> None:
    positions = tuple(31.25 * k for k in range(16))
    scene = Scene(electrodes=Electrodes("edge", arc_length_mm=positions), element_size_mm=COARSE)
    factor = factorise_scene(scene)
    contacts = factor.system.contacts
    corner = contacts.electrode == 0
    assert len(np.unique(contacts.element[corner])) >= 3
    assert contacts.area_m2[corner].sum() == pytest.approx(4e-3 * 2e-3, rel=1e-12)
    assert reciprocity_error(factor) < 1e-12


def test_mesh_that_misses_the_sheet_is_refused() -> None:
    sheet, electrodes = Sheet(), Electrodes()
    with pytest.raises(ValueError, match="must go from 0 to 150"):
        assemble(TensorMesh(np.linspace(0, 149, 40), np.linspace(0, 100, 30)), sheet, electrodes)
    with pytest.raises(ValueError, match="ascending"):
        TensorMesh(np.array([0.0, 2.0, 1.0]), np.array([0.0, 1.0]))


def test_lines_hold_every_fixed_position_and_halve_with_the_density() -> None:
    fixed = [(0.0, 0.3), (10.0, 0.1), (10.0 + 1e-8, 0.2), (14.0, 0.1), (60.0, 0.5)]
    coarse, fine = graded_lines(fixed, 4.0), graded_lines(fixed, 4.0, 2.0)
    for lines in (coarse, fine):
        assert np.all(np.diff(lines) > 0)
        assert all(np.abs(lines - at).min() < 1e-7 for at, _ in fixed)
    assert np.diff(coarse).max() < 4.0 * 1.01
    steps = np.diff(coarse)
    assert np.max(np.maximum(steps[1:] / steps[:-1], steps[:-1] / steps[1:])) < np.exp(0.8) * 1.01
    assert len(fine) == pytest.approx(2 * len(coarse), rel=0.1)
