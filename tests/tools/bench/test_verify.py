"""``bench verify``: its rows and tables, the touches that it draws, and the picture of p."""

import numpy as np

from eitskin_proto.skin.skin import PAPER
from eitskin_sim.scene.area import area_map
from eitskin_sim.scene.shapes import Ellipse
from eitskin_tools.bench.verify import LEVELS, matched
from eitskin_tools.bench.verify_conditions import (
    across,
    conditions,
    paper_like,
)


def test_p_keeps_its_word_where_the_model_is_right() -> None:
    rows = matched(3)
    assert len(rows) == 3 * len(LEVELS)
    assert all(abs(row["found"] - row["stated"]) < 4.0 * row["error"] for row in rows)


def test_every_row_has_a_name_of_its_own() -> None:
    names = [one.name for one in conditions()]
    assert len(set(names)) == len(names)


def test_paper_like_touches_lie_on_the_sheet_at_deformations_of_the_trials() -> None:
    found = paper_like(2, 2)
    assert [one.name for one in found] == ["A0.0", "A0.1", "A1.0", "A1.1"]
    assert found[0].scene.bend == found[1].scene.bend != found[2].scene.bend
    for one in found:
        area = area_map(one.scene.touches, PAPER.grid)
        assert 0.0 < area.sum() < 0.5 * area.size
        assert one.truth == "area"


def test_touches_that_lie_across_are_on_the_sheet_and_turned_by_any_angle() -> None:
    found = across(0.4, 4.0, 3, 4)
    shapes = [one.scene.touches[0].shapes[0] for one in found]
    boxes = np.array([one.bounds_mm for one in shapes])
    assert boxes.min() > 2.0
    assert (boxes[:, 2:] < np.array(PAPER.grid.size_mm) - 2.0).all()
    angles = np.array([one.angle_deg for one in shapes if isinstance(one, Ellipse)])
    assert len(angles) == 12
    assert np.ptp(angles) > 90.0
