"""Sheets that need not be looked at point by point are told by their tangents alone."""

from dataclasses import replace

import numpy as np

from eitskin_proto.skin.skin import PAPER
from eitskin_sim.scene import folds
from eitskin_sim.scene.bend import frame_at
from eitskin_sim.scene.family import draw
from eitskin_sim.scene.nominal import nominal_sheet
from eitskin_sim.scene.parts import Bend
from eitskin_sim.scene.strict_json import SceneError

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
        for bend in draw("A", 40, 11)
        for turns, twists in [generator.uniform(1.0, (4.0, 9.0))]
    ]
    found = np.array([(runs_ahead(bend), meets_itself(bend)) for bend in bends])
    assert not found.all(axis=1).any()
    assert found.sum(axis=0).min() >= 4  # both kinds are there


def test_half_a_turn_does_not_run_ahead_and_most_of_family_a_does() -> None:
    assert not runs_ahead(Bend(angle_deg=180.0))
    assert runs_ahead(Bend(angle_deg=140.0))
    assert np.mean([runs_ahead(bend) for bend in draw("A", 100, 12)]) > 0.6
