"""Presses for simulators: against the scene's own fine mesh, the law from a table, and what is refused."""

from functools import lru_cache

import numpy as np
import pytest
from tests.second_skin import SECOND

from eitskin_proto.errors import SkinError
from eitskin_proto.skin.cloud_file import Surface, save_surface
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.fem.solve import solve_scene
from eitskin_sim.press import Law, Press, Sheet
from eitskin_sim.scene.nominal import nominal_scene
from eitskin_sim.scene.parts import Bend, Touch
from eitskin_sim.scene.shapes import Disc
from eitskin_sim.surface.measured_cloud import measured_cloud

BEND = Bend(angle_deg=70.0)
PRESSES = [Press(41.0, 33.0, 7.0, 8.0), Press(104.0, 62.0, 9.0, 11.0)]


@lru_cache(maxsize=1)
def sheet():
    return Sheet(PAPER, measured_cloud(BEND))


def test_both_ways_give_the_change_that_a_fine_mesh_gives():
    ratios = (0.68**0.8 * 0.51**0.2, 0.51**0.6 * 0.32**0.4)  # the table at 8 and 11 mm
    touches = tuple(
        Touch((Disc(press.x_mm, press.y_mm, press.radius_mm),), contrast=ratio, border_mm=3.0)
        for press, ratio in zip(PRESSES, ratios, strict=True)
    )
    fine, untouched = (solve_scene(nominal_scene(PAPER, BEND, some)).voltages for some in (touches, ()))
    truth = fine / untouched - 1.0
    assert np.abs(sheet().untouched_V / untouched - 1.0).max() < 2e-3
    for found, bound in ((sheet().voltages(PRESSES), 0.02), (sheet().linear_voltages([PRESSES])[0], 0.03)):
        assert np.linalg.norm(found / sheet().untouched_V - 1.0 - truth) < bound * np.linalg.norm(truth)


def test_a_batch_gives_each_frame_its_own_presses():
    frames = [[], PRESSES[:1], PRESSES, [Press(50.0, 50.0, 8.0, 0.0)], [Press(0.0, 0.0, 8.0, 10.0)]]
    together = sheet().linear_voltages(frames)
    for untouched in (together[0], together[3], sheet().voltages(frames[3])):
        assert np.array_equal(untouched, sheet().untouched_V)
    for row, frame in zip(together, frames, strict=True):
        assert np.allclose(row, sheet().linear_voltages([frame])[0], rtol=1e-12)


def test_the_stretch_law_acts_on_a_stretched_sheet_alone():
    cloud = measured_cloud(Bend(stretch_along=1.1))
    plain, gauged = (Sheet(PAPER, cloud, Law(gauge_factor=k)) for k in (0.0, 2.0))
    assert np.allclose(plain.flat_V, gauged.flat_V)
    assert np.allclose(gauged.untouched_V / plain.untouched_V, 1.1**2, rtol=0.02)


def test_points_on_the_surface_are_found_on_the_flat_sheet():
    points = sheet().cloud_mm.reshape(3, -1).T
    off = sheet().places_mm(points) - PAPER.grid.pixel_centres_mm().reshape(-1, 2)
    assert np.abs(off).max() < 0.3


@pytest.mark.parametrize(
    ("press", "said"),
    [
        (Press(151.0, 50.0, 8.0, 5.0), r"presses\[1\].x_mm is 151; expected 0 to 150"),
        (Press(75.0, np.nan, 8.0, 5.0), r"presses\[1\].y_mm is nan; expected 0 to 100"),
        (Press(75.0, 50.0, 0.5, 5.0), r"presses\[1\].radius_mm is 0.5; expected 2 to 50"),
        (Press(75.0, 50.0, 8.0, 13.0), r"presses\[1\].depth_mm is 13; expected 0 to 12.5, the depths of the law's"),
    ],
)
def test_a_press_that_cannot_be_is_refused_in_one_line(press, said):
    with pytest.raises(ValueError, match=said):
        sheet().linear_voltages([[PRESSES[0]], [press]])


def test_a_press_in_no_list_is_refused():
    with pytest.raises(ValueError, match="expected a list of Press"):
        sheet().voltages(PRESSES[0])


@pytest.mark.parametrize("table", [[], [(1.0, 0.5), (0.0, 1.0)], [(0.0, 1.0), (np.nan, 0.5)], [(0.0, 1.0), (1.0, 0.0)]])
def test_a_table_that_is_none_is_refused(table):
    with pytest.raises(ValueError, match=r"the law's table is .* expected two or more rows"):
        Law(table)


def test_a_cloud_of_another_skin_is_refused(tmp_path):
    with pytest.raises(ValueError, match="expected"):
        Sheet(PAPER, 2.0 * PAPER.grid.flat_cloud_mm())
    save_surface(tmp_path / "cloud.npz", Surface(SECOND.grid.flat_cloud_mm()), skin=SECOND)
    with pytest.raises(SkinError, match="run 'eitskin surface' again, for this skin"):
        Sheet(PAPER, tmp_path / "cloud.npz")
