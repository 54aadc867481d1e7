"""``eitskin evaluate``: one object for every solver, and a line for every mistake."""

import json

import numpy as np
import pytest
from tests.sim.evaluation.two_phantoms import FILE

from eitskin.model.bundle import default_path, load_bundle
from eitskin_sim.evaluation import harness
from eitskin_sim.evaluation import report as reports
from eitskin_sim.scene.scene import parse_phantoms
from eitskin_sim.surface.predict import flat_voltages, predict
from eitskin_tools import cli
from eitskin_tools.evaluation import solvers
from eitskin_tools.evaluation.printed import PAPER_CC

pytestmark = pytest.mark.heavy


@pytest.fixture(scope="module")
def phantoms():
    return parse_phantoms(FILE)


@pytest.fixture(autouse=True)
def coarse(monkeypatch):
    monkeypatch.setattr(harness, "DATA_MM", 3.0)


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
    assert not np.array_equal(clouds[0], clouds[1])  # each cloud has its own noise
    flat, bent = (harness.voltages_of(scene) for scene in (harness.Scene(), phantoms[0].scene.untouched()))
    for cloud, ratio in zip(clouds, fed, strict=True):
        if prediction == "scan":
            assert np.allclose(ratio, np.log(predict(cloud) / flat_voltages()), atol=1e-6)
            assert np.sqrt(np.mean((ratio - np.log(bent / flat)) ** 2)) < 0.02  # noise of the cloud: 0.8 % a row
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
    few = ["--deformations", "1", "--bundle", str(tiny), "--json"]
    few += [] if kind == "untouched" else ["--each", "1"]
    assert cli.main(["evaluate", *words, *few]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["trial"]["kind"] == kind
    assert found["maps"] == 1
    assert "peak" in found if kind == "untouched" else "localisation_rms_mm" in found


def test_ghosts_are_those_of_the_network_for_the_skin_s_touches(capsys):
    words = ["evaluate", "--untouched", "--deformations", "1", "--json"]
    for skin, touches in (("paper", "raise"), ("hydrogel", "lower")):
        assert cli.main([*words, "--skin", skin]) == 0
        assert json.loads(capsys.readouterr().out)["bundles"] == [load_bundle(default_path("area", touches)).id]


def test_a_bundle_that_a_classical_solver_does_not_read_is_told_of(tiny, file, capsys):
    assert cli.main(["evaluate", "--phantoms", file, "--solver", "tikhonov", "--bundle", str(tiny), "--json"]) == 0
    found = capsys.readouterr()
    assert json.loads(found.out)["solver"] == "tikhonov"
    assert "--bundle does nothing with --solver tikhonov" in found.err


def test_the_papers_table_has_the_means_that_its_text_gives():
    means = {name: np.mean(values) for name, values in PAPER_CC.items()}
    assert means == pytest.approx({"tikhonov": 0.6625, "l1": 0.6651, "sbl": 0.7417, "vd2t": 0.9912}, abs=1e-4)
