"""Contacts beside the mesh's lines: those on lines are as before, and others cover what they should."""

from dataclasses import replace

import numpy as np
import pytest
from tests.sim.shared_system import shared_system

from eitskin_proto.skin.parts import Map, Outline, Ring
from eitskin_proto.skin.quantity import Quantity
from eitskin_proto.skin.skin import PAPER
from eitskin_proto.skin.toml import named
from eitskin_sim.dataset.plan import make_plan
from eitskin_sim.dataset.shards import make_shard, shard_job
from eitskin_sim.devices.device import IDEAL, ideal
from eitskin_sim.devices.readings import readings, sheet_differences
from eitskin_sim.fem.contacts import check_apart, contacts_of
from eitskin_sim.fem.forward import flat_metric
from eitskin_sim.fem.mesh import TensorMesh
from eitskin_sim.freeform.mesh import shared_mesh
from eitskin_sim.scene.parts import Bend, Electrodes, Sheet
from eitskin_sim.unit_grid.skeleton import unit_system

BEND = Bend(angle_deg=70.0, axis_deg=-30.0, twist_deg=10.0, stretch_along=1.08, stretch_across=0.97, nonuniformity=0.05)
NOMINAL = Electrodes()
SIZES = tuple(np.linspace(3.1, 5.7, 16).tolist())
MOVED = tuple((np.array(NOMINAL.arc_length_mm) + np.linspace(-2.0, 2.0, 16)[np.arange(16) * 7 % 16]).tolist())
LOOSE = Electrodes(size_mm=SIZES, contact_impedance_ohm_m2=tuple(np.geomspace(1e-5, 1e-3, 16)), arc_length_mm=MOVED)


def test_a_contact_covers_its_square_wherever_it_lies() -> None:
    found = contacts_of(shared_mesh().mesh, Sheet(), LOOSE, flat_metric)
    area = np.bincount(found.electrode, found.area_m2)
    assert area == pytest.approx(1e-6 * np.array(SIZES) ** 2, rel=1e-12)
    assert found.mass_m2.sum(axis=(1, 2)) == pytest.approx(found.area_m2, rel=1e-12)
    assert found.impedance_ohm_m2 == pytest.approx(LOOSE.impedances_ohm_m2()[found.electrode])


# On lines it is 0.06 %, here 0.6.
def test_untouched_voltages_are_near_those_of_a_mesh_that_follows_the_contacts() -> None:
    device = replace(IDEAL, electrodes=LOOSE)
    fine = readings(device, sheet_differences(device, BEND))
    coarse = shared_system(BEND, device=device).factorise().voltages()
    assert coarse == pytest.approx(fine, rel=1e-2)
    assert np.abs(fine / readings(IDEAL, sheet_differences(IDEAL, BEND)) - 1.0).max() > 0.05


def test_two_electrodes_in_one_element_are_refused() -> None:
    coarse = TensorMesh(np.array([0.0, 75.0, 150.0]), np.array([0.0, 50.0, 100.0]))
    with pytest.raises(ValueError, match="two electrodes meet one element"):
        check_apart(contacts_of(coarse, Sheet(), LOOSE, flat_metric))


# 16 electrodes of 3 mm round 50 x 50 mm leave 1.75 mm about each corner, less than an element.
def test_electrodes_of_a_small_sheet_may_be_a_little_larger_than_stated() -> None:
    ring = Ring(
        arc_length_mm=Quantity(tuple(float(arc) for arc in 6.25 + 12.5 * np.arange(16))),
        size_mm=Quantity(3.0, "normal", 0.1),
    )
    small = replace(PAPER, outline=Outline(size_mm=(50.0, 50.0)), electrodes=ring, map=Map((15, 15), (5, 5)))
    own = ideal(small)
    larger = replace(own, electrodes=replace(own.electrodes, size_mm=3.3))
    fine = readings(larger, sheet_differences(larger, BEND))
    for system in (shared_system(BEND, device=larger, skin=small), unit_system(BEND, device=larger, skin=small)[1]):
        assert system.factorise().voltages() == pytest.approx(fine, rel=3e-2)


def test_a_contact_covers_its_length_wherever_it_lies_and_a_corner_is_one_piece() -> None:
    moved = (np.array(NOMINAL.arc_length_mm) - 12.0 + np.linspace(-1.7, 1.7, 16)[np.arange(16) * 7 % 16]) % 500.0
    loose = Electrodes("edge", size_mm=tuple(np.linspace(3.1, 5.7, 16).tolist()), arc_length_mm=tuple(moved.tolist()))
    found = contacts_of(shared_mesh().mesh, Sheet(), loose, flat_metric)
    area = np.bincount(found.electrode, found.area_m2)
    assert area == pytest.approx(1e-6 * loose.sizes_mm() * Sheet().thickness_mm, rel=1e-12)
    assert found.mass_m2.sum(axis=(1, 2)) == pytest.approx(found.area_m2, rel=1e-12)
    assert len(np.unique(found.element)) == len(found.element)
    corner = found.load_m2[(found.electrode == 0) & (found.element == 0)]
    assert len(corner) == 1
    assert np.all(corner[0][[1, 3]] > 0.0)  # the middles of the sides on either side of the corner


def test_two_electrodes_in_one_corner_are_refused() -> None:
    arc = np.concatenate([[2.0], NOMINAL.arc_length_mm[1:15], [498.0]])  # they meet in the corner (0, 0)
    close = replace(PAPER, electrodes=Ring(contact="edge", arc_length_mm=Quantity(tuple(arc.tolist()))))
    with pytest.raises(ValueError, match="two electrodes meet one element; expected them further apart"):
        shared_mesh(skin=close)


@pytest.mark.slow
@pytest.mark.parametrize("set_name", ["free", "units"])
def test_a_data_set_of_random_devices_takes_contacts_on_the_edge(set_name: str) -> None:
    lab = named("lab")
    plan = make_plan(
        set_name, deformations=1, kept=0, per_deformation=20, touches="both", devices="random",
        skin=replace(lab, electrodes=replace(lab.electrodes, contact="edge")),
        touch_sets=None if set_name == "free" else 40,
    )  # fmt: skip
    voltages = make_shard(shard_job(plan, [0]))[0]["voltages"]
    assert voltages.shape == (20, 104)
    assert np.isfinite(voltages).all()
