"""``bench verify``: its rows and tables, the touches that it draws, and the picture of p."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eitskin_proto.skin.skin import PAPER
from eitskin_sim.scene.area import area_map
from eitskin_sim.scene.parts import Scene, Touch
from eitskin_sim.scene.shapes import Disc, Ellipse, Polygon, Rect
from eitskin_sim.verification.residual import Noise
from eitskin_sim.verification.touch_prior import touch_prior
from eitskin_tools.bench.verify import LEVELS, Allowed, draw, matched, of_rows, pieces_of_touches, tables
from eitskin_tools.bench.verify_conditions import (
    across,
    anywhere_conditions,
    paper_like,
    unit_conditions,
)

COUNTED: dict[str, Any] = {
    "maps": 10, "wrong": 2, "wrong_unflagged": 1, "right_flagged": 3, "chi_squared_median": 99.6, "cpu_ms_median": 2.04,
    "cpu_ms_p95": 19.0, "setup_ms_median": 400.0, "p_values": [0.2, 0.6],
}  # fmt: skip
UNITS = {"what": "1 to 6 units, N2", "network_exact": 0.7, "exact": 0.8, **COUNTED}
ANYWHERE = {
    "what": "pairs", "network_right": 0.5, "network_cc": 0.98, "network_cc_worst": 0.9,
    "network_localisation_median_mm": None, "network_localisation_rms_mm": None, "right": 0.8, "cc": 0.991,
    "cc_worst": 0.9, "localisation_median_mm": 0.2, "localisation_rms_mm": 0.25, "allowed_median_mm": 0.15,
    "allowed_rms_mm": 0.3, "known_median_mm": None, "known_rms_mm": None, **COUNTED,
}  # fmt: skip
STATED = {"what": "p, matched model, N2", "stated": 0.01, "found": 0.012, "error": 0.002}


def test_a_table_has_a_line_for_every_row_and_as_many_cells_as_its_head() -> None:
    text = tables([UNITS], [ANYWHERE], [STATED])
    first, second, third = text.split("\n\n")
    for table in (first, second, third):
        cells = {line.count("|") for line in table.splitlines()}
        assert len(cells) == 1, table
    assert "| 1 to 6 units, N2 | 10 | 70 % | 80 % | 1 of 2 | 3 of 8 | 100 | 2.0 / 19.0 |" in first
    assert "| pairs | 10 | 0.980, - | 0.991 / 0.900 | 0.20 / 0.25 | 0.15 / 0.30 | - / - | 80 % | 1 of 2 |" in second
    assert tables([], [], []) == ""


def test_p_is_counted_where_nothing_but_the_scan_is_off() -> None:
    rows = of_rows([UNITS, {**UNITS, "what": "contacts x3"}])
    assert len(rows) == len(LEVELS)
    assert {row["what"] for row in rows} == {"p, 1 to 6 units, N2, scanned"}
    assert next(row["found"] for row in rows if row["stated"] == 0.5) == 0.5


def test_p_keeps_its_word_where_the_model_is_right() -> None:
    rows = matched(3)
    assert len(rows) == 3 * len(LEVELS)
    assert all(abs(row["found"] - row["stated"]) < 4.0 * row["error"] for row in rows)


def test_every_row_has_a_name_of_its_own() -> None:
    names = [one.name for one in unit_conditions()] + [one.name for one in anywhere_conditions()]
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


def test_what_data_allow_is_more_with_noise_and_less_for_a_known_sheet_and_nothing_of_an_l() -> None:
    touch = Touch((Rect(40.0, 40.0, 50.0, 50.0),))
    allowed, noisier = (Allowed(Noise(law), touch_prior("raise", PAPER)) for law in ("N2", "N3"))
    allowed.deform(PAPER.grid.flat_cloud_mm())
    noisier._models = allowed._models
    for one in (allowed, noisier):
        one.add(Scene(touches=(touch,)))
    found = {"N2": allowed.figures(), "N3": noisier.figures()}
    for row in found.values():
        assert 0.0 < row["known_rms_mm"] < row["allowed_rms_mm"] < 5.0
        assert row["allowed_median_mm"] < row["allowed_rms_mm"]
    assert found["N2"]["known_rms_mm"] < found["N3"]["known_rms_mm"]
    allowed.add(Scene(touches=(replace(touch, shapes=(*touch.shapes, Rect(50.0, 40.0, 60.0, 45.0))),)))
    assert set(allowed.figures().values()) == {None}


def test_touches_become_the_pieces_that_are_verified() -> None:
    touches = [Touch((Rect(40.0, 20.0, 50.0, 26.0),), contrast=0.4), Touch((Disc(80.0, 50.0, 8.0),), border_mm=4.0)]
    found = pieces_of_touches(touches, 2.0)
    assert found.tolist() == [[0, 45, 23, 10, 6, 0, 0.4, 0], [2, 80, 50, 16, 16, 0, 25.0, 4.0]]
    turned = pieces_of_touches([Touch((Ellipse(80.0, 50.0, 16.0, 9.0, 20.0),), contrast=3.0)], 1.0)
    assert turned.tolist() == [[2, 80, 50, 16, 9, 20.0, 3.0, 0]]
    with pytest.raises(ValueError, match="Polygon: expected rectangles, discs and ellipses"):
        pieces_of_touches([Touch((Polygon(((40.0, 20.0), (50.0, 20.0), (45.0, 30.0))),))], 1.0)


def test_the_picture_of_p_is_drawn(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    draw(tmp_path / "p.png", [STATED, {**STATED, "stated": 0.5, "found": 0.48}])
    assert (tmp_path / "p.png").read_bytes()[:4] == b"\x89PNG"
    assert np.isfinite((tmp_path / "p.png").stat().st_size)
