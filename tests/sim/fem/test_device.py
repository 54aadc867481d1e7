"""The forward model of a sheet as it is: closed forms, scaling, mirrors, and the layer given element by element."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from eitskin_sim.fem.forward import assemble
from eitskin_sim.fem.mesh import TensorMesh, graded_lines
from eitskin_sim.fem.meshing import electrode_lines, scene_mesh
from eitskin_sim.fem.solve import Law, factorise_scene, solve_scene
from eitskin_sim.measurement.faults import response_of
from eitskin_sim.scene.bend import bend_metric
from eitskin_sim.scene.layer import relative_conductivity
from eitskin_sim.scene.parts import Bend, Electrodes, LaterChanges, Scene, Sheet, SmoothField, Touch
from eitskin_sim.scene.shapes import Disc, Rect

COARSE = 6.0
TOUCHES = (
    Touch((Rect(8.0, 0.0, 22.0, 14.0),), 20.0),
    Touch((Disc(60.0, 45.0, 8.0),), 5.0),
    Touch((Disc(100.0, 60.0, 9.0),), contrast=0.4, border_mm=4.0),
)
"""Sharp ones on a contact and across elements, and a graded one."""

BENT = Bend(angle_deg=90, axis_deg=20, twist_deg=20, stretch_along=1.1, stretch_across=0.97, nonuniformity=0.05)
FIELD = SmoothField(0.2, 40.0, 7)
DEVICE = Sheet(gauge_factor=1.0, field=FIELD, late=LaterChanges(1.2, 0.05, SmoothField(0.05, 60.0, 8), 9))
SCATTERED = Electrodes(
    size_mm=tuple(4.0 + 0.25 * (k % 3) for k in range(16)),
    contact_impedance_ohm_m2=tuple(1e-4 * (1 + k % 5) for k in range(16)),
    arc_length_mm=tuple(12.5 + 31.25 * k + 0.75 * np.sin(5.0 * k) for k in range(16)),
)


def conducting(scene: Scene, factor: float) -> Scene:
    """Return a scene whose contacts conduct ``factor`` times as well."""
    electrodes = scene.electrodes
    lower = tuple((electrodes.impedances_ohm_m2() / factor).tolist())
    return replace(scene, electrodes=replace(electrodes, contact_impedance_ohm_m2=lower))


@pytest.mark.parametrize(
    ("contact", "law"),
    [("patch", "constant"), ("edge", "constant"), pytest.param("patch", "modes", marks=pytest.mark.slow)],
)
def test_an_even_factor_divides_voltages_under_touches_too(contact: str, law: Law) -> None:
    bend, touches = (BENT, TOUCHES) if law == "constant" else (Bend(), TOUCHES[:1])  # a bend's windows all differ
    scene = Scene(electrodes=Electrodes(contact), bend=bend, touches=touches, element_size_mm=COARSE)
    drifted = conducting(replace(scene, sheet=Sheet(late=LaterChanges(1.3))), 1.3)
    np.testing.assert_allclose(solve_scene(drifted, law).voltages * 1.3, solve_scene(scene, law).voltages, rtol=1e-8)


@pytest.mark.parametrize("k", [-1.0, 2.0])
def test_under_an_even_stretch_the_gauge_is_a_factor(k: float) -> None:
    scene = Scene(bend=Bend(stretch_along=1.2, stretch_across=0.9), touches=TOUCHES, element_size_mm=COARSE)
    factor = (1.2 * 0.9) ** -k
    gauged = conducting(replace(scene, sheet=Sheet(gauge_factor=k)), factor)
    np.testing.assert_allclose(solve_scene(gauged).voltages * factor, solve_scene(scene).voltages, rtol=1e-8)


def bar(impedances: np.ndarray, sheet: Sheet, bend: Bend) -> np.ndarray:
    """Return the (16,) V of a bar of 80 x 32 mm driven end to end; eight "edge" electrodes share either end evenly."""
    arcs = [80.0 + 4.0 * (k + 0.5) for k in range(8)] + [192.0 + 4.0 * (k + 0.5) for k in range(8)]
    electrodes = Electrodes("edge", 4.0, tuple(impedances.tolist()), tuple(arcs))
    x, y = electrode_lines(sheet, electrodes)
    mesh = TensorMesh(graded_lines(x, 4.0, 0.5), graded_lines(y, 4.0, 0.5))
    factor = assemble(mesh, sheet, electrodes, bend_metric(bend, sheet)).factorise()
    return np.asarray(factor.electrode_fields @ np.cumsum(np.repeat([1.0, -1.0], 8) / 8))


def test_a_stretched_bar_with_a_gauge_and_contacts_of_their_own_in_closed_form() -> None:
    # Each electrode carries an eighth of the current evenly, so its own impedance adds to its own potential alone.
    along, across, k = 1.3, 0.9, 1.5
    sheet = Sheet((80.0, 32.0), 2.0, 0.7, gauge_factor=k)
    impedances = np.linspace(0.5e-4, 4e-4, 16)
    found = bar(impedances, sheet, Bend(stretch_along=along, stretch_across=across))
    section = 32e-3 * across * 2e-3 / (along * across)
    conductivity = 0.7 * (along * across) ** -k
    own = np.repeat([1.0, -1.0], 8) * (80e-3 * along / (conductivity * section) / 2 + impedances / section)
    np.testing.assert_allclose(found - found[15], own - own[15], rtol=1e-9, atol=1e-11 * own[0])


@pytest.mark.parametrize("contact", ["patch", "edge"])
def test_a_high_contact_impedance_adds_to_its_electrodes_self_term_only(contact: str) -> None:
    # Above the sheet's own resistance the current spreads evenly over a contact, and z / area stands in the wire.
    high = 10.0
    more = tuple(high * (3.0 if k == 4 else 1.0) for k in range(16))
    before, after = (
        response_of(factorise_scene(Scene(electrodes=Electrodes(contact, 4.0, z), element_size_mm=COARSE)))
        for z in (high, more)
    )
    expected = np.zeros((16, 16))
    expected[4, 4] = 2.0 * high / (16e-6 if contact == "patch" else 8e-6)
    change = (after - before) - (after - before)[:1]  # potentials are known up to a constant in every drive
    np.testing.assert_allclose(change, expected, atol=1e-6 * expected[4, 4])


@cache
def meshed(size_mm: float) -> np.ndarray:
    scene = Scene(DEVICE, SCATTERED, BENT, TOUCHES[:2], element_size_mm=size_mm)
    return solve_scene(scene).voltages


@pytest.mark.slow
def test_a_device_converges_as_the_mesh_is_refined() -> None:
    best = meshed(0.75)
    errors = [np.sqrt(np.mean((meshed(size) / best - 1.0) ** 2)) for size in (6.0, 3.0, 1.5)]
    assert errors[0] < 1e-2
    assert errors[2] < errors[1] / 3 < errors[0] / 6


@pytest.mark.parametrize("contact", ["patch", "edge"])
def test_an_uneven_layer_is_what_its_elements_conductivities_say(contact: str) -> None:
    scene = Scene(DEVICE, Electrodes(contact), BENT, element_size_mm=3.0)
    metric, mesh = bend_metric(BENT, DEVICE), scene_mesh(scene)
    exact = assemble(mesh, DEVICE, scene.electrodes, metric).factorise().voltages()
    centres = mesh.centres_mm
    each = relative_conductivity(DEVICE, centres, metric(centres))
    blocky = assemble(mesh, Sheet(), scene.electrodes, metric).factorise(each).voltages()
    even = assemble(mesh, Sheet(), scene.electrodes, metric).factorise().voltages()
    assert np.abs(exact / blocky - 1.0).max() < 5e-3
    assert np.abs(exact / even - 1.0).max() > 0.1


def test_contacts_have_the_areas_and_impedances_of_their_electrodes() -> None:
    for contact in ("patch", "edge"):
        scene = Scene(electrodes=replace(SCATTERED, contact=contact), element_size_mm=COARSE)
        contacts = factorise_scene(scene).system.contacts
        sizes, found = SCATTERED.sizes_mm() * 1e-3, np.zeros(16)
        np.add.at(found, contacts.electrode, contacts.area_m2)
        np.testing.assert_allclose(found, sizes**2 if contact == "patch" else sizes * 2e-3, rtol=1e-9)
        np.testing.assert_array_equal(contacts.impedance_ohm_m2, SCATTERED.impedances_ohm_m2()[contacts.electrode])


def test_a_reference_is_before_what_came_late_and_knows_the_rest() -> None:
    scene = Scene(DEVICE, SCATTERED, BENT, TOUCHES, element_size_mm=COARSE)
    reference = scene.reference()
    assert reference == Scene(replace(DEVICE, late=None), SCATTERED, element_size_mm=COARSE)
    found = solve_scene(reference).voltages
    nothing_came = replace(reference, sheet=replace(DEVICE, late=LaterChanges()))
    np.testing.assert_array_equal(solve_scene(nothing_came).voltages, found)
    assert np.abs(solve_scene(replace(reference, sheet=DEVICE)).voltages / found - 1.0).max() > 0.05
