"""The harness: data, noise, references and reports; and the command that prints them."""

import json
import math

import numpy as np
import pytest

from eitskin_proto.grid import map_from_units
from eitskin_sim import evaluate as harness
from eitskin_sim.scene import parse_phantoms
from eitskin_tools import cli

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
    found = harness.report("none", "N2", harness.evaluate(phantoms, lambda _: np.zeros((30, 45))))
    assert set(found) == {"solver", "noise", "phantoms", "mean"}
    assert [row["name"] for row in found["phantoms"]] == ["two", "disc"]
    assert set(found["mean"]) == set(harness.MEASURES)
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
    assert set(found["phantoms"][0]) == {"name", "cc", "psnr_db", "rie", "localisation_mm", "exact"}
    assert found["mean"]["cc"] == pytest.approx(np.mean([row["cc"] for row in found["phantoms"]]))


def test_network_from_a_bundle_is_one_more_solver(tmp_path, capsys, request):
    bundle = request.config.rootpath / "tests" / "golden" / "tiny.eitskin"
    (tmp_path / "phantoms.json").write_text(json.dumps(FILE[:1]))
    words = ["evaluate", "--phantoms", str(tmp_path / "phantoms.json"), "--bundle", str(bundle), "--json"]
    assert cli.main(words) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["solver"], found["reference"], len(found["bundles"])) == ("vd2t", "pre", 1)
    assert cli.main([*words, "--reference", "post"]) == 1
    assert "before the deformation" in capsys.readouterr().err


def test_unknown_solver_is_bad_usage_and_a_missing_file_a_failure(tmp_path, capsys):
    assert cli.main(["evaluate", "--phantoms", "x.json", "--solver", "magic"]) == 2
    assert cli.main(["evaluate", "--phantoms", str(tmp_path / "none.json"), "--solver", "l1"]) == 1
    assert capsys.readouterr().out == ""
