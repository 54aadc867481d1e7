"""``eitskin evaluate``: one object for every solver, and a line for every mistake."""

import json

import numpy as np
import pytest
from tests.sim.evaluation.two_phantoms import FILE

from eitskin_sim.evaluation import harness
from eitskin_sim.evaluation import report as reports
from eitskin_tools import cli

pytestmark = pytest.mark.heavy


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


def test_network_from_a_bundle_is_one_more_solver_with_the_prediction_that_is_named(tiny, file, capsys):
    means = {}
    for prediction in ("scan", "none"):
        words = ["evaluate", "--phantoms", file, "--bundle", str(tiny), "--prediction", prediction, "--json"]
        assert cli.main(words) == 0
        found = json.loads(capsys.readouterr().out)
        assert (found["solver"], found["reference"], len(found["bundles"])) == ("vd2t", "pre", 1)
        assert found["prediction"] == prediction
        means[prediction] = found["mean"]["cc"]
    assert means["scan"] != means["none"]


@pytest.mark.parametrize(
    ("words", "kind"),
    [
        (["--single", "10"], "single"),
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


def test_a_bundle_that_a_classical_solver_does_not_read_is_told_of(tiny, file, capsys):
    assert cli.main(["evaluate", "--phantoms", file, "--solver", "tikhonov", "--bundle", str(tiny), "--json"]) == 0
    found = capsys.readouterr()
    assert json.loads(found.out)["solver"] == "tikhonov"
    assert "--bundle does nothing with --solver tikhonov" in found.err


def test_people_read_the_verdict_before_the_table(tiny, capsys):
    few = ["--deformations", "1", "--each", "1", "--seed", "3", "--bundle", str(tiny)]
    assert cli.main(["evaluate", "--single", "10", *few]) == 0
    verdict, conditions, *table = capsys.readouterr().out.splitlines()
    assert verdict.startswith("vd2t: CC")
    assert "1 deformations of family A, 1 maps at each, seed 3" in conditions
    assert any(line.startswith("localisation_rms_mm") for line in table)
