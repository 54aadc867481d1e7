"""Contacts by the modes of depth, against closed forms, symmetries and conservation; the solid is in test_slab."""

from dataclasses import replace

import numpy as np
import pytest

from eitskin_sim.fem import depth
from eitskin_sim.fem.forward import reciprocity_error
from eitskin_sim.fem.solve import factorise_scene, solve_scene
from eitskin_sim.scene.parts import Bend, Electrodes, Scene, Touch
from eitskin_sim.scene.shapes import Rect

pytestmark = pytest.mark.heavy

UNDER = Touch((Rect(8.0, 0.0, 13.0, 10.0),))
"""Its border cuts the contact of electrode 0."""


def test_poles_add_up_to_all_modes() -> None:
    weights, places = depth.poles()
    assert len(weights) <= 12
    assert np.all(weights > 0)
    for k in (0.1, 1.0, np.pi, 30.0, 200.0):
        n = np.arange(1, 2_000_001)
        modes = float(np.sum(2.0 / (k**2 + (n * np.pi) ** 2)))
        assert modes == pytest.approx(1 / (k * np.tanh(k)) - 1 / k**2, rel=1e-4)
        # 4e-4 of what the fringe adds, which is 2 % of a voltage: 1e-5.
        assert float(np.sum(weights / (k**2 + places))) == pytest.approx(modes, rel=5e-4)


def test_modes_are_reciprocal_and_put_one_ampere_in() -> None:
    scene = Scene(bend=Bend(twist_deg=30, stretch_along=1.1), touches=(UNDER,), element_size_mm=6.0)
    factor = factorise_scene(scene, "modes")
    assert reciprocity_error(factor) < 1e-12
    found = np.zeros((16, 16))
    for plate in factor.plates:
        drop = factor.electrode_fields[plate.electrodes] - factor.node_fields[plate.nodes]
        np.add.at(found, plate.electrodes, plate.admittance @ drop)
    np.testing.assert_allclose(found, np.eye(16) - np.roll(np.eye(16), 1, axis=0), atol=1e-8)


def test_one_constant_stands_for_the_modes_within_its_stated_error() -> None:
    scene = Scene(element_size_mm=3.0)
    error = solve_scene(scene).voltages / solve_scene(scene, "modes").voltages - 1
    assert 5e-4 < np.abs(error).max() < 2.5e-3  # 1.7e-3 was measured
    edge = replace(scene, electrodes=Electrodes("edge"))
    assert np.array_equal(solve_scene(edge).voltages, solve_scene(edge, "modes").voltages)
