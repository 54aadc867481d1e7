"""The harness: data, noise, references and reports; and the command that prints them."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from eitskin_proto.sensor.grid import GRID_SHAPE, map_from_units
from eitskin_sim.evaluation import harness, trials
from eitskin_sim.evaluation import report as reports
from eitskin_sim.scene.family import draw
from eitskin_sim.scene.parts import Bend
from eitskin_sim.scene.scene import check_scene, parse_phantoms
from eitskin_sim.scene.shift import shifted
from eitskin_sim.surface.predict import flat_voltages, predict
from eitskin_tools import cli
from eitskin_tools.evaluation import paper_tables, solvers
from eitskin_tools.evaluation.paper import TABLE_2

BENT = {"angle_deg": 90, "stretch_along": 1.06, "stretch_across": 0.985}
FILE = [
    {"name": "two", "truth": "units", "scene": {"bend": BENT, "touches": [{"units": [[3, 2], [10, 6]]}]}},
    {"name": "disc", "truth": "area", "scene": {"bend": BENT, "touches": [{"disc_mm": [70, 45, 6]}]}},
]


@pytest.fixture(scope="module")
def phantoms():
    return parse_phantoms(FILE)


@pytest.fixture(autouse=True)
def coarse(monkeypatch):
    # The harness's logic does not depend on the mesh; its accuracy is the business of the forward model's tests.
    monkeypatch.setattr(harness, "DATA_MM", 3.0)


def test_truth_of_units_is_hard_and_of_areas_a_share(phantoms):
    bits = np.zeros(126)
    bits[[2 * 14 + 3, 6 * 14 + 10]] = 1.0
    assert np.array_equal(harness.truth_map(phantoms[0]), map_from_units(bits))
    area = harness.truth_map(phantoms[1])
    assert area.sum() * (10 / 3) ** 2 == pytest.approx(math.pi * 36, rel=1e-6)


@pytest.mark.parametrize("name", ["l1", "sbl"])
def test_two_separate_units_are_found_exactly(phantoms, name):
    ((_, scores),) = harness.evaluate(phantoms[:1], harness.SOLVERS[name])
    assert scores[0].exact == 1.0
    assert scores[0].cc > 0.95


def test_the_reference_matters_as_in_the_paper(phantoms):
    cc = {
        kind: harness.evaluate(phantoms[:1], harness.SOLVERS["l1"], reference=kind)[0][1][0].cc
        for kind in harness.REFERENCES
    }
    assert cc["pre"] < cc["post"] - 0.1
    assert cc["predicted"] > cc["pre"] + 0.1


def test_a_perfect_solver_gets_perfect_scores_and_sees_noise_by_seed(phantoms):
    seen = []

    def cheat(case):
        seen.append(case.voltages)
        return harness.truth_map(phantoms[0])

    ((_, scores),) = harness.evaluate(phantoms[:1], cheat, seeds=2)
    assert [one.cc for one in scores] == pytest.approx([1.0, 1.0])
    assert not np.array_equal(seen[0], seen[1])
    harness.evaluate(phantoms[:1], cheat, seeds=1)
    assert np.array_equal(seen[0], seen[2])


def test_report_has_the_agreed_keys_and_no_infinity(phantoms):
    found = reports.report("none", "N2", harness.evaluate(phantoms, lambda _: np.zeros((30, 45))))
    assert set(found) == {"solver", "noise", "phantoms", "mean"}
    assert [row["name"] for row in found["phantoms"]] == ["two", "disc"]
    assert set(found["mean"]) == set(reports.MEASURES)
    json.dumps(found, allow_nan=False)


def test_distances_are_reported_where_the_truth_has_two_touches_and_averaged_over_those_alone(phantoms):
    truths = [harness.truth_map(phantom) for phantom in phantoms]
    order = iter(truths)
    found = reports.report("cheat", "N2", harness.evaluate(phantoms, lambda _: next(order)))
    two, disc = found["phantoms"]
    assert (two["touches"], two["true_touches"], two["count_right"], two["exact"]) == (2.0, 2.0, 1.0, 1.0)
    assert two["distance_error"] == 0.0
    assert two["two_point_mm"] > 30.0
    assert (disc["two_point_mm"], disc["distance_error"]) == (None, None)
    assert found["mean"]["two_point_mm"] == two["two_point_mm"]


def test_several_runs_see_the_same_voltages_as_one(phantoms):
    conditions = harness.Conditions(noise="N3", seeds=2)
    runs = [harness.Run(harness.SOLVERS["tikhonov"], kind) for kind in harness.REFERENCES]
    steps = []
    together = harness.evaluate_all(phantoms, runs, conditions, lambda done, total: steps.append((done, total)))
    assert steps == [(1, 2), (2, 2)]
    for run, found in zip(runs, together, strict=True):
        alone = harness.evaluate(phantoms, run.solver, noise="N3", reference=run.reference, seeds=2)
        # NaN is not itself: compare what is printed.
        assert repr(alone) == repr(found)


def test_solvers_can_be_told_another_shape(phantoms):
    clouds = {}
    for kind in harness.CLOUDS:

        def look(case, kind=kind):
            clouds[kind] = case.sheet.cloud_mm
            return np.zeros(GRID_SHAPE)

        harness.evaluate_all(phantoms[:1], [harness.Run(look, "pre")], harness.Conditions(cloud=kind))
    assert np.abs(clouds["flat"][2] - clouds["flat"][2].mean()).max() < 1.0  # 0.1 mm of noise on a plane
    assert np.ptp(clouds["scan"][2]) > 20.0  # bent by 90 degrees
    assert np.abs(clouds["other"] - clouds["scan"]).max() > 5.0


L_OF_TWO_BARS = [
    {
        "name": "L",
        "truth": "area",
        "scene": {"touches": [{"rect_mm": [40, 30, 50, 70]}, {"rect_mm": [50, 30, 70, 40]}, {"disc_mm": [95, 60, 5]}]},
    }
]


def test_shift_moves_every_touch_by_its_own_part_of_a_pixel_and_keeps_an_l_whole():
    (phantom,) = parse_phantoms(L_OF_TWO_BARS)
    moved = shifted(phantom, 0.5, np.random.default_rng(0))
    before, after = ([touch.shapes[0].bounds_mm for touch in one.scene.touches] for one in (phantom, moved))
    moves = np.array(after)[:, :2] - np.array(before)[:, :2]
    assert np.allclose(moves[0], moves[1])
    assert np.abs(moves[0] - moves[2]).max() > 0.1
    assert 0.0 < np.abs(moves).max() <= 0.5 * 10 / 3
    assert [touch.shapes[0].area_mm2 for touch in moved.scene.touches] == pytest.approx([400.0, 200.0, 25 * math.pi])
    assert shifted(phantom, 0.0, np.random.default_rng(0)) is phantom
    assert shifted(phantom, 0.5, np.random.default_rng(0)) == moved


def test_shift_stays_on_the_sheet_and_apart():
    near = [
        {"name": "n", "scene": {"touches": [{"rect_mm": [0, 0, 10, 10]}, {"rect_mm": [11, 0, 20, 10]}]}},
    ]
    (phantom,) = parse_phantoms(near)
    for seed in range(50):
        scene = shifted(phantom, 1.0, np.random.default_rng(seed)).scene
        check_scene(scene)
        first, second = (touch.shapes[0].bounds_mm for touch in scene.touches)
        assert second[0] > first[2] or second[1] > first[3] or first[1] > second[3]


def test_shift_of_units_or_by_more_than_a_pixel_is_refused(phantoms):
    with pytest.raises(ValueError, match="units of the grid"):
        shifted(phantoms[0], 0.5, np.random.default_rng(0))
    with pytest.raises(ValueError, match="from 0 to 1"):
        shifted(phantoms[1], 1.5, np.random.default_rng(0))


def test_trials_can_be_solved_are_drawn_once_and_share_no_bend_with_any_data_set():
    drawn = [
        *trials.single(10.0, 2, 4),
        *trials.pair(90.0, 2, 4),
        *trials.pair(10.0, 2, 4),
        *trials.random((5, 6), 2, 4, "B", "area"),
        *trials.random((2, 4), 2, 4, "A", "units"),
        *trials.untouched(2, "B"),
    ]
    for phantom in drawn:  # their bends were checked when they were drawn
        check_scene(replace(phantom.scene, bend=Bend()))
    assert drawn[:8] == trials.single(10.0, 2, 4)
    assert trials.single(10.0, 1, 4) == drawn[:4]
    assert [len(one.scene.touches) for one in drawn[:8]] == [1] * 8
    mine = {one.scene.bend for one in drawn if one.scene.bend.angle_deg}
    for seed in (0, 1):
        assert not mine & {*draw("A", 4, seed), *draw("B", 4, seed)}


@pytest.mark.parametrize("gap", [10.0, 90.0])
def test_pairs_have_the_gap_that_was_asked_for(gap):
    for phantom in trials.pair(gap, 3, 4):
        first, second = (touch.shapes[0].bounds_mm for touch in phantom.scene.touches)
        gaps = sorted((second[0] - first[2], second[1] - first[3]))
        assert gaps[1] == pytest.approx(gap, abs=1e-9)
        assert gaps[0] == pytest.approx(-10.0, abs=1e-9)


def test_random_sets_have_as_many_touches_as_asked_for_and_hard_labels_on_the_grid():
    for phantom in trials.random((5, 6), 3, 3, "A", "units"):
        truth = harness.truth_map(phantom)
        assert set(np.unique(truth)) == {0.0, 1.0}
        assert 5 <= len(phantom.scene.touches) <= 6


@pytest.mark.parametrize(
    "draw_trials",
    [
        lambda: trials.single(0.0, 1, 1),
        lambda: trials.pair(131.0, 1, 1),
        lambda: trials.random((4, 2), 1, 1, "A", "units"),
        lambda: trials.single(10.0, 0, 1),
        lambda: trials.single(10.0, 1, 0),
    ],
)
def test_trials_that_make_no_sense_are_refused_with_their_bounds(draw_trials):
    with pytest.raises(ValueError, match=r"expected|must be"):
        draw_trials()


def test_summary_takes_the_worst_deformation_and_the_root_of_the_mean_square(monkeypatch):
    drawn = trials.single(10.0, 2, 2)
    monkeypatch.setattr(harness, "voltages_of", lambda scene: np.ones(104))  # nothing here looks at voltages
    truths = [harness.truth_map(phantom) for phantom in drawn]
    shown = [truths[0], truths[1], np.roll(truths[2], 1, axis=1), np.zeros(GRID_SHAPE)]
    order = iter(shown)
    found = reports.summary(harness.evaluate(drawn, lambda _: next(order), noise="none"), 2)
    assert found["maps"] == 4
    assert found["worst_deformation"] == 1
    assert found["deformations"][0]["cc"] == pytest.approx(1.0)
    distances = [0.0, 0.0, 10 / 3, math.hypot(150, 100)]
    assert found["localisation_rms_mm"] == pytest.approx(np.sqrt(np.mean(np.square(distances))), rel=0.02)
    assert found["missed"] == 0.25
    assert found["told_apart"] == 0.75  # one pixel off is near, a missed touch is not
    json.dumps(found, allow_nan=False)


def test_bad_arguments_are_refused(phantoms):
    solver = harness.SOLVERS["tikhonov"]
    with pytest.raises(ValueError, match="at least one phantom"):
        harness.evaluate([], solver)
    with pytest.raises(ValueError, match="'later'"):
        harness.evaluate(phantoms, solver, reference="later")
    with pytest.raises(ValueError, match="'N9'"):
        harness.evaluate(phantoms, solver, noise="N9")


def test_command_prints_one_object(tmp_path, capsys):
    (tmp_path / "phantoms.json").write_text(json.dumps(FILE))
    words = [
        "evaluate",
        "--phantoms",
        str(tmp_path / "phantoms.json"),
        "--solver",
        "tikhonov",
        "--noise",
        "N3",
        "--json",
    ]
    assert cli.main(words) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["solver"], found["noise"], found["reference"]) == ("tikhonov", "N3", "post")
    assert set(found["phantoms"][0]) == {"name", *reports.MEASURES}
    assert found["mean"]["cc"] == pytest.approx(np.mean([row["cc"] for row in found["phantoms"]]))


@pytest.fixture
def tiny(request):
    """A bundle whose head has the V_pred input."""
    return request.config.rootpath / "tests" / "golden" / "tiny.eitskin"


@pytest.fixture
def file(tmp_path):
    (tmp_path / "phantoms.json").write_text(json.dumps(FILE[:1]))
    return str(tmp_path / "phantoms.json")


def test_network_from_a_bundle_is_one_more_solver(tiny, file, capsys):
    words = ["evaluate", "--phantoms", file, "--bundle", str(tiny), "--json"]
    assert cli.main(words) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["solver"], found["reference"], len(found["bundles"])) == ("vd2t", "pre", 1)
    assert found["prediction"] == "scan"


def test_network_explains_which_references_it_takes(tiny, file, capsys):
    words = ["evaluate", "--phantoms", file, "--bundle", str(tiny), "--json"]
    assert cli.main([*words, "--reference", "post"]) == 1
    assert "before the deformation" in capsys.readouterr().err
    assert cli.main([*words, "--reference", "predicted"]) == 0
    assert json.loads(capsys.readouterr().out)["prediction"] == "scan"
    assert cli.main([*words, "--reference", "predicted", "--prediction", "none"]) == 1
    assert "--prediction is none" in capsys.readouterr().err


@pytest.mark.parametrize("prediction", ["scan", "none", "true"])
def test_head_is_fed_the_prediction_from_each_scan_against_the_models_own_flat_sheet(
    tiny, phantoms, monkeypatch, prediction
):
    from eitskin.model.geometry import GeometryGraph

    fed, clouds = [], []
    geometry = GeometryGraph.geometry

    def watched(graph, cloud, log_predicted, revision):
        fed.append(log_predicted)
        clouds.append(cloud)
        return geometry(graph, cloud, log_predicted, revision)

    monkeypatch.setattr(GeometryGraph, "geometry", watched)
    request = solvers.Request("vd2t", bundle=tiny, prediction=prediction)
    solvers.evaluate_requests(phantoms[:1], [request], harness.Conditions(seeds=2))
    assert len(fed) == 2
    assert not np.array_equal(clouds[0], clouds[1])  # each scan has its own noise
    flat, bent = (harness.voltages_of(scene) for scene in (harness.Scene(), phantoms[0].scene.untouched()))
    for cloud, ratio in zip(clouds, fed, strict=True):
        if prediction == "scan":
            assert np.allclose(ratio, np.log(predict(cloud) / flat_voltages()), atol=1e-6)
            assert np.sqrt(np.mean((ratio - np.log(bent / flat)) ** 2)) < 0.02  # scan noise: 0.8 % a row
        elif prediction == "true":
            assert np.allclose(ratio, np.log(bent / flat), atol=1e-6)
        else:
            assert ratio is None


@pytest.mark.parametrize(
    ("words", "kind"),
    [
        (["--single", "10"], "single"),
        (["--pair", "10"], "pair"),
        (["--random", "2-4", "--family", "B", "--labels", "units"], "random"),
        (["--untouched"], "untouched"),
    ],
)
def test_trials_print_one_object(tiny, capsys, words, kind):
    few = ["--deformations", "1", "--each", "1", "--bundle", str(tiny), "--json"]
    assert cli.main(["evaluate", *words, *few]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["trial"]["kind"] == kind
    assert found["maps"] == 1
    assert "peak" in found if kind == "untouched" else "localisation_rms_mm" in found


def test_picture_shows_every_phantom_and_solver(tiny, file, tmp_path, capsys):
    pytest.importorskip("matplotlib", reason="the picture needs the extra 'plot'")
    words = [
        "evaluate",
        "--phantoms",
        file,
        "--bundle",
        str(tiny),
        "--picture",
        str(tmp_path / "gallery.png"),
        "--json",
    ]
    assert cli.main(words) == 0
    assert json.loads(capsys.readouterr().out)["phantoms"] == 1
    assert (tmp_path / "gallery.png").read_bytes().startswith(b"\x89PNG")
    assert cli.main(["evaluate", "--phantoms", file, "--picture", "x.png", "--all"]) == 2


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["--random", "few"], "2-4"),
        (["--single", "10", "--all"], "--phantoms"),
        (["--single", "10", "--labels", "units"], "--labels"),
        (["--single", "10", "--shift-px", "3"], "from 0 to 1"),
    ],
)
def test_trials_that_cannot_be_are_bad_usage(capsys, words, text):
    assert cli.main(["evaluate", *words]) == 2
    assert text in capsys.readouterr().err


def quick(phantoms, requests, conditions, progress):
    """Reports of eight times the same phantom, for the price of one."""
    found = solvers.evaluate_requests(phantoms[:1], requests, conditions, progress)
    return [{**one, "phantoms": one["phantoms"] * len(phantoms)} for one in found]


def test_table_holds_every_solver_and_reference_beside_the_papers(phantoms, monkeypatch):
    monkeypatch.setattr(paper_tables, "CLASSICAL", ("tikhonov-pixels", "tikhonov-units"))
    monkeypatch.setattr(paper_tables, "_has_bundle", lambda phantoms: False)
    eight = [phantoms[0]] * 8
    monkeypatch.setattr(paper_tables, "evaluate_requests", quick)
    table, found = paper_tables.comparison(eight, harness.Conditions())
    assert [(one["solver"], one["reference"]) for one in found] == [
        (f"tikhonov-{cells}", kind) for cells in ("pixels", "units") for kind in ("post", "pre", "predicted")
    ]
    assert "paper: vd2t" in table
    assert f"{found[0]['mean']['cc']:.3f}" in table
    means = next(line for line in table.splitlines() if line.startswith("| paper: sbl"))
    assert means.split(" | ")[2:5] == ["0.742", "19.1", "0.697"]  # FACTS: 0.7417
    assert "paper" not in paper_tables.comparison(eight[:1], harness.Conditions())[0]


def test_the_papers_table_has_the_means_that_its_text_gives():
    means = {name: np.mean(values) for name, values in TABLE_2["cc"].items()}
    assert means == pytest.approx({"tikhonov": 0.6625, "l1": 0.6651, "sbl": 0.7417, "vd2t": 0.9912}, abs=1e-4)
    assert np.mean(TABLE_2["psnr_db"]["vd2t"]) == pytest.approx(38.38, abs=0.01)
    assert np.mean(TABLE_2["rie"]["vd2t"]) == pytest.approx(0.1086, abs=1e-4)


def test_unknown_solver_is_bad_usage_and_a_missing_file_a_failure(tmp_path, capsys):
    assert cli.main(["evaluate", "--phantoms", "x.json", "--solver", "magic"]) == 2
    assert cli.main(["evaluate", "--phantoms", str(tmp_path / "none.json"), "--solver", "l1"]) == 1
    assert capsys.readouterr().out == ""
