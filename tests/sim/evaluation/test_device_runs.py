"""Trials on mismatched devices: solvers are held to the nominal truth, and rows differ by the mismatch alone."""

from dataclasses import replace

import numpy as np
import pytest

from eitskin_proto.skin.parts import Ring
from eitskin_proto.skin.quantity import Quantity
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.evaluation import device_runs as runs
from eitskin_sim.evaluation.harness import Run, truth_map
from eitskin_sim.evaluation.mismatch import IDEAL, Mismatch
from eitskin_sim.scene.parts import Phantom, Scene, Touch
from eitskin_sim.scene.shapes import Rect

SQUARE = Phantom("square", Scene(touches=(Touch((Rect(60.0, 40.0, 70.0, 50.0),)),)), "area")
HARD = runs.Trial("hard", (SQUARE,))
PRESS = runs.Trial(
    "press", (Phantom("press", Scene(touches=(Touch(SQUARE.scene.touches[0].shapes, contrast=0.5),)), "area"),), True
)
QUIET = runs.Plan(noise="none")


@pytest.fixture(autouse=True)
def coarse(monkeypatch):
    monkeypatch.setattr(runs, "ELEMENT_MM", 4.5)
    caches = runs.voltages_of, runs._response
    for one in caches:
        one.cache_clear()
    yield
    for one in caches:
        one.cache_clear()


def seen(rows, kinds, plan=QUIET, reference="pre"):
    """The cases that a solver is given, and the rows."""
    cases = []

    def solve(case):
        cases.append(case)
        return truth_map(SQUARE)

    names = {kind.name: Run(solve, reference) for kind in kinds}
    found = runs.run_rows(rows, kinds, names, {kind.name: lambda volts, reference: True for kind in kinds}, plan)
    return cases, found


def test_a_solver_that_knows_the_nominal_truth_is_right_whatever_the_device():
    rows = [("none", IDEAL), ("gauge", Mismatch(gauge_factor=1.0)), ("long", Mismatch(length_mm=153.0))]
    _, found = seen(rows, [HARD])
    assert [row["name"] for row in found] == ["none", "gauge", "long"]
    for row in found:
        assert row["hard"]["cc"] == pytest.approx(1.0)
        assert (row["hard"]["missed"], row["hard"]["gate_missed"]) == (0.0, 0.0)
    assert found[1]["devices"] == [{"gauge_factor": 1.0}]


def test_drift_is_in_the_voltages_and_not_in_the_reference():
    (still, drifted), _ = seen([("none", IDEAL), ("drift", Mismatch(drift_percent=10.0))], [HARD])
    assert np.allclose(drifted.flat_reference, still.flat_reference, rtol=1e-6)
    ratio = drifted.voltages / still.voltages
    assert 0.88 < np.median(ratio) < 0.95  # by a tenth less, but for the touch, whose conductivity stays
    assert drifted.reference is drifted.flat_reference


def test_a_press_keeps_its_contrast_and_tells_the_solver_that_it_lowers():
    (hard, press), _ = seen([("contrast", Mismatch(contrast=10.0, border_mm=2.0))], [HARD, PRESS])
    (_, plain), _ = seen([("none", IDEAL)], [HARD, PRESS])
    assert np.array_equal(press.voltages, plain.voltages)
    assert (hard.lowering, press.lowering) == (False, True)


def test_draws_are_of_the_devices_and_an_ideal_one_needs_no_second():
    plan = runs.Plan(draws=2, noise="none")
    cases, found = seen([("none", IDEAL), ("off", Mismatch(electrodes_mm=1.0)), ("random", None)], [HARD], plan)
    assert [row["hard"]["maps"] for row in found] == [1, 2, 2]
    assert len({case.voltages.tobytes() for case in cases}) == 5
    assert len(found[2]["devices"]) == 2
    again, _ = seen([("random", None)], [HARD], plan)
    assert np.array_equal(again[0].voltages, cases[3].voltages)
    second, _ = seen([("random", None)], [HARD], runs.Plan(first=1, noise="none"))
    assert np.array_equal(second[0].voltages, cases[4].voltages)
    other, _ = seen([("random", None)], [HARD], runs.Plan(draws=1, seed=1, noise="none"))
    assert not np.array_equal(other[0].voltages, cases[3].voltages)


def test_a_solver_that_is_told_of_another_skin_sees_the_same_voltages_and_its_own_prediction():
    moved = Ring(arc_length_mm=Quantity(tuple(PAPER.arc_length_mm + np.linspace(-2.0, 2.0, 16))))
    twin = replace(PAPER, electrodes=moved)
    (plain,), _ = seen([("none", IDEAL)], [HARD])
    (told,), _ = seen([("none", IDEAL)], [HARD], replace(QUIET, skin=twin))
    assert np.array_equal(told.voltages, plain.voltages)
    assert told.sheet.skin == twin
    assert np.abs(told.sheet.predicted() / plain.sheet.predicted() - 1.0).max() > 0.02
