"""Contacts on the sheet's edge, beside the mesh's lines and round corners, as exact as patches in both generators."""

from dataclasses import fields, replace

import numpy as np
import pytest
from tests.sim.shared_system import shared_system

from eitskin_proto.skin.parts import Ring
from eitskin_proto.skin.quantity import Quantity
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_proto.skin.toml import named
from eitskin_sim.dataset.plan import make_plan
from eitskin_sim.dataset.shards import make_shard, shard_job
from eitskin_sim.devices.device import Device
from eitskin_sim.devices.draws import draw_device
from eitskin_sim.devices.loose_contacts import loose_contacts
from eitskin_sim.devices.readings import corrected, drive_differences, readings, sheet_differences
from eitskin_sim.fem.forward import Factor, flat_metric
from eitskin_sim.fem.solve import solve_scene
from eitskin_sim.freeform.mesh import shared_mesh
from eitskin_sim.freeform.sheet import InvertedSheet, inverted_sheet, sheet_blocks
from eitskin_sim.freeform.voltages import set_responses, set_voltages
from eitskin_sim.scene.bend import bend_metric
from eitskin_sim.scene.parts import Bend, Electrodes, LaterChanges, Scene, Sheet, SmoothField, Touch
from eitskin_sim.scene.shapes import Rect
from eitskin_sim.scene.touch_table import DISC, ELLIPSE, RECTANGLE, gather
from eitskin_sim.unit_grid.skeleton import unit_system
from eitskin_sim.unit_grid.units import UnitGenerator

BEND = Bend(angle_deg=70.0, axis_deg=-30.0, twist_deg=10.0, stretch_along=1.08, stretch_across=0.97, nonuniformity=0.05)
EVEN = np.array(Electrodes().arc_length_mm)
SETS = {
    "a press": [[DISC, 71.3, 52.1, 16.0, 16.0, 0.0, 0.4, 4.0]],
    "a hard touch": [[RECTANGLE, 71.3, 52.1, 16.0, 16.0, 25.0, 20.0, 0.0]],
    "a soft press on a contact": [[DISC, 12.5, 8.0, 16.0, 16.0, 0.0, 0.4, 6.0]],
    "a hard touch on a contact's end": [[RECTANGLE, 49.0, 8.0, 10.0, 16.0, 0.0, 50.0, 0.0]],
    "a press by a corner": [[ELLIPSE, 11.0, 9.0, 16.0, 10.0, 40.0, 0.3, 3.0]],
    "both ways": [[DISC, 40.0, 40.1, 16.0, 16.0, 0.0, 0.4, 0.0], [RECTANGLE, 100.0, 60.0, 12.0, 12.0, 0.0, 50.0, 0.0]],
}
TOUCHES = gather([np.array(pieces) for pieces in SETS.values()])


def skin_of(shift_mm: float) -> Skin:
    lab = named("lab")
    arc = replace(lab.electrodes.arc_length_mm, value=tuple((EVEN + shift_mm).tolist()))
    return replace(lab, electrodes=replace(lab.electrodes, contact="edge", arc_length_mm=arc))


@pytest.fixture(scope="module", params=[0.0, -12.0], ids=["on the sides", "one round a corner"])
def skin(request: pytest.FixtureRequest) -> Skin:
    return skin_of(request.param)


@pytest.fixture(scope="module")
def device(skin: Skin) -> Device:
    found = draw_device(skin, np.random.default_rng(2)).device
    assert found.electrodes.contact == "edge"
    assert found.sheet.field is not None
    return found.since(LaterChanges(factor=0.93, gradient_rms=0.03, field=SmoothField(0.04, 40.0, 5)))


@pytest.fixture(scope="module")
def sheet(skin: Skin, device: Device) -> InvertedSheet:
    return inverted_sheet(BEND, device=device, skin=skin)


@pytest.fixture(scope="module")
def ratio(device: Device, sheet: InvertedSheet) -> np.ndarray:
    return np.where(np.eye(16), 1.0, sheet_differences(device, BEND) / drive_differences(sheet.at_terminals))


@pytest.fixture(scope="module")
def bare(device: Device) -> np.ndarray:
    return of_scene(device, ())


def of_scene(device: Device, touches: tuple[Touch, ...]) -> np.ndarray:
    scene = Scene(device.sheet, device.electrodes, BEND, touches, element_size_mm=3.0)
    return np.asarray(solve_scene(scene).voltages)


def test_voltages_are_those_of_one_factorisation_a_sample(skin: Skin, device: Device, sheet: InvertedSheet) -> None:
    assert sheet.untouched_V == pytest.approx(sheet.system.factorise().voltages(), rel=1e-9)
    fast = set_voltages([sheet], TOUCHES, electrodes=device.electrodes, skin=skin)[0]
    for name, number, row in zip(SETS, range(len(SETS)), fast, strict=True):
        naive = Factor(sheet.system, *sheet_blocks(sheet, TOUCHES, number)).voltages()
        assert row == pytest.approx(naive, rel=1e-9), name


# As for patches; measured are 0.4 to 2.3 %.
@pytest.mark.parametrize("number", range(len(SETS)), ids=list(SETS))
def test_free_touches_are_near_a_scene_of_the_same_device(
    skin: Skin, device: Device, sheet: InvertedSheet, ratio: np.ndarray, bare: np.ndarray, number: int
) -> None:
    own = TOUCHES.chosen(np.array([number]))
    response = set_responses([sheet], own, electrodes=device.electrodes, skin=skin)[0, 0]
    plain = Device(device.sheet, device.electrodes)  # a scene has no front end
    found = readings(plain, corrected(drive_differences(response), ratio))
    found = found / readings(plain, sheet_differences(device, BEND)) - 1.0
    exact = of_scene(device, TOUCHES.touches(number)) / bare - 1.0
    assert np.linalg.norm(found - exact) < 0.05 * np.linalg.norm(exact)
    assert np.linalg.norm(exact) > 0.1


@pytest.fixture(scope="module")
def units(skin: Skin, device: Device) -> UnitGenerator:
    return UnitGenerator(BEND, device=device, skin=skin)


def test_units_are_exact_and_near_a_scene_of_the_same_device(
    skin: Skin, device: Device, units: UnitGenerator, bare: np.ndarray
) -> None:
    bits, contrast = np.zeros((2, 126), dtype=np.bool_), np.ones((2, 126))
    bits[0, [20, 21]] = bits[1, 1] = True
    contrast[0, [20, 21]], contrast[1, 1] = 50.0, 0.4
    parts, system = unit_system(BEND, device=device, skin=skin)
    for own, sigma, row in zip(bits, contrast, units.voltages(bits, contrast), strict=True):
        assert row == pytest.approx(system.factorise(sigma[parts.unit_of_element]).voltages(), rel=1e-9)
        shapes = [Rect(*skin.grid.unit_rect_mm(int(at) % 14, int(at) // 14)) for at in np.flatnonzero(own)]
        exact = of_scene(device, (Touch(tuple(shapes), contrast=float(sigma[own][0])),)) / bare - 1.0
        assert np.linalg.norm(row / units.untouched_V - 1.0 - exact) < 0.02 * np.linalg.norm(exact)


def test_contacts_on_lines_are_those_that_follow_them() -> None:
    edges = replace(PAPER, electrodes=Ring(contact="edge"))
    on_lines = shared_system(BEND, skin=edges).contacts
    loose = loose_contacts(shared_mesh(skin=edges).mesh, Sheet(), Electrodes("edge"), bend_metric(BEND, Sheet()))
    for name in (own.name for own in fields(loose)):
        expected, found = getattr(on_lines, name), getattr(loose, name)
        assert found == pytest.approx(expected, rel=1e-12, abs=1e-13 * np.abs(expected).max()), name


def test_a_contact_covers_its_length_wherever_it_lies_and_a_corner_is_one_piece() -> None:
    moved = (EVEN - 12.0 + np.linspace(-1.7, 1.7, 16)[np.arange(16) * 7 % 16]) % 500.0
    loose = Electrodes("edge", size_mm=tuple(np.linspace(3.1, 5.7, 16).tolist()), arc_length_mm=tuple(moved.tolist()))
    found = loose_contacts(shared_mesh().mesh, Sheet(), loose, flat_metric)
    area = np.bincount(found.electrode, found.area_m2)
    assert area == pytest.approx(1e-6 * loose.sizes_mm() * Sheet().thickness_mm, rel=1e-12)
    assert found.mass_m2.sum(axis=(1, 2)) == pytest.approx(found.area_m2, rel=1e-12)
    assert len(np.unique(found.element)) == len(found.element)
    corner = found.load_m2[(found.electrode == 0) & (found.element == 0)]
    assert len(corner) == 1
    assert np.all(corner[0][[1, 3]] > 0.0)  # the middles of the sides on either side of the corner


def test_two_electrodes_in_one_corner_are_refused() -> None:
    arc = np.concatenate([[2.0], EVEN[1:15], [498.0]])  # they meet in the corner (0, 0)
    close = replace(PAPER, electrodes=Ring(contact="edge", arc_length_mm=Quantity(tuple(arc.tolist()))))
    with pytest.raises(ValueError, match="two electrodes meet one element; expected electrodes further apart"):
        shared_mesh(skin=close)


@pytest.mark.parametrize("set_name", ["free", "units"])
def test_a_data_set_of_random_devices_takes_them(set_name: str) -> None:
    plan = make_plan(
        set_name, deformations=1, kept=0, per_deformation=20, touches="both", devices="random", skin=skin_of(0.0),
        touch_sets=None if set_name == "free" else 40,
    )  # fmt: skip
    voltages = make_shard(shard_job(plan, [0]))[0]["voltages"]
    assert voltages.shape == (20, 104)
    assert np.isfinite(voltages).all()
