"""What must hold for any sheet, bend and touch: scaling, the two mirror planes, reciprocity, and linearity.

Every property is drawn by hypothesis and stands on physics alone; none compares with stored numbers. The counter-cases
at the end show that the tolerances would notice a violation.
"""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import Phase, assume, example, given, settings
from hypothesis import strategies as st

from eitskin_proto.sensor.table import TABLE
from eitskin_sim.evaluation.harness import Case, Sheet, solve_tikhonov
from eitskin_sim.fem.forward import reciprocity_error
from eitskin_sim.fem.solve import factorise_scene, solve_scene
from eitskin_sim.scene.parts import Bend, Electrodes, Scene, Touch
from eitskin_sim.scene.shapes import Disc, Rect
from eitskin_sim.solvers.operators import build_operators, linear_data

COARSE_MM = 6.0
"""Invariants hold on any mesh; this one takes 30 ms."""

FEW = settings(max_examples=6, deadline=None, derandomize=True, phases=(Phase.explicit, Phase.generate))
"""Each example solves; derandomised, so that every run is the same, and not shrunk, which would solve hundreds more."""

MANY = settings(max_examples=50, deadline=None, derandomize=True)
"""Each example is a product of small matrices."""

sizes = st.floats(1e-3, 1e3)
contacts = st.sampled_from(["patch", "edge"])
bends = st.builds(
    Bend,
    angle_deg=st.floats(0.0, 300.0),
    axis_deg=st.floats(-90.0, 90.0),
    twist_deg=st.floats(-40.0, 40.0),
    stretch_along=st.floats(0.8, 1.5),
    stretch_across=st.floats(0.8, 1.3),
    nonuniformity=st.floats(-0.2, 0.2),
)
conductivities = st.floats(1e-4, 1e6)


@st.composite
def touches(draw, discs: bool = True):
    """Up to three rectangles and discs of any contrast, on the sheet, border and contacts included."""
    found = []
    for _ in range(draw(st.integers(0, 3))):
        # In steps of 0.01 mm: borders that lie 1e-6 apart are one line of the mesh or two, as rounding will have it.
        x, y = draw(st.integers(0, 13_800)) / 100.0, draw(st.integers(0, 8_800)) / 100.0
        shape = Disc(x + 6.0, y + 6.0, 6.0) if discs and draw(st.booleans()) else Rect(x, y, x + 12.0, y + 12.0)
        # Beyond 100 rounding decides whether FLOOR holds the enrichment of an element that a disc cuts: 1e-4 of V.
        drawn = draw(st.floats(1e-2, 1e2) if isinstance(shape, Disc) else conductivities)
        assume(abs(drawn - 1.0) > 1e-5)  # a touch like the sheet is refused
        found.append(Touch((shape,), drawn))
    return tuple(found)


scenes = st.builds(
    Scene, electrodes=st.builds(Electrodes, contacts), bend=bends, touches=touches(), element_size_mm=st.just(COARSE_MM)
)


def scaled(scene: Scene, factor: float) -> Scene:
    """Return a scene that conducts ``factor`` times as well everywhere, its contacts too."""
    electrodes = scene.electrodes
    return replace(
        scene,
        sheet=replace(scene.sheet, conductivity_S_per_m=factor * scene.sheet.conductivity_S_per_m),
        electrodes=replace(electrodes, contact_impedance_ohm_m2=tuple(electrodes.impedances_ohm_m2() / factor)),
        touches=tuple(replace(t, conductivity_S_per_m=factor * t.conductivity_S_per_m) for t in scene.touches),
    )


@FEW
@given(scenes, sizes, sizes)
def test_voltages_scale_with_current_over_conductivity(scene, factor, current):
    found = solve_scene(replace(scaled(scene, factor), current_A=current)).voltages
    # Only rounding differs: every entry of the system is multiplied by one number. The factorisation keeps 1e-9.
    np.testing.assert_allclose(found, solve_scene(scene).voltages * current / factor, rtol=1e-8)


@FEW
@given(scenes)
def test_drive_and_measure_can_be_swapped_on_any_sheet(scene):
    # 1e-12 holds at contrasts up to 50; at 1e10 between touches rounding in the stiffest element reaches the weak rows.
    assert reciprocity_error(factorise_scene(scene)) < 1e-8


def mirrored_row(along_x: bool):
    """Return (104, 2) the drive and measure that each row becomes in a mirror.

    Electrode k, at arc length 12.5 + 31.25 k, goes to 4 - k where x is mirrored and to 12 - k where y is, modulo 16;
    a pair (k, k + 1) goes to (4 - k - 1, 4 - k) turned round, twice in each row, so the sign stays.
    """
    return ((3 if along_x else 11) - TABLE.astype(int)) % 16


def mirror(shape, along_x: bool):
    """Return a rectangle or disc on the other side of a mirror plane of the 150 x 100 sheet."""
    if isinstance(shape, Disc):
        return replace(shape, x_mm=150.0 - shape.x_mm) if along_x else replace(shape, y_mm=100.0 - shape.y_mm)
    x0, y0, x1, y1 = shape.bounds_mm
    return Rect(150.0 - x1, y0, 150.0 - x0, y1) if along_x else Rect(x0, 100.0 - y1, x1, 100.0 - y0)


# This disc is 12 mm high, and mirrored 12 mm and a rounding: both are twelve elements of 1 mm.
OF_WHOLE_ELEMENTS = (Touch(shapes=(Disc(x_mm=6.0107, y_mm=26.0314, radius_mm=6.0),), conductivity_S_per_m=1.5),)


@FEW
@given(touches(), contacts, st.floats(0.8, 1.5), st.floats(0.8, 1.3), st.booleans())
@example(OF_WHOLE_ELEMENTS, "edge", 1.3, 0.9, False)
def test_a_mirrored_sheet_gives_mirrored_voltages_in_both_planes(pressed, contact, along, across, along_x):
    bend = Bend(angle_deg=90.0, stretch_along=along, stretch_across=across)  # the same on either side of both planes
    here = Scene(electrodes=Electrodes(contact), bend=bend, touches=pressed, element_size_mm=COARSE_MM)
    other = tuple(replace(t, shapes=tuple(mirror(s, along_x) for s in t.shapes)) for t in pressed)
    one, two = factorise_scene(here).differences(), factorise_scene(replace(here, touches=other)).differences()
    rows = mirrored_row(along_x)
    # Meshes are mirror images but for rounding of their lines; points of cut elements may fall on the other side of it.
    np.testing.assert_allclose(two[rows[:, 0], rows[:, 1]], one[TABLE[:, 0], TABLE[:, 1]], rtol=1e-6)


@FEW
@given(touches(discs=False), bends)  # the mesh follows rectangles; in cut elements this holds up to their own error
def test_more_conductivity_anywhere_lowers_the_resistance_between_any_two_electrodes(pressed, bend):
    assume(pressed)
    before = Scene(bend=bend, touches=pressed, element_size_mm=COARSE_MM)
    better = tuple(replace(t, conductivity_S_per_m=2.0 * t.conductivity_S_per_m) for t in pressed)
    less, more = (np.diag(factorise_scene(s).differences()) for s in (before, replace(before, touches=better)))
    # Contrasts of 1e10 within a scene leave 1e-9 of rounding; what is tested changes by whole per cents.
    assert np.all(more <= less * (1.0 + 1e-7))


@pytest.fixture(scope="module")
def operators():
    return build_operators(cells="units")


data = st.integers(0, 2**32 - 1).map(lambda seed: np.random.default_rng(seed).standard_normal(104))


@MANY
@given(data, st.floats(1e-3, 1e3))
def test_a_common_gain_of_frame_and_reference_changes_no_classical_map(operators, noise, gain):
    voltages = operators.untouched_voltages
    touched = voltages * (1.0 + 0.1 * np.tanh(noise))
    sheet = Sheet(np.zeros((3, 30, 45)), voltages, _operators={"units": operators})
    plain, amplified = (
        solve_tikhonov(Case(g * touched, g * voltages, g * voltages, sheet, "units")) for g in (1.0, gain)
    )
    np.testing.assert_allclose(amplified, plain, atol=1e-9)
    np.testing.assert_allclose(linear_data(gain * touched, gain * voltages), touched / voltages - 1.0, atol=1e-12)
