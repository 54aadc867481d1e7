"""The reduced model against exact sums of Schur complements, one sparse factorisation, and itself."""

from pathlib import Path

import numpy as np
import pytest

from eitskin_proto.sensor.table import TABLE
from eitskin_proto.skin.cloud import flat_cloud
from eitskin_proto.skin.parts import Map
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.reduced.exact import ExactSheet, exact_sheet
from eitskin_sim.reduced.files import ReducedError, load, save
from eitskin_sim.reduced.making import reduced
from eitskin_sim.reduced.model import ReducedModel, cloud_digest, rows_of
from eitskin_sim.reduced.state import state_of
from eitskin_sim.scene.bend import bend_metric
from eitskin_sim.scene.parts import Bend, Sheet
from eitskin_sim.surface.measured_cloud import measured_cloud
from eitskin_sim.surface.predict import fit_cloud

SMALL = Skin(name="small", map=Map((12, 18), (4, 6)))
"""Few, large units: its reduced model takes a second."""

BEND = Bend(angle_deg=110.0, axis_deg=25.0, twist_deg=12.0, stretch_along=1.12, stretch_across=0.96, nonuniformity=0.06)
MIXED = {0: 0.2, 7: 50.0, 8: 0.6, 14: 200.0, 21: 3.0, 23: 0.1}
"""A corner unit, two side by side, two that meet at a corner: contrasts of either sign."""


@pytest.fixture(scope="module")
def exact() -> ExactSheet:
    return exact_sheet(bend_metric(BEND, Sheet()), SMALL)


@pytest.fixture(scope="module")
def model(exact: ExactSheet) -> ReducedModel:
    return reduced(exact, SMALL, cloud_digest="c" * 16)


def of(contrasts: dict[int, float]) -> tuple[np.ndarray, np.ndarray]:
    return np.array(list(contrasts), dtype=np.intp), np.array(list(contrasts.values()))


def error(found: np.ndarray, expected: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.log(found / expected) ** 2)))


@pytest.mark.parametrize(
    "contrasts",
    [{9: 50.0}, {9: 0.5}, {0: 50.0}, {0: 0.3}, {8: 50.0, 15: 50.0}, MIXED, {unit: 50.0 for unit in range(0, 24, 2)}],
)
def test_voltages_are_those_of_one_sparse_factorisation(
    exact: ExactSheet, model: ReducedModel, contrasts: dict[int, float]
) -> None:
    sigma = np.ones(24)
    sigma[list(contrasts)] = list(contrasts.values())
    straight = exact.system.factorise(sigma[exact.parts.unit_of_element]).voltages()
    assert error(state_of(model, *of(contrasts)).volts, straight) < 1e-3
    assert error(straight, model.untouched_V) > 0.01


def test_the_exact_sum_is_the_factorisation_to_nine_digits(exact: ExactSheet) -> None:
    sigma = np.ones(24)
    sigma[list(MIXED)] = list(MIXED.values())
    straight = exact.system.factorise(sigma[exact.parts.unit_of_element]).voltages()
    assert rows_of(exact.currents(*of(MIXED))[1]) == pytest.approx(straight, rel=1e-8)


def test_nothing_touched_is_the_untouched_sheet(exact: ExactSheet, model: ReducedModel) -> None:
    nothing = state_of(model, np.zeros(0, dtype=np.intp), np.zeros(0))
    assert np.array_equal(nothing.volts, model.untouched_V)
    assert nothing.volts == pytest.approx(exact.system.factorise().voltages(), rel=1e-8)
    assert nothing.without_each().shape == (0, 104)


@pytest.mark.parametrize("unit", [0, 3, 9])
def test_contrasts_near_one_change_hardly_anything_from_either_side(model: ReducedModel, unit: int) -> None:
    up, down = (state_of(model, *of({unit: one})).volts / model.untouched_V - 1.0 for one in (1.001, 0.999))
    assert 0.0 < np.abs(up).max() < 5e-3
    assert up == pytest.approx(-down, rel=0.02, abs=1e-8)


def test_drive_and_measure_are_interchangeable(model: ReducedModel) -> None:
    drives = state_of(model, *of(MIXED)).drives
    assert np.abs(drives - drives.T).max() < 1e-6 * np.abs(drives[TABLE[:, 0], TABLE[:, 1]]).max()


def test_more_patterns_are_nearer(exact: ExactSheet) -> None:
    truth = rows_of(exact.currents(*of(MIXED))[1])
    errors = [error(state_of(reduced(exact, SMALL, rank), *of(MIXED)).volts, truth) for rank in (4, 8, 16)]
    assert errors[0] > 3.0 * errors[1] > 9.0 * errors[2]


def test_steps_from_a_set_are_the_sets_that_they_lead_to(model: ReducedModel) -> None:
    units, contrasts = of(MIXED)
    state = state_of(model, units, contrasts)
    free = np.setdiff1d(np.arange(24), units)
    for contrast in (50.0, 0.4):
        added = state.with_each(free, contrast)
        for row, unit in zip(added, free.tolist(), strict=True):
            assert row == pytest.approx(state_of(model, *of({**MIXED, unit: contrast})).volts, rel=1e-9)
    for number, unit in enumerate(units.tolist()):
        left = {one: value for one, value in MIXED.items() if one != unit}
        direct = state_of(model, *of(left)).volts
        assert state.without_each()[number] == pytest.approx(direct, rel=1e-9)
        assert state.without(number).volts == pytest.approx(direct, rel=1e-9)
    twice = state.without(2).without(0)
    again = {one: value for one, value in MIXED.items() if one not in (0, 8)}
    assert twice.with_each(np.array([10]), 50.0)[0] == pytest.approx(
        state_of(model, *of({**again, 10: 50.0})).volts, rel=1e-9
    )


def test_slopes_are_finite_differences_of_the_contrasts(model: ReducedModel) -> None:
    units, contrasts = of(MIXED)
    slopes, step = state_of(model, units, contrasts).slopes(), 1e-5
    for number in range(len(units)):
        up, down = contrasts.copy(), contrasts.copy()
        up[number] *= np.exp(step)
        down[number] *= np.exp(-step)
        both = (state_of(model, units, up).volts - state_of(model, units, down).volts) / (2.0 * step)
        assert np.abs(slopes[number] - both).max() < 1e-6 * np.abs(both).max()


def test_a_contrast_of_one_or_none_is_refused(model: ReducedModel) -> None:
    for wrong in (1.0, 0.0, -2.0, np.inf):
        with pytest.raises(ValueError, match="none of 1, which changes nothing"):
            state_of(model, np.array([3]), np.array([wrong]))
    with pytest.raises(ValueError, match="expected one for each"):
        state_of(model, np.array([3, 4]), np.array([50.0]))


def test_a_model_comes_back_from_its_file(model: ReducedModel, tmp_path: Path) -> None:
    save(model, tmp_path / "model.npz")
    back = load(tmp_path / "model.npz", SMALL)
    assert np.array_equal(state_of(back, *of(MIXED)).volts, state_of(model, *of(MIXED)).volts)
    assert back.cloud_digest == "c" * 16


def test_a_model_of_another_skin_or_cloud_is_refused_in_one_line(model: ReducedModel, tmp_path: Path) -> None:
    save(model, tmp_path / "model.npz")
    with pytest.raises(ReducedError, match=r"is of skin .* expected .* of skin 'paper'; make it anew"):
        load(tmp_path / "model.npz", PAPER)
    with pytest.raises(ReducedError, match=r"is of cloud c+, expected .*; make it anew from the present cloud"):
        load(tmp_path / "model.npz", SMALL, SMALL.grid.flat_cloud_mm())
    np.savez(tmp_path / "other.npz", format="something", version=1)
    with pytest.raises(ReducedError, match="is no reduced model"):
        load(tmp_path / "other.npz", SMALL)
    (tmp_path / "text.npz").write_text("no archive")
    with pytest.raises(ReducedError, match="is no reduced model"):
        load(tmp_path / "text.npz", SMALL)


def test_a_cloud_is_known_by_its_points() -> None:
    cloud = flat_cloud()
    assert cloud_digest(np.asarray(cloud)) == cloud_digest(np.asarray(cloud, dtype=np.float32).astype(np.float64))
    assert cloud_digest(np.asarray(cloud)) != cloud_digest(np.asarray(cloud) + 0.01)


@pytest.mark.heavy
@pytest.mark.slow
def test_the_paper_s_sheet_is_right_to_a_thousandth_for_twelve_units_and_small() -> None:
    sheet = exact_sheet(bend_metric(BEND, Sheet()))
    model = reduced(sheet)
    assert model.nbytes < 40e6
    rng = np.random.default_rng(8)
    errors = []
    for _ in range(10):
        units = rng.choice(126, 12, replace=False)
        contrasts = np.where(rng.random(12) < 0.5, 50.0, rng.uniform(0.1, 0.8, 12))
        truth = rows_of(sheet.currents(units, contrasts)[1])
        errors.append(error(state_of(model, units, contrasts).volts, truth))
    assert np.sqrt(np.mean(np.square(errors))) < 1e-3


@pytest.mark.heavy
def test_a_measured_cloud_gives_the_model_of_its_surface() -> None:
    cloud = measured_cloud(Bend(angle_deg=60.0, stretch_along=1.05), skin=SMALL)
    model = reduced(exact_sheet(fit_cloud(cloud, SMALL.grid).metric, SMALL), SMALL)
    truth = exact_sheet(bend_metric(Bend(angle_deg=60.0, stretch_along=1.05), Sheet()), SMALL)
    sigma = np.ones(24)
    sigma[[7, 9]] = 50.0
    straight = truth.system.factorise(sigma[truth.parts.unit_of_element]).voltages()
    assert error(state_of(model, np.array([7, 9]), np.array([50.0, 50.0])).volts, straight) < 3e-3
