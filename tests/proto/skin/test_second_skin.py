"""Clouds of a sheet that is not the paper's."""

from dataclasses import replace

import numpy as np
import pytest
from tests.second_skin import SECOND, rolled

from eitskin_proto.errors import MismatchError
from eitskin_proto.skin.cloud import align_cloud, check_cloud, network_input
from eitskin_proto.skin.cloud_file import Surface, load_surface, save_surface
from eitskin_proto.skin.made_for import check_made_for
from eitskin_proto.skin.parts import Deformations
from eitskin_proto.skin.quantity import Quantity
from eitskin_proto.skin.sheet_cloud import check_sheet
from eitskin_proto.skin.skin import PAPER
from eitskin_proto.skin.toml import named

GRID = SECOND.grid


def test_the_flat_sheet_is_where_it_is_and_fills_the_network_s_input():
    flat = GRID.flat_cloud_mm()
    assert flat.shape == (3, 18, 45)
    assert np.abs(align_cloud(flat, GRID) - flat).max() < 1e-10
    found = network_input(flat, GRID)
    assert found[0].max() == pytest.approx(1.5 * 44 / 45)  # half a pixel in
    assert found[1].max() == pytest.approx(1.5 * 90 / 220 * 17 / 18)
    with pytest.raises(ValueError, match=r"shape \(3, 18, 45\) .*found \(3, 30, 45\)"):
        check_cloud(PAPER.grid.flat_cloud_mm(), GRID)


@pytest.mark.parametrize("angle_deg", [1.0, 90.0, 180.0])
def test_its_bends_pass_without_a_word(angle_deg):
    assert check_sheet(rolled(SECOND, angle_deg), SECOND)[1] == ()


def test_a_cloud_file_says_whose_it_is(tmp_path):
    path, cloud = tmp_path / "cloud.npz", rolled(SECOND, 30.0)
    save_surface(path, Surface(cloud), skin=SECOND)
    assert np.array_equal(load_surface(path, SECOND).cloud_mm, cloud)
    with pytest.raises(MismatchError, match=rf"found {SECOND.grid_id}, expected {PAPER.grid_id} of skin .paper., 150"):
        load_surface(path)
    other = replace(SECOND, deformations=Deformations(twist_deg=(0.0, 1.0)))
    moved = replace(
        SECOND, electrodes=replace(SECOND.electrodes, arc_length_mm=Quantity(tuple(SECOND.arc_length_mm + 1)))
    )
    with pytest.raises(MismatchError, match=rf"grid_id: found {SECOND.grid_id}, expected {moved.grid_id} of skin"):
        load_surface(path, moved)
    calibrated = replace(moved, calibrated_from=SECOND.digest, stated_grid_id=SECOND.grid_id)
    assert calibrated.grid_id == SECOND.grid_id != moved.grid_id
    assert calibrated.digest != moved.digest
    for same in (other, calibrated, replace(moved, calibrated_from=SECOND.digest)):
        assert np.array_equal(load_surface(path, same).cloud_mm, cloud)


def test_what_is_older_than_descriptions_is_the_paper_s():
    check_made_for("it", PAPER, grid_id=PAPER.grid_id, skin_digest=None, hint="")
    known_better = replace(PAPER, name="ours", calibrated_from=PAPER.digest)
    check_made_for("it", known_better, grid_id=PAPER.grid_id, skin_digest=None, hint="")
    for grid_id in ("feed", None):
        with pytest.raises(MismatchError, match=r"it: .*found .*expected .*; do"):
            check_made_for("it", PAPER, grid_id=grid_id, skin_digest=None, hint="do")
    with pytest.raises(MismatchError, match="it: grid_id"):
        check_made_for("it", PAPER, grid_id="feed", skin_digest="", hint="")  # no calibration is no permission


@pytest.mark.parametrize("name", ["lab", "hydrogel"])
def test_descriptions_of_one_sheet_take_what_was_made_for_another_of_them(name):
    check_made_for("it", named(name), grid_id=PAPER.grid_id, skin_digest=PAPER.digest, hint="")
    check_made_for("it", PAPER, grid_id=named(name).grid_id, skin_digest=named(name).digest, hint="")
