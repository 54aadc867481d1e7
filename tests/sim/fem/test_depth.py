"""Contacts by the modes of depth, against closed forms, symmetries and conservation; the solid is in test_slab."""

from dataclasses import replace

import numpy as np
import pytest

from eitskin_sim.fem import depth
from eitskin_sim.fem.forward import flat_metric, reciprocity_error
from eitskin_sim.fem.solve import factorise_scene, solve_scene
from eitskin_sim.scene.bend import bend_metric
from eitskin_sim.scene.electrodes import Piece
from eitskin_sim.scene.parts import Bend, Electrodes, Scene, Sheet, Touch
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


@pytest.mark.parametrize("stretch", [1.0, 1.2])
def test_contact_over_a_whole_sheet_adds_a_third_of_its_thickness(stretch: float) -> None:
    # A current that enters evenly from above falls off linearly through the layer: its mean drop is t / (3 sigma).
    sheet, impedance = Sheet((8.0, 8.0), 3.0, 0.5), 2e-4
    scene = Scene(sheet, Electrodes(size_mm=8.0, contact_impedance_ohm_m2=impedance), Bend(stretch_along=stretch))
    metric = bend_metric(scene.bend, sheet)
    window = depth._window(scene, metric, (0.0, 0.0, 8.0, 8.0), [Piece(0, 0, 0.0, 8.0)])
    admittance = depth._admittance(window)
    area, thickness = 64e-6 * stretch, 3e-3 / stretch
    expected = area / (impedance + thickness / (3 * 0.5))
    assert float(admittance.sum()) == pytest.approx(expected, rel=4e-4)  # the poles' own error


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


def test_contacts_that_touch_share_a_window_and_far_ones_do_not() -> None:
    apart = Scene()
    assert [len(pieces) for _, pieces in depth._groups(apart)] == [1] * 16
    positions = (10.0, 14.0, *(33.0 + 30.0 * k for k in range(14)))
    close = Scene(electrodes=Electrodes(arc_length_mm=positions), element_size_mm=6.0)
    assert sorted(len(pieces) for _, pieces in depth._groups(close)) == [1] * 14 + [2]
    assert reciprocity_error(factorise_scene(close, "modes")) < 1e-12
    (pair,) = [
        plate
        for plate in depth.plates(factorise_scene(close).system, close, flat_metric)
        if len(set(plate.electrodes)) == 2
    ]
    assert len(np.unique(pair.nodes)) < len(pair.nodes)  # the nodes on their common edge stand there twice
