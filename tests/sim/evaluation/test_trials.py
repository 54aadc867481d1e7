"""Trials are drawn once, can be solved, and share nothing with any data set; touches are shifted whole."""

import math
from dataclasses import replace

import numpy as np
import pytest

from eitskin_proto.skin.parts import Map, Outline
from eitskin_proto.skin.quantity import Quantity
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.evaluation import trials
from eitskin_sim.scene.family import draw
from eitskin_sim.scene.parts import Bend
from eitskin_sim.scene.scene import check_scene, parse_phantoms
from eitskin_sim.scene.shift import shifted

L_OF_TWO_BARS = [
    {
        "name": "L",
        "truth": "area",
        "scene": {"touches": [{"rect_mm": [40, 30, 50, 70]}, {"rect_mm": [50, 30, 70, 40]}, {"disc_mm": [95, 60, 5]}]},
    }
]


def test_shift_moves_every_touch_by_its_own_part_of_a_pixel_and_keeps_an_l_whole():
    (phantom,) = parse_phantoms(L_OF_TWO_BARS)
    moved = shifted(phantom, 0.5, np.random.default_rng(0))
    before, after = ([touch.shapes[0].bounds_mm for touch in one.scene.touches] for one in (phantom, moved))
    moves = np.array(after)[:, :2] - np.array(before)[:, :2]
    assert np.allclose(moves[0], moves[1])
    assert np.abs(moves[0] - moves[2]).max() > 0.1
    assert 0.0 < np.abs(moves).max() <= 0.5 * 10 / 3
    assert [touch.shapes[0].area_mm2 for touch in moved.scene.touches] == pytest.approx([400.0, 200.0, 25 * math.pi])
    assert shifted(phantom, 0.0, np.random.default_rng(0)) is phantom
    assert shifted(phantom, 0.5, np.random.default_rng(0)) == moved


def test_shift_of_units_or_by_more_than_a_pixel_is_refused(phantoms):
    with pytest.raises(ValueError, match="units of the grid"):
        shifted(phantoms[0], 0.5, np.random.default_rng(0))
    with pytest.raises(ValueError, match="from 0 to 1"):
        shifted(phantoms[1], 1.5, np.random.default_rng(0))


def test_each_seed_draws_other_deformations_and_touches():
    first, again, other = (trials.single(10.0, 2, 1, seed=seed) for seed in (1, 1, 2))
    assert first == again
    for one, two in zip(first, other, strict=True):
        assert one.scene.bend != two.scene.bend
        assert one.scene.touches != two.scene.touches


SMALL = Skin(
    outline=Outline("rectangle", (50.0, 50.0)),
    electrodes=replace(PAPER.electrodes, arc_length_mm=Quantity(tuple(12.5 * (k + 0.4) for k in range(16)))),
    map=Map((15, 15), (2, 5)),
)


def test_a_sheet_has_no_room_for_any_number_of_touches():
    with pytest.raises(ValueError, match=r"12 touches .* do not fit on a sheet of 50 x 50 mm; ask for fewer"):
        trials.random((12, 12), 1, 1, "A", "area", SMALL)
    with pytest.raises(ValueError, match=r"11 to 12 touches on 10 units; ask for at most 10"):
        trials.random((11, 12), 1, 1, "A", "units", SMALL)
    for count in range(1, 5):  # as many as devices are tried with
        drawn = trials.random((count, count), 3, 5, "A", "area", SMALL)
        assert {len(one.scene.touches) for one in drawn} == {count}


def test_trials_can_be_solved_are_drawn_once_and_share_no_bend_with_any_data_set():
    drawn = [
        *trials.single(10.0, 2, 4),
        *trials.pair(90.0, 2, 4),
        *trials.pair(10.0, 2, 4),
        *trials.random((5, 6), 2, 4, "B", "area"),
        *trials.random((2, 4), 2, 4, "A", "units"),
        *trials.untouched(2, "B"),
    ]
    for phantom in drawn:  # their bends were checked when they were drawn
        check_scene(replace(phantom.scene, bend=Bend()))
    assert drawn[:8] == trials.single(10.0, 2, 4)
    assert trials.single(10.0, 1, 4) == drawn[:4]
    assert [len(one.scene.touches) for one in drawn[:8]] == [1] * 8
    mine = {one.scene.bend for one in drawn if one.scene.bend.angle_deg}
    for seed in (0, 1):
        assert not mine & {*draw("A", 4, seed), *draw("B", 4, seed)}


@pytest.mark.parametrize(
    "draw_trials",
    [
        lambda: trials.single(0.0, 1, 1),
        lambda: trials.pair(131.0, 1, 1),
        lambda: trials.random((4, 2), 1, 1, "A", "units"),
        lambda: trials.single(10.0, 0, 1),
        lambda: trials.single(10.0, 1, 0),
    ],
)
def test_trials_that_make_no_sense_are_refused_with_their_bounds(draw_trials):
    with pytest.raises(ValueError, match=r"expected|must be"):
        draw_trials()
