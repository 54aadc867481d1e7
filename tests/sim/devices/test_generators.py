"""Both generators on a device with everything off: exact on their mesh, near a scene's, touches both ways.

Contacts are patches, or lie on the edge, one of them round a corner.
"""

from dataclasses import replace

import numpy as np
import pytest

from eitskin_proto.skin.skin import Skin
from eitskin_proto.skin.toml import named
from eitskin_sim.devices.device import Device
from eitskin_sim.devices.draws import draw_device
from eitskin_sim.devices.readings import corrected, drive_differences, readings, responses_of, sheet_differences
from eitskin_sim.fem.forward import Factor
from eitskin_sim.fem.solve import solve_scene
from eitskin_sim.freeform.sheet import InvertedSheet, inverted_sheet, sheet_blocks
from eitskin_sim.freeform.voltages import set_responses
from eitskin_sim.measurement.front_end import to_voltages
from eitskin_sim.scene.parts import Bend, Electrodes, LaterChanges, Scene, SmoothField, Touch
from eitskin_sim.scene.shapes import Rect
from eitskin_sim.scene.touch_table import DISC, ELLIPSE, RECTANGLE, gather
from eitskin_sim.unit_grid.skeleton import unit_system
from eitskin_sim.unit_grid.units import UnitGenerator

BEND = Bend(angle_deg=70.0, axis_deg=-30.0, twist_deg=10.0, stretch_along=1.08, stretch_across=0.97, nonuniformity=0.05)
SETS = {
    "a press by a corner": [[ELLIPSE, 11.0, 9.0, 16.0, 10.0, 40.0, 0.3, 3.0]],
    "a soft press on a contact": [[DISC, 12.5, 8.0, 16.0, 16.0, 0.0, 0.4, 6.0]],
    "a hard touch on a contact's end": [[RECTANGLE, 49.0, 8.0, 10.0, 16.0, 25.0, 50.0, 0.0]],
    "both ways": [[DISC, 40.0, 40.1, 16.0, 16.0, 0.0, 0.4, 0.0], [RECTANGLE, 100.0, 60.0, 12.0, 12.0, 0.0, 50.0, 0.0]],
}
TOUCHES = gather([np.array(pieces) for pieces in SETS.values()])


@pytest.fixture(scope="module", params=["patch", pytest.param("edge", marks=pytest.mark.slow)])
def skin(request: pytest.FixtureRequest) -> Skin:
    lab = named("lab")
    if request.param == "patch":
        return lab
    arc = replace(lab.electrodes.arc_length_mm, value=tuple((np.array(Electrodes().arc_length_mm) - 12.0).tolist()))
    return replace(lab, electrodes=replace(lab.electrodes, contact="edge", arc_length_mm=arc))


@pytest.fixture(scope="module")
def device(skin: Skin) -> Device:
    found = draw_device(skin, np.random.default_rng(2)).device
    assert found.sheet.gauge_factor
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
    fast = to_voltages(set_responses([sheet], TOUCHES, electrodes=device.electrodes, skin=skin)[0])
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


def test_untouched_readings_are_those_of_the_fine_mesh(device: Device, sheet: InvertedSheet, ratio: np.ndarray) -> None:
    fine = sheet_differences(device, BEND)
    again = drive_differences(responses_of(corrected(drive_differences(sheet.at_terminals), ratio)))
    assert again == pytest.approx(fine, rel=1e-9)
    assert np.abs(drive_differences(sheet.at_terminals) / fine - 1.0).max() > 1e-4
