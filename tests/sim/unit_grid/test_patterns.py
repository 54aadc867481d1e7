"""Touch sets on the unit grid: the paper's counts, uniqueness, and no published phantom among them."""

import json
from pathlib import Path

import numpy as np
import pytest

from eitskin_proto.skin.skin import PAPER
from eitskin_sim.scene.published import PHANTOM_RECTS_MM, PHANTOM_UNITS, is_published
from eitskin_sim.unit_grid.patterns import pack, paper_touch_sets, rich_touch_sets, unpack

GRID = PAPER.grid

PHANTOMS = Path(__file__).parents[3] / "tools" / "eitskin_tools" / "phantoms"


def keys(units: np.ndarray) -> set[bytes]:
    return {row.tobytes() for row in pack(units)}


@pytest.fixture(scope="module")
def paper() -> np.ndarray:
    return paper_touch_sets(0)


def test_papers_sets_are_126_units_384_squares_and_9749_of_two_to_four(paper: np.ndarray) -> None:
    sets = paper
    count = sets.sum(axis=1)
    assert sets.shape == (10_259, 126)
    assert np.array_equal(sets[:126], np.eye(126, dtype=bool))
    assert sorted(set(count[126:510].tolist())) == [side * side for side in range(2, 10)]
    assert np.bincount(count[126:510])[[4, 9, 81]].tolist() == [8 * 13, 7 * 12, 1 * 6]
    assert np.all((count[510:] >= 2) & (count[510:] <= 4))
    assert np.all(np.bincount(count[510:])[2:] > 2_500)


def test_no_set_occurs_twice_and_a_seed_repeats_itself(paper: np.ndarray) -> None:
    assert len(keys(paper)) == len(paper)
    assert np.array_equal(paper, paper_touch_sets(0))
    assert not np.array_equal(rich_touch_sets(20, 0), rich_touch_sets(20, 1))


def test_packed_bits_come_back() -> None:
    sets = rich_touch_sets(50, 1)
    assert pack(sets).shape == (50, 16)
    assert np.array_equal(unpack(pack(sets)), sets)


def test_no_generator_returns_a_phantom(paper: np.ndarray) -> None:
    barred = [frozenset(row * GRID.units[1] + column for column, row in units) for units in PHANTOM_UNITS.values()]
    assert all(is_published(units) for units in barred)
    assert not is_published(set(barred[0]) - {min(barred[0])})
    for sets in (paper, rich_touch_sets(3_000, 0)):
        assert not {frozenset(np.flatnonzero(bits).tolist()) for bits in sets} & set(barred)


def test_barred_table_is_what_the_phantom_files_hold() -> None:
    units = json.loads((PHANTOMS / "paper_units.json").read_text())
    found = {p["name"]: {tuple(u) for touch in p["scene"]["touches"] for u in touch["units"]} for p in units}
    assert found == {name: set(units) for name, units in PHANTOM_UNITS.items()}
    in_mm = json.loads((PHANTOMS / "paper_mm.json").read_text())
    rects = {p["name"]: [tuple(touch["rect_mm"]) for touch in p["scene"]["touches"]] for p in in_mm}
    assert rects == {name: list(rects) for name, rects in PHANTOM_RECTS_MM.items()}
