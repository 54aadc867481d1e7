"""The fast generator of touched units is the naive solve, to 1e-8, whatever the bend and the set."""

import numpy as np
import pytest

from eitskin_sim.scene.parts import Bend
from eitskin_sim.unit_grid.patterns import paper_touch_sets, squares
from eitskin_sim.unit_grid.skeleton import unit_lines, unit_system
from eitskin_sim.unit_grid.units import UnitGenerator

BEND = Bend(
    angle_deg=110.0,
    axis_deg=20.0,
    skew=0.3,
    twist_deg=15.0,
    stretch_along=1.12,
    stretch_across=0.96,
    nonuniformity=0.06,
    bumps_mm=((60.0, 40.0, 5.0, 15.0),),
)


@pytest.fixture(scope="module")
def generator() -> UnitGenerator:
    return UnitGenerator(BEND)


def naive(bits: np.ndarray) -> np.ndarray:
    parts, system = unit_system(BEND)
    return system.factorise(np.where(bits[parts.unit_of_element], 50.0, 1.0)).voltages()


def units(*numbers: int) -> np.ndarray:
    bits = np.zeros(126, dtype=bool)
    bits[list(numbers)] = True
    return bits


SETS = {
    "a corner, where its electrodes' contacts are touched too": units(0),
    "one in the middle": units(64),
    "two that share a corner": units(50, 65),
    "a ring with a hole": units(30, 31, 32, 44, 46, 58, 59, 60),
    "a square of 3 x 3, condensed onto its outline": squares(3, 3)[40],
    "seventeen scattered": units(*range(0, 126, 7)[:17]),
}


# 1e-8 is what the generator promises; what is left is the rounding of both ways, 1e-11 to 1e-9 on the weakest rows.
@pytest.mark.parametrize("name", SETS)
def test_voltages_are_those_of_one_factorisation_a_sample(generator: UnitGenerator, name: str) -> None:
    bits = SETS[name]
    expected = naive(bits)
    assert generator.voltages(bits[None])[0] == pytest.approx(expected, rel=1e-8)
    one_less = bits.copy()
    one_less[np.flatnonzero(bits)[0]] = False
    assert np.abs(generator.voltages(one_less[None])[0] / expected - 1.0).max() > 1e-4


def test_nothing_touched_is_the_untouched_sheet(generator: UnitGenerator) -> None:
    expected = naive(np.zeros(126, dtype=bool))
    assert generator.untouched_V == pytest.approx(expected, rel=1e-8)
    assert np.array_equal(generator.voltages(np.zeros((1, 126), dtype=bool))[0], generator.untouched_V)


def test_sets_of_all_sizes_may_be_mixed(generator: UnitGenerator) -> None:
    sets = paper_touch_sets(0)[[7, 300, 505, 2_000, 126, 9_000]]
    together = generator.voltages(sets)
    for row, bits in zip(together, sets, strict=True):
        assert row == pytest.approx(generator.voltages(bits[None])[0], rel=1e-10)


def test_lines_stand_on_borders_and_on_contacts_edges() -> None:
    edges = [4.0, 10.5, 14.5, 73.0, 77.0, 146.0]
    lines = unit_lines(150.0, 14, edges)
    for wanted in (*edges, *np.linspace(0.0, 150.0, 15)):
        assert np.abs(lines - wanted).min() < 1e-8
    assert np.diff(lines).min() > 0.1
