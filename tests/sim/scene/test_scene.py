import json
from pathlib import Path

import pytest

from eitskin_sim.fem.meshing import scene_mesh
from eitskin_sim.scene.scene import SceneError, load_phantoms, load_scene, parse_phantoms, parse_scene, scene_json
from eitskin_sim.scene.shapes import Disc, Polygon, Rect


def test_empty_object_is_the_papers_flat_sheet() -> None:
    scene = parse_scene({})
    assert scene.sheet.size_mm == (150.0, 100.0)
    assert scene.sheet.thickness_mm == 2.0
    assert scene.electrodes.contact == "patch"
    assert scene.electrodes.arc_length_mm[:2] == (12.5, 43.75)
    assert scene.bend.stretch_along == 1.0
    assert scene.touches == ()
    assert (scene.current_A, scene.element_size_mm) == (1.0, 1.5)


def test_every_shape_is_read() -> None:
    scene = parse_scene(
        {
            "touches": [
                {"rect_mm": [1, 2, 13, 14], "conductivity_S_per_m": 20},
                {"disc_mm": [50, 40, 5]},
                {"polygon_mm": [[60, 60], [80, 60], [70, 80], [60, 60]]},
                {"units": [[0, 0], [13, 8]]},
            ]
        }
    )
    rect, disc, polygon, units = scene.touches
    assert rect.shapes == (Rect(1, 2, 13, 14),)
    assert (rect.conductivity_S_per_m, disc.conductivity_S_per_m) == (20, 50)
    assert disc.shapes == (Disc(50, 40, 5),)
    assert polygon.shapes == (Polygon(((60, 60), (80, 60), (70, 80))),)
    assert units.shapes[1].bounds_mm == pytest.approx((150 * 13 / 14, 100 * 8 / 9, 150, 100))


def test_scene_survives_its_own_json() -> None:
    scene = parse_scene(
        {"touches": [{"disc_mm": [50, 40, 5]}], "bend": {"angle_deg": 40, "bumps_mm": [[50, 50, 3, 20]]}}
    )
    assert parse_scene(json.loads(scene_json(scene))) == scene


@pytest.mark.parametrize(
    ("scene", "says"),
    [
        ({"bends": {}}, "unknown key 'bends'"),
        ({"touches": [{"rect_mm": [0, 0, 10, 10], "disc_mm": [5, 5, 5]}]}, "expected one of"),
        ({"touches": [{"rect_mm": [145, 0, 155, 10]}]}, "x = 155 mm; it must be from 0 to 150"),
        ({"touches": [{"rect_mm": [10, 10, 10.5, 30]}]}, "0.5 mm wide; element_size_mm is 1.5"),
        ({"touches": [{"rect_mm": [10, 10, 5, 30]}]}, "x1 must be above x0"),
        ({"touches": [{"polygon_mm": [[0, 0], [20, 20], [20, 0], [0, 20]]}]}, "crosses or touches itself"),
        ({"touches": [{"units": [[14, 0]]}]}, "column must be an integer from 0 to 13"),
        ({"touches": [{"rect_mm": [0, 0, 10, 10], "conductivity_S_per_m": -1}]}, "is -1, expected a number from 1e-09"),
        ({"sheet": {"size_mm": [150]}}, "is a list of 1, expected a list of 2 numbers"),
        ({"sheet": {"thickness_mm": 0.001}}, "thickness_mm is 0.001, expected a number from 0.05 to 20"),
        ({"electrodes": {"contact": "pin"}}, "expected one of patch, edge"),
        ({"electrodes": {"size_mm": 32}}, "overlap: their centres are 31.25 mm apart; they must be at least 32"),
        ({"electrodes": {"arc_length_mm": [1 + 31.25 * k for k in range(16)]}}, "at least 2 mm from every corner"),
        ({"electrodes": {"arc_length_mm": [500 - 31.25 * k - 1 for k in range(16)]}}, "counter-clockwise"),
        ({"bend": {"angle_deg": 400}}, "folds the sheet through itself"),
        ({"bend": {"stretch_along": 4, "stretch_across": 0.5}}, "ratio is 8, it must be from 0.2 to 5"),
        ({"bend": {"nonuniformity": 1.1}}, "is 1.1; it must be below stretch_along = 1"),
        ({"bend": {"bumps_mm": [[75, 50, 6, 0]]}}, r"bumps_mm\[0\]\[3\] is 0, expected a number from 0.1"),
        ({"electrodes": {"size_mm": 60}}, "is 60; it must be at most 50"),
        ({"touches": [{"polygon_mm": [[20, 20], [40, 40], [60, 20], [60, 60], [40, 40], [20, 60]]}]}, "touches itself"),
        ({"touches": [{"conductivity_S_per_m": 50}]}, "no shape"),
        ({"current_A": float("nan")}, "current_A is nan, expected a number"),
        ([], "expected a table"),
    ],
)
def test_bad_scene_is_refused_with_what_was_found_and_the_bound(scene: object, says: str) -> None:
    with pytest.raises(SceneError, match=says):
        parse_scene(scene)


@pytest.mark.parametrize(
    ("text", "says"),
    [('{"bend": {}, "bend": {}}', "the key 'bend' twice"), ("[" * 100_000, "is not")],
)
def test_bad_json_is_refused(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "scene.json"
    path.write_text(text)
    with pytest.raises(SceneError, match=says):
        load_scene(path)


def test_patches_that_meet_in_a_corner_are_refused_though_their_centres_are_far_enough_apart() -> None:
    positions = [150 - 2.5, 150 + 2.5] + [180.0 + 21 * k for k in range(14)]
    with pytest.raises(SceneError, match=r"overlap in a corner by 3\.5 x 3\.5 mm"):
        parse_scene({"electrodes": {"arc_length_mm": positions}})
    parse_scene({"electrodes": {"arc_length_mm": positions, "contact": "edge"}})


def test_a_mesh_without_bound_is_refused() -> None:
    with pytest.raises(SceneError, match="expected at most 120000"):
        scene_mesh(parse_scene({"element_size_mm": 0.2}))


OUTSIDE = {"touches": [{"disc_mm": [0, 45, 8]}]}


def test_an_error_names_the_file_and_the_phantom(tmp_path: Path) -> None:
    path = tmp_path / "phantoms.json"
    path.write_text(json.dumps([{"name": "ok", "scene": {}}, {"name": "seventeen", "scene": OUTSIDE}]))
    with pytest.raises(SceneError) as raised:
        load_phantoms(path)
    assert str(raised.value).startswith(
        f"{path}: phantoms[1] 'seventeen': touches[0] reaches outside the sheet: x = -8"
    )
    with pytest.raises(SceneError, match=r"^phantoms\[0\] '1': unknown key 'bends' in scene"):
        parse_phantoms([{"scene": {"bends": {}}}])
