"""Sheets that need not be looked at point by point are told by their tangents alone."""

from dataclasses import replace

import numpy as np
import pytest

from eitskin_proto.skin.skin import PAPER
from eitskin_sim.scene import folds
from eitskin_sim.scene.bend import frame_at
from eitskin_sim.scene.family import draw
from eitskin_sim.scene.nominal import nominal_sheet
from eitskin_sim.scene.parts import Bend, SceneError, Touch
from eitskin_sim.scene.shapes import Disc

SHEET = nominal_sheet(PAPER)


def runs_ahead(bend: Bend) -> bool:
    return folds._runs_ahead(frame_at(bend, SHEET, folds._samples(SHEET, 2.0)[0], placed=False))


def meets_itself(bend: Bend) -> bool:
    try:
        folds._check_apart(bend, SHEET)
    except SceneError:
        return True
    return False


def test_no_sheet_that_runs_ahead_meets_itself() -> None:
    generator = np.random.default_rng(3)
    bends = [
        replace(bend, angle_deg=bend.angle_deg * turns, twist_deg=bend.twist_deg * twists)
        for bend in draw("A", 20, 11)
        for turns, twists in [generator.uniform(1.0, (4.0, 9.0))]
    ]
    found = np.array([(runs_ahead(bend), meets_itself(bend)) for bend in bends])
    assert not found.all(axis=1).any()
    assert found.sum(axis=0).min() >= 2  # both kinds are there


TIGHT = Bend(angle_deg=359.0, skew=1.0)


def dent(depth_mm: float) -> Touch:
    return Touch((Disc(135.0, 50.0, 9.0),), contrast=0.4, dent_mm=depth_mm)


def test_dents_fold_a_sheet_as_bumps_do_and_add_up() -> None:
    folds.check_bend(TIGHT, SHEET)
    folds.check_bend(TIGHT, SHEET, [dent(5.0), Touch((Disc(135.0, 50.0, 9.0),))])
    folds.check_bend(Bend(), SHEET, [dent(10.0)] * 3)  # the flat sheet has nothing to fold into
    says = r"dent_mm of scene.touches folds the sheet through itself: height times curvature reaches 2\.\d+; it must be"
    with pytest.raises(SceneError, match=says):
        folds.check_bend(TIGHT, SHEET, [dent(10.0)] * 3)
    bumped = replace(TIGHT, bumps_mm=((135.0, 50.0, 6.0, 10.0),))
    folds.check_bend(bumped, SHEET)
    with pytest.raises(SceneError, match=r"scene\.bend\.bumps_mm with dent_mm .* lower the dent or angle_deg"):
        folds.check_bend(bumped, SHEET, [dent(10.0)])


@pytest.mark.parametrize("radius_mm", [2.0, 6.0, 15.0])
def test_a_deep_dent_in_a_bent_sheet_is_none_that_meets_itself(radius_mm: float) -> None:
    for angle, x in ((90.0, 75.0), (180.0, 20.0), (300.0, 120.0)):
        deep = Touch((Disc(x, 50.0, radius_mm),), contrast=0.4, dent_mm=10.0)
        folds.check_bend(Bend(angle_deg=angle), SHEET, [deep])
