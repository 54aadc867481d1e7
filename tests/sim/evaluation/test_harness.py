"""The harness: data, noise, references and reports."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from eitskin_proto.skin.parts import Deformations
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.evaluation import harness, trials
from eitskin_sim.evaluation import report as reports
from eitskin_sim.scene.scene import SceneError, parse_phantoms

pytestmark = pytest.mark.heavy


def evaluate(phantoms, solver, *, noise="N2", reference="post"):
    return harness.evaluate_all(phantoms, [harness.Run(solver, reference)], harness.Conditions(noise))[0]


def test_truth_of_units_is_hard_and_of_areas_a_share(phantoms):
    bits = np.zeros(126)
    bits[[2 * 14 + 3, 6 * 14 + 10]] = 1.0
    assert np.array_equal(harness.truth_map(phantoms[0]), PAPER.grid.map_from_units(bits))
    area = harness.truth_map(phantoms[1])
    assert area.sum() * (10 / 3) ** 2 == pytest.approx(math.pi * 36, rel=1e-3)  # a disc is covered by strips


@pytest.mark.parametrize("name", ["l1", "sbl"])
def test_two_separate_units_are_found_exactly(phantoms, name):
    ((_, scores),) = evaluate(phantoms[:1], harness.SOLVERS[name])
    assert scores[0].exact == 1.0
    assert scores[0].cc > 0.95


@pytest.mark.parametrize(
    ("touch", "kind"),
    [
        ({"contrast": 0.4}, "lower"),
        ({"contrast": 1.0, "dent_mm": 8}, "lower"),  # it stretches the sheet, and does nothing else
        ({"contrast": 2.5, "dent_mm": 1}, "raise"),
    ],
)
def test_classical_solvers_look_for_what_the_touches_do(touch, kind):
    touch = {"disc_mm": [70, 45, 10], **touch}
    phantoms = parse_phantoms([{"name": "one", "truth": "area", "scene": {"touches": [touch]}}])
    assert phantoms[0].scene.touch_kind == kind
    ((_, scores),) = evaluate(phantoms, harness.SOLVERS["tikhonov"], noise="none")
    assert scores[0].cc > 0.6


def test_the_reference_matters_as_in_the_paper(phantoms):
    cc = {
        kind: evaluate(phantoms[:1], harness.SOLVERS["l1"], reference=kind)[0][1][0].cc for kind in harness.REFERENCES
    }
    assert cc["pre"] < cc["post"] - 0.1
    assert cc["predicted"] > cc["pre"] + 0.1


def test_a_phantom_has_its_own_noise_whatever_is_evaluated_beside_it(phantoms):
    def seen(which, numbers=None):
        found = []
        runs = [harness.Run(lambda case: found.append(case.voltages) or np.zeros(PAPER.grid.shape), "pre")]
        harness.evaluate_all(which, runs, harness.Conditions(), numbers=numbers)
        return found

    second = seen(phantoms)[1]
    assert np.array_equal(seen(phantoms[1:], [1])[0], second)
    other = [replace(phantoms[1], name="again"), phantoms[1]]
    assert not np.array_equal(*seen(other)), "no two of one file have the same"


def test_a_phantom_that_cannot_be_solved_is_named():
    fine = [{"name": "good", "scene": {}}, {"name": "fine", "scene": {"element_size_mm": 0.2}}]
    with pytest.raises(SceneError, match=r"^phantoms\[1\] 'fine': the scene needs a mesh of \d+ elements"):
        evaluate(parse_phantoms(fine), lambda case: np.zeros(PAPER.grid.shape), noise="none")


def test_distances_are_reported_where_the_truth_has_two_touches_and_averaged_over_those_alone(phantoms):
    truths = [harness.truth_map(phantom) for phantom in phantoms]
    order = iter(truths)
    found = reports.report("cheat", "N2", evaluate(phantoms, lambda _: next(order)))
    two, disc = found["phantoms"]
    assert (two["touches"], two["true_touches"], two["count_right"], two["exact"]) == (2.0, 2.0, 1.0, 1.0)
    assert two["distance_error"] == 0.0
    assert two["two_point_mm"] > 30.0
    assert (disc["two_point_mm"], disc["distance_error"]) == (None, None)
    assert found["mean"]["two_point_mm"] == two["two_point_mm"]


def test_the_flat_reference_is_the_devices_own_before_what_came_late():
    seen = []

    def solver(case):
        seen.append(case)
        return np.zeros(PAPER.grid.shape)

    layers = [{}, {"gauge_factor": 1.0}, {"late": {"factor": 1.1}}, {"gauge_factor": 1.0, "late": {"factor": 1.1}}]
    scenes = [{"sheet": layer, "bend": {"stretch_along": 1.2}, "element_size_mm": 6} for layer in layers]
    device = parse_phantoms([{"scene": scene} for scene in scenes])
    evaluate(device, solver, noise="none", reference="pre")
    for case in seen:  # on the flat sheet a gauge does nothing
        np.testing.assert_allclose(case.reference, seen[0].reference, rtol=1e-9)
    assert all(np.array_equal(case.voltages, case.sheet.untouched) for case in seen)
    even, gauged, drifted, _ = (case.voltages / case.reference for case in seen)
    # Contacts keep their impedance, which is why it is not 1.1 and 1.2 to the last digit.
    np.testing.assert_allclose(even / drifted, 1.1, rtol=0.02)
    np.testing.assert_allclose(gauged / even, 1.2, rtol=0.02)


def test_summary_takes_the_worst_deformation_and_the_root_of_the_mean_square(monkeypatch):
    drawn = trials.single(10.0, 2, 2)
    monkeypatch.setattr(harness, "voltages_of", lambda scene: np.ones(104))  # nothing here looks at voltages
    truths = [harness.truth_map(phantom) for phantom in drawn]
    shown = [truths[0], truths[1], np.roll(truths[2], 1, axis=1), np.zeros(PAPER.grid.shape)]
    order = iter(shown)
    found = reports.summary(evaluate(drawn, lambda _: next(order), noise="none"), 2)
    assert found["maps"] == 4
    assert found["worst_deformation"] == 1
    assert found["deformations"][0]["cc"] == pytest.approx(1.0)
    distances = [0.0, 0.0, 10 / 3, math.hypot(150, 100)]
    assert found["localisation_rms_mm"] == pytest.approx(np.sqrt(np.mean(np.square(distances))), rel=0.02)
    assert found["missed"] == 0.25
    assert found["told_apart"] == 0.75  # one pixel off is near, a missed touch is not
    json.dumps(found, allow_nan=False)


def test_intervals_count_deformations_rather_than_maps(monkeypatch):
    drawn = trials.single(10.0, 8, 6)
    monkeypatch.setattr(harness, "voltages_of", lambda scene: np.ones(104))
    truths = [harness.truth_map(phantom) for phantom in drawn]
    right_in_half = iter([truth if index // 6 % 2 else 0.0 * truth for index, truth in enumerate(truths)])
    found = reports.summary(evaluate(drawn, lambda _: next(right_in_half), noise="none"), 6)
    low, high = found["interval_95"]["missed"]
    assert found["missed"] == 0.5
    # Eight deformations of missed or found touches: the mean's standard deviation is 0.5 / sqrt(8). Independent maps
    # would give 0.5 / sqrt(48), an interval less than half as long.
    assert high - low == pytest.approx(2 * 1.96 * 0.5 / np.sqrt(8), rel=0.25)


def test_bad_arguments_are_refused(phantoms):
    solver = harness.SOLVERS["tikhonov"]
    with pytest.raises(ValueError, match="at least one phantom"):
        evaluate([], solver)
    with pytest.raises(ValueError, match="'later'"):
        evaluate(phantoms, solver, reference="later")
    with pytest.raises(ValueError, match="'N9'"):
        evaluate(phantoms, solver, noise="N9")
    fixed = replace(PAPER, deformations=Deformations(*((0.0, 0.0),) * 4, (1.0, 1.0), (1.0, 1.0), (0.0, 0.0)))
    with pytest.raises(ValueError, match="no other shape can be drawn"):
        harness.evaluate_all(phantoms, [harness.Run(solver, "pre")], harness.Conditions(cloud="other", skin=fixed))
