"""The model of the coarse mesh, corrected, against exact sums on the fine one."""

from dataclasses import replace

import numpy as np
import pytest

from eitskin_proto.skin.parts import Map
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.fem.q2 import interpolation
from eitskin_sim.fem.solve import solve_scene
from eitskin_sim.reduced.exact import exact_sheet
from eitskin_sim.reduced.making import reduced
from eitskin_sim.reduced.model import ReducedModel, rows_of
from eitskin_sim.reduced.quick import quick_model
from eitskin_sim.reduced.state import state_of
from eitskin_sim.scene.bend import bend_metric
from eitskin_sim.scene.nominal import flat_metric_of, nominal_scene
from eitskin_sim.scene.parts import Bend, Sheet

SMALL = Skin(name="small", map=Map((12, 18), (4, 6)))
BEND = Bend(angle_deg=110.0, axis_deg=25.0, twist_deg=12.0, stretch_along=1.12, stretch_across=0.96, nonuniformity=0.06)
UNITS, CONTRASTS = np.array([0, 7, 8, 14, 21]), np.array([0.2, 50.0, 0.6, 200.0, 3.0])


def error(found: np.ndarray, expected: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.log(found / expected) ** 2)))


@pytest.fixture(scope="module")
def flat_model() -> ReducedModel:
    """Of the flat sheet; the first of a skin makes what all others share."""
    return quick_model(flat_metric_of(SMALL), SMALL)


def test_on_the_flat_sheet_it_is_the_fine_model(flat_model: ReducedModel) -> None:
    fine, quick = reduced(exact_sheet(flat_metric_of(SMALL), SMALL), SMALL), flat_model
    for name in ("loads", "untouched", "polynomials"):
        own, expected = getattr(quick, name), getattr(fine, name)
        assert own == pytest.approx(expected, rel=1e-7, abs=1e-8 * np.abs(expected).max()), name
    largest = float(np.abs(fine.coupling).max())  # units further than NEAR apart stay as the coarse mesh has them
    assert quick.coupling == pytest.approx(fine.coupling, abs=1e-3 * largest)
    assert quick.diagonal == pytest.approx(fine.diagonal, abs=1e-5 * largest)


def test_on_a_bent_sheet_it_is_nearer_than_the_coarse_mesh_alone() -> None:
    metric = bend_metric(BEND, Sheet())
    truth = rows_of(exact_sheet(metric, SMALL).currents(UNITS, CONTRASTS)[1])
    coarse = rows_of(exact_sheet(metric, SMALL, coarse=True).currents(UNITS, CONTRASTS)[1])
    found = state_of(quick_model(metric, SMALL, "c" * 16), UNITS, CONTRASTS).volts
    assert error(found, truth) < 0.5 * error(coarse, truth)


@pytest.mark.heavy
@pytest.mark.slow
def test_the_paper_s_sheet_is_right_to_a_thousandth_for_twelve_units() -> None:
    metric = bend_metric(BEND, Sheet())
    exact, model = exact_sheet(metric), quick_model(metric)
    rng, errors = np.random.default_rng(8), []
    for _ in range(10):
        units = rng.choice(PAPER.grid.n_units, 12, replace=False)
        contrasts = np.where(rng.random(12) < 0.5, 50.0, rng.uniform(0.1, 0.8, 12))
        truth = rows_of(exact.currents(units, contrasts)[1])
        errors.append(error(state_of(model, units, contrasts).volts, truth))
    assert np.sqrt(np.mean(np.square(errors))) < 1e-3


def test_interpolation_is_exact_for_parabolas_within_elements() -> None:
    lines = np.array([0.0, 2.0, 3.0, 7.0])
    nodes = np.array([0.0, 1.0, 2.0, 2.5, 3.0, 5.0, 7.0])
    at = np.linspace(0.0, 7.0, 29)
    assert interpolation(at, lines) @ (nodes**2 - 3.0 * nodes) == pytest.approx(at**2 - 3.0 * at, abs=1e-12)


def test_a_gauge_factor_beside_the_skin_s_is_that_of_such_a_sheet() -> None:
    bend, gauge = Bend(angle_deg=80.0, axis_deg=30.0, stretch_along=1.12, stretch_across=0.97), 0.8
    metric = bend_metric(bend, Sheet())
    fine = exact_sheet(metric, SMALL, gauge=gauge)
    plain = nominal_scene(SMALL, bend)
    scene = replace(plain, sheet=replace(plain.sheet, gauge_factor=plain.sheet.gauge_factor + gauge))
    ratio = rows_of(fine.untouched) / rows_of(exact_sheet(metric, SMALL).untouched)
    solved = [solve_scene(one).voltages for one in (scene, plain)]
    assert np.abs(ratio - 1.0).max() > 0.05
    assert ratio == pytest.approx(solved[0] / solved[1], rel=2e-4)
    truth = rows_of(fine.currents(UNITS, CONTRASTS)[1])
    coarse = rows_of(exact_sheet(metric, SMALL, coarse=True, gauge=gauge).currents(UNITS, CONTRASTS)[1])
    found = state_of(quick_model(metric, SMALL, gauge=gauge), UNITS, CONTRASTS).volts
    assert error(found, truth) < 0.5 * error(coarse, truth)
