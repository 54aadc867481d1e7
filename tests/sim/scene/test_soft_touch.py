"""Touches as scenes say them: contrast, border, dent, ellipses; and an error wherever one would change nothing."""

import json
from typing import Any

import numpy as np
import pytest

from eitskin_proto.skin.skin import PAPER
from eitskin_sim.fem.solve import solve_scene
from eitskin_sim.scene.area import area_map
from eitskin_sim.scene.bend import metric
from eitskin_sim.scene.parts import Bend, Scene, Sheet, Touch
from eitskin_sim.scene.scene import SceneError, load_scene, parse_scene, scene_json
from eitskin_sim.scene.shapes import Disc, Ellipse, Polygon, Rect
from eitskin_sim.scene.soft_touch import DENT_WALL_MM, dent_heights


def scene_of(**touch: Any) -> Scene:
    return parse_scene({"touches": [{"disc_mm": [70, 45, 8], **touch}]})


def test_a_touch_of_every_kind_comes_back_from_json(tmp_path: Any) -> None:
    scene = parse_scene(
        {
            "touches": [
                {"disc_mm": [70, 45, 8], "contrast": 0.4, "border_mm": 4},
                {"ellipse_mm": [40, 30, 20, 12, 30], "contrast": 2.5, "dent_mm": 1.5},
                {"rect_mm": [100, 40, 116, 56], "conductivity_S_per_m": 0.5, "border_mm": 8},
                {"units": [[1, 1], [2, 1]], "contrast": 0.2},
            ]
        }
    )
    disc, ellipse, rect, units = scene.touches
    assert (disc.contrast, disc.border_mm, disc.dent_mm) == (0.4, 4.0, 0.0)
    assert ellipse.shapes == (Ellipse(40, 30, 20, 12, 30),)
    assert (rect.contrast, rect.factor(1.0), rect.factor(2.0)) == (None, 0.5, 0.25)
    assert (len(units.shapes), units.inside_S_per_m(3.0)) == (2, pytest.approx(0.6))
    path = tmp_path / "scene.json"
    path.write_text(scene_json(scene))
    again = load_scene(path)
    assert again.touches[:3] == scene.touches[:3]
    assert [touch.contrast for touch in again.touches[3:]] == [0.2, 0.2]


def test_a_scene_of_sharp_touches_reads_and_writes_as_before() -> None:
    scene = scene_of(conductivity_S_per_m=20)
    assert scene.touches == (Touch((Disc(70, 45, 8),), 20.0),)
    assert json.loads(scene_json(scene))["touches"] == [{"disc_mm": [70.0, 45.0, 8.0], "conductivity_S_per_m": 20.0}]
    assert scene_of().touches[0].factor(1.0) == 50.0


@pytest.mark.parametrize(
    ("touch", "message"),
    [
        ({"contrast": 1.0}, "changes nothing: its contrast is 1"),
        ({"contrast": 0.0}, "contrast is 0.0, expected a number from 1e-09 to"),
        ({"contrast": 0.5, "conductivity_S_per_m": 2}, "found contrast and conductivity_S_per_m; give one"),
        ({"contrast": 0.5, "border_mm": 0.1}, "border_mm is 0.1; it must be 0, a sharp border, or at least 0.5"),
        ({"contrast": 0.5, "border_mm": 17}, "it must be at most the touch's width, 16"),
    ],
)
def test_a_touch_that_changes_nothing_or_cannot_be_is_refused(touch: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError, match=r"scene\.touches\[0\]") as raised:
        scene_of(**touch)
    assert message in str(raised.value)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    "touch",
    [Touch((Disc(200, 45, 8),), contrast=0.5), Touch((Rect(-30, 10, -10, 20),)), Touch((Disc(70, 45, 8),), 1.0)],
)
def test_the_solver_too_refuses_a_touch_that_changes_nothing(touch: Touch) -> None:
    with pytest.raises(SceneError, match=r"scene\.touches\[0\] (lies outside the sheet|changes nothing)"):
        solve_scene(Scene(touches=(touch,), element_size_mm=6.0))


def test_a_dent_alone_is_a_touch() -> None:
    assert scene_of(contrast=1.0, dent_mm=2.0).touches[0].dent_mm == 2.0


def test_an_ellipse_has_the_distances_of_its_outline() -> None:
    ellipse = Ellipse(60.0, 40.0, 24.0, 9.0, 35.0)
    turn, angle = np.deg2rad(35.0), np.linspace(0.0, 2 * np.pi, 4000, endpoint=False)
    local = np.stack([12.0 * np.cos(angle), 4.5 * np.sin(angle)], axis=-1)
    outline = local @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]) + (60.0, 40.0)
    points = np.random.default_rng(0).uniform((40, 25), (80, 55), (500, 2))
    gap = points[:, None] - outline
    nearest = np.hypot(*gap.transpose(2, 0, 1)).min(axis=1)
    distance, normal = ellipse.distance_mm(points)
    inside = Polygon(tuple(map(tuple, outline[::40]))).distance_mm(points)[0] < 0.0
    assert np.abs(distance) == pytest.approx(nearest, abs=0.02)
    assert np.array_equal((distance < 0.0)[nearest > 0.1], inside[nearest > 0.1])
    step = 1e-4 * normal
    slope = (ellipse.distance_mm(points + step)[0] - ellipse.distance_mm(points - step)[0]) / 2e-4
    assert np.median(slope) == pytest.approx(1.0, abs=1e-3)
    x0, y0, x1, y1 = ellipse.bounds_mm
    assert (x0, y0, x1, y1) == pytest.approx((*outline.min(axis=0), *outline.max(axis=0)), abs=1e-4)


# The contour of half height of |log contrast| is the outline, however wide the border is.
@pytest.mark.parametrize("shape", [Disc(61.3, 42.1, 8.0), Ellipse(60.0, 40.0, 24.0, 9.0, 35.0), Rect(50, 30, 67, 42)])
def test_a_soft_touchs_label_is_the_area_inside_its_outline(shape: Disc | Ellipse | Rect) -> None:
    hard = area_map([Touch((shape,))])
    assert hard.sum() * PAPER.grid.pitch_mm**2 == pytest.approx(shape.area_mm2, rel=1e-3)
    for contrast, border in ((0.3, 8.0), (5.0, 2.0)):
        assert np.array_equal(area_map([Touch((shape,), contrast=contrast, border_mm=border)]), hard)


def test_a_dent_is_as_deep_as_it_says_and_stretches_its_wall() -> None:
    dent = Touch((Disc(75, 50, 16),), contrast=0.5, dent_mm=2.0)
    points = np.array([[77.0, 50.0], [91.0, 50.0], [130.0, 50.0]])
    height, slope = dent_heights((dent,), points)
    assert height == pytest.approx([2.0, 1.0, 0.0], abs=1e-3)
    steepest = 2.0 / DENT_WALL_MM / np.sqrt(2 * np.pi)
    assert slope[1] == pytest.approx([-steepest, 0.0])
    step = np.array([[1e-5, 0.0]])
    ahead, behind = (dent_heights((dent,), points + sign * step)[0] for sign in (1.0, -1.0))
    assert (ahead - behind) / 2e-5 == pytest.approx(slope[:, 0], abs=1e-6)
    E, F, G = metric(Bend(), Sheet(), points, (dent,)).T
    assert E[1] == pytest.approx(1.0 + steepest**2)
    assert (F[1], G[1], E[2]) == pytest.approx((0.0, 1.0, 1.0), abs=1e-9)


RING = [{"disc_mm": [75, 50, 20], "contrast": 0.4}, {"disc_mm": [75, 50, 10], "contrast": 1.0}]


@pytest.mark.parametrize(
    "touches",
    [
        RING[::-1],  # the hole is covered
        [RING[0], {"disc_mm": [20, 20, 5], "contrast": 1.0}],  # beside it
        [RING[0], {"disc_mm": [90, 65, 1], "contrast": 1.0}],  # in a corner of its box
        [RING[0], {**RING[1], "border_mm": 2}],  # what is graded multiplies
        [{**RING[0], "border_mm": 2}, RING[1]],  # what is graded comes last
    ],
)
def test_a_hole_in_nothing_is_refused_with_what_one_is(touches: list[dict[str, Any]]) -> None:
    with pytest.raises(SceneError, match=r"its contrast is 1; .* or be a hole: both sharp, over an earlier touch"):
        parse_scene({"touches": touches})
