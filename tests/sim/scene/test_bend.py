import numpy as np
import pytest

from eitskin_sim.scene.bend import metric, surface
from eitskin_sim.scene.folds import check_bend
from eitskin_sim.scene.parts import Bend, Sheet

SHEET = Sheet()
POINTS = np.random.default_rng(0).uniform([0.0, 0.0], [150.0, 100.0], (200, 2))
EVERYTHING = Bend(
    angle_deg=180,
    axis_deg=30,
    skew=0.7,
    twist_deg=40,
    stretch_along=1.1,
    stretch_across=0.9,
    nonuniformity=0.1,
    bumps_mm=((50, 40, 6, 15), (100, 60, -6, 20)),
)


def differences(bend: Bend, step: float = 1e-4) -> np.ndarray:
    dx, dy = (
        (surface(bend, SHEET, POINTS + step * e) - surface(bend, SHEET, POINTS - step * e)) / (2 * step)
        for e in np.eye(2)
    )
    return np.stack([(dx * dx).sum(1), (dx * dy).sum(1), (dy * dy).sum(1)], axis=-1)


@pytest.mark.parametrize(
    "bend",
    [
        Bend(),
        Bend(angle_deg=350),
        Bend(angle_deg=-120, axis_deg=70, skew=-1),
        Bend(twist_deg=60, stretch_along=1.1),
        Bend(nonuniformity=0.3, stretch_across=0.9),
        Bend(bumps_mm=((60, 50, 6, 12),)),
        EVERYTHING,
    ],
)
def test_metric_is_that_of_the_surface_by_central_differences(bend: Bend) -> None:
    # Central differences at 1e-4 mm carry about 1e-9 of rounding and truncation.
    np.testing.assert_allclose(metric(bend, SHEET, POINTS), differences(bend), atol=5e-9)


def test_flat_sheet_stays_where_it_is() -> None:
    expected = np.column_stack([POINTS, np.zeros(len(POINTS))])
    np.testing.assert_allclose(surface(Bend(), SHEET, POINTS), expected, atol=1e-12)


@pytest.mark.parametrize("axis_deg", [0.0, 25.0, 90.0, 200.0])
@pytest.mark.parametrize("skew", [-1.0, 0.0, 0.6])
def test_rolling_alone_leaves_the_metric_flat_to_the_last_bit(axis_deg: float, skew: float) -> None:
    found = metric(Bend(angle_deg=300, axis_deg=axis_deg, skew=skew), SHEET, POINTS)
    assert np.array_equal(found, np.tile([1.0, 0.0, 1.0], (len(POINTS), 1)))


def test_half_turn_makes_a_half_cylinder() -> None:
    ends = surface(Bend(angle_deg=180), SHEET, np.array([[0.0, 50.0], [150.0, 50.0]]))
    assert np.linalg.norm(ends[1] - ends[0]) == pytest.approx(2 * 150 / np.pi, rel=1e-12)


@pytest.mark.parametrize("angle_deg", [10.0, 180.0, 340.0, 350.0])
@pytest.mark.parametrize("axis_deg", [0.0, 40.0, 90.0])
def test_rolls_up_to_350_degrees_are_accepted(angle_deg: float, axis_deg: float) -> None:
    check_bend(Bend(angle_deg=angle_deg, axis_deg=axis_deg), SHEET)


@pytest.mark.parametrize(
    ("bend", "says"),
    [
        (Bend(angle_deg=360), "more than 2 mm apart"),
        (Bend(angle_deg=358), "more than 2 mm apart"),
        (Bend(angle_deg=800), "more than 2 mm apart"),
        (Bend(angle_deg=180, twist_deg=360), "more than 2 mm apart"),
        (Bend(angle_deg=20_000), "half the thickness, 1 mm"),
        (Bend(nonuniformity=1.2), "below stretch_along = 1"),
        (Bend(bumps_mm=((75, 50, 60, 3),)), "half the thickness"),
        (Bend(angle_deg=340, bumps_mm=((75, 50, 30, 10),)), "below 1"),
    ],
)
def test_bend_that_folds_the_sheet_is_refused_with_value_and_bound(bend: Bend, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        check_bend(bend, SHEET)
