"""Units of any contrast in one set: exact, above 1 and below, and never silently nothing."""

import numpy as np
import pytest

from eitskin_sim.scene.parts import Bend
from eitskin_sim.unit_grid.patterns import rich_touch_sets, squares, touch_classes
from eitskin_sim.unit_grid.skeleton import unit_system
from eitskin_sim.unit_grid.units import UnitGenerator

BEND = Bend(angle_deg=70.0, axis_deg=-30.0, twist_deg=10.0, stretch_along=1.08, stretch_across=0.97, nonuniformity=0.05)


@pytest.fixture(scope="module")
def generator() -> UnitGenerator:
    return UnitGenerator(BEND)


def naive(units: np.ndarray, contrast: np.ndarray) -> np.ndarray:
    parts, system = unit_system(BEND)
    sigma = np.where(units, contrast, 1.0)[parts.unit_of_element]
    return system.factorise(sigma).voltages()


@pytest.mark.heavy
def test_sets_of_any_contrasts_are_those_of_a_factorisation(generator: UnitGenerator) -> None:
    rng = np.random.default_rng(0)
    units = np.concatenate([rich_touch_sets(40, 1)[-2:], squares(4, 4)[:1], np.zeros((1, 126), dtype=np.bool_)])
    units[0] = np.arange(126) == 0  # the corner unit, under two contacts
    below, above = np.exp(rng.uniform(np.log(0.2), np.log(0.85), units.shape)), rng.uniform(1.2, 200.0, units.shape)
    for contrast in (below, np.where(rng.random(units.shape) < 0.5, below, above)):
        for row, own, sigma in zip(generator.voltages(units, contrast), units, contrast, strict=True):
            assert row == pytest.approx(naive(own, sigma), rel=1e-8)
            assert (np.abs(row / generator.untouched_V - 1.0).max() > 0.01) == own.any()


def test_one_contrast_of_50_is_what_it_was_and_one_below_1_is_no_silence(generator: UnitGenerator) -> None:
    units = rich_touch_sets(20, 1)
    assert generator.voltages(units, np.full(units.shape, 50.0)) == pytest.approx(generator.voltages(units), rel=1e-8)
    lowered = generator.voltages(units[5:6], np.full((1, 126), 0.5))[0]
    assert lowered == pytest.approx(naive(units[5], np.full(126, 0.5)), rel=1e-9)


def test_a_contrast_that_changes_nothing_is_an_error(generator: UnitGenerator) -> None:
    units = rich_touch_sets(3, 1)
    for wrong in (1.0, 0.0, -1.0, np.nan, np.inf):
        contrast = np.full(units.shape, 0.5)
        contrast[2, np.flatnonzero(units[2])[0]] = wrong
        with pytest.raises(
            ValueError, match=r"a touched unit has a contrast of .*; it must be above 0 and differ from 1"
        ):
            generator.voltages(units, contrast)
    with pytest.raises(ValueError, match=r"contrasts have shape \(126,\); they must have that of the sets, \(3, 126\)"):
        generator.voltages(units, np.full(126, 0.5))


def test_every_touch_of_a_set_has_one_class_and_half_of_the_sets_one_for_all() -> None:
    units = rich_touch_sets(400, 2)
    found = touch_classes(units, 32, np.random.default_rng(0))
    assert np.array_equal(found != 255, units)
    assert found[units].max() == 31
    kinds = np.array([len(set(row[row != 255].tolist())) for row in found])
    assert 0.3 < np.mean(kinds[units.sum(axis=1) > 3] > 1) < 0.6
    grid = found.reshape(-1, 9, 14)
    for one, other in ((grid[:, 1:], grid[:, :-1]), (grid[:, :, 1:], grid[:, :, :-1])):
        both = (one != 255) & (other != 255)
        assert np.array_equal(one[both], other[both])
