"""A skin that is not the paper's, from its scene to its score: what is forgotten of the paper's would show here."""

import json
from dataclasses import replace

import numpy as np
import pytest
from tests.second_skin import SECOND

from eitskin_proto.skin.parts import Layer, Outline
from eitskin_proto.skin.quantity import Quantity
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.devices.device import ideal
from eitskin_sim.devices.possible import check_skin
from eitskin_sim.evaluation.metrics import localisation_error_mm, lost_mm, touch_centres_mm
from eitskin_sim.fem.solve import solve_scene
from eitskin_sim.freeform.sheet import inverted_sheet
from eitskin_sim.freeform.voltages import set_voltages
from eitskin_sim.scene.area import area_map
from eitskin_sim.scene.bend import metric, surface
from eitskin_sim.scene.family import draw
from eitskin_sim.scene.nominal import flat_metric_of, nominal_electrodes, nominal_scene, nominal_sheet
from eitskin_sim.scene.parts import Bend, Electrodes, Scene, SceneError, Sheet, Touch
from eitskin_sim.scene.scene import parse_scene, scene_json
from eitskin_sim.scene.shapes import Rect
from eitskin_sim.scene.touch_table import RECTANGLE, gather
from eitskin_sim.surface.measured_cloud import measured_cloud
from eitskin_sim.surface.ordered_cloud import organise
from eitskin_sim.surface.predict import fit_cloud, predict
from eitskin_sim.unit_grid.units import UnitGenerator

BEND = Bend(angle_deg=90.0, axis_deg=20.0)


def test_the_paper_s_nominal_sheet_is_the_scene_s_default():
    assert nominal_scene(PAPER) == Scene()
    assert (nominal_sheet(PAPER), nominal_electrodes(PAPER)) == (Sheet(), Electrodes())
    assert ideal(PAPER).sheet == Sheet()


def test_a_scene_takes_from_the_skin_what_it_does_not_say():
    scene = parse_scene({"touches": [{"units": [[14, 8]]}]}, SECOND)
    assert scene.sheet.size_mm == (220.0, 90.0)
    assert scene.electrodes.arc_length_mm == tuple(SECOND.arc_length_mm.tolist())
    assert scene.touches[0].shapes[0].bounds_mm == pytest.approx(SECOND.grid.unit_rect_mm(14, 8))
    assert parse_scene(json.loads(scene_json(scene))) == scene  # what is written says all
    with pytest.raises(SceneError, match="column must be an integer from 0 to 13"):
        parse_scene({"touches": [{"units": [[14, 8]]}]})
    other = parse_scene({"sheet": {"size_mm": [200, 90]}}, SECOND)
    assert other.electrodes.arc_length_mm == pytest.approx(580.0 * (0.4 + np.arange(16)) / 16)


def test_known_true_lengths_are_the_flat_metric():
    longer = replace(SECOND, layer=Layer(length_scale=Quantity(1.02), width_scale=Quantity(0.99)))
    assert flat_metric_of(longer)(np.zeros((2, 2))) == pytest.approx(np.tile([1.02**2, 0.0, 0.99**2], (2, 1)))


def test_a_disc_is_refused_in_one_line():
    disc = replace(PAPER, outline=Outline("disc", (160.0, 160.0)))
    with pytest.raises(SceneError, match=r"\[outline\] kind is 'disc', expected 'rectangle'"):
        nominal_sheet(disc)


def test_electrodes_that_have_no_room_are_refused():
    check_skin(SECOND)
    arcs = tuple((SECOND.arc_length_mm - 9.0).tolist())  # the first one's patch reaches round the corner (0, 0)
    with pytest.raises(SceneError, match="electrode 0 is a patch round a corner"):
        check_skin(replace(SECOND, electrodes=replace(SECOND.electrodes, arc_length_mm=Quantity(arcs))))


def test_a_cloud_gives_back_surface_and_metric_of_its_skin():
    cloud = measured_cloud(BEND, skin=SECOND)
    assert cloud.shape == (3, 18, 45)
    fitted = fit_cloud(cloud, SECOND.grid)
    inner = np.random.default_rng(0).uniform((15.0, 15.0), (205.0, 75.0), (200, 2))
    expected = metric(BEND, nominal_sheet(SECOND), inner)
    assert np.abs(fitted.metric(inner) - expected).max() < 5e-3


def test_the_prediction_is_what_the_skin_s_bent_sheet_reads():
    found = predict(measured_cloud(BEND, skin=SECOND), SECOND)
    exact = solve_scene(nominal_scene(SECOND, BEND, element_size_mm=3.0)).voltages
    assert np.abs(found / exact - 1.0).max() < 0.02


def test_points_of_another_sheet_are_ordered_by_its_size():
    rng = np.random.default_rng(1)
    sheet = nominal_sheet(SECOND)
    points = surface(BEND, sheet, rng.uniform((0.0, 0.0), sheet.size_mm, (9_000, 2))) + 0.05 * rng.standard_normal(3)
    corner = tuple(surface(BEND, sheet, np.array([[2.0, 2.0]]))[0].tolist())
    found = organise(points, corner, SECOND.grid)
    assert found.size_mm == pytest.approx((220.0, 90.0), abs=1.0)
    exact = measured_cloud(BEND, skin=SECOND)
    assert np.sqrt(np.mean((found.cloud_mm - exact) ** 2)) < 0.5


@pytest.mark.parametrize("size_mm", [(100.0, 170.0), (112.0, 110.0)])
def test_a_sheet_may_be_wider_than_long_or_nearly_square(size_mm):
    skin = replace(PAPER, outline=Outline(size_mm=size_mm), electrodes=_even(size_mm))
    rng, sheet, bend = np.random.default_rng(2), nominal_sheet(skin), Bend(angle_deg=40.0)
    points = surface(bend, sheet, rng.uniform((0.0, 0.0), size_mm, (9_000, 2)))
    corner = tuple(surface(bend, sheet, np.array([[1.0, 1.0]]))[0].tolist())
    for hint in (corner, None):
        found = organise(points, hint, skin.grid)
        assert np.sqrt(np.mean((found.cloud_mm - measured_cloud(bend, skin=skin)) ** 2)) < 0.6


def _even(size_mm):
    perimeter = 2.0 * sum(size_mm)
    arcs = tuple(float(perimeter * (0.4 + k) / 16) for k in range(16))
    return replace(PAPER.electrodes, arc_length_mm=Quantity(arcs))


def test_measures_are_in_the_skin_s_millimetres():
    grid = SECOND.grid
    touched = area_map([Touch((Rect(180.0, 20.0, 200.0, 40.0),))], grid)
    assert touch_centres_mm(touched, grid) == pytest.approx(np.array([[190.0, 30.0]]), abs=0.1)
    assert (
        localisation_error_mm(np.zeros(grid.shape), touched, grid) == lost_mm(grid) == pytest.approx(237.697, abs=1e-3)
    )


def test_touches_anywhere_agree_with_a_solved_scene():
    touch = Touch((Rect(184.0, 52.0, 204.0, 72.0),), 20.0)
    table = gather([np.array([[RECTANGLE, 194.0, 62.0, 20.0, 20.0, 0.0, 20.0]])])
    sheet = inverted_sheet(BEND, 5.0, skin=SECOND)
    found = set_voltages([sheet], table, 5.0, skin=SECOND)[0, 0] / sheet.untouched_V - 1.0
    scene = nominal_scene(SECOND, BEND, (touch,), element_size_mm=4.0)
    expected = solve_scene(scene).voltages / solve_scene(scene.untouched()).voltages - 1.0
    assert np.linalg.norm(found - expected) < 0.03 * np.linalg.norm(expected)


@pytest.mark.slow
def test_touched_units_agree_with_a_solved_scene():
    bits = np.zeros(SECOND.grid.n_units, dtype=np.bool_)
    bits[[8 * 15 + 14, 4 * 15 + 7]] = True
    made = UnitGenerator(BEND, skin=SECOND)
    found = made.voltages(bits[None])[0] / made.untouched_V - 1.0
    touches = tuple(Touch((Rect(*SECOND.grid.unit_rect_mm(*unit)),), 50.0) for unit in ((14, 8), (7, 4)))
    scene = nominal_scene(SECOND, BEND, touches, element_size_mm=4.0)
    expected = solve_scene(scene).voltages / solve_scene(scene.untouched()).voltages - 1.0
    assert np.linalg.norm(found - expected) < 0.02 * np.linalg.norm(expected)


def test_bends_of_a_skin_do_not_come_from_another_s_cache():
    assert draw("B", 3, 7, SECOND) != draw("B", 3, 7)
