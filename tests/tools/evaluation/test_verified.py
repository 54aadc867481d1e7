"""``evaluate --solver verified``: what a report gains, what is refused, and a phantom that is mended."""

import json
from typing import Any

import numpy as np
import pytest

from eitskin_proto.skin.skin import PAPER
from eitskin_sim.evaluation.harness import Conditions, Run, evaluate_all, truth_map
from eitskin_sim.evaluation.metrics import score
from eitskin_sim.evaluation.trials import random
from eitskin_sim.scene.parts import Phantom, Scene
from eitskin_sim.verification.residual import Noise
from eitskin_sim.verification.snapped_units import UnitTouch, UnitVerdict, unit_shares
from eitskin_tools.cli import main
from eitskin_tools.evaluation.verified.solver import MapVerdict, VerifiedNetwork, add_verdicts


def checked(p: float, extra_ms: float, setup_ms: float = 0.0) -> MapVerdict:
    verdict = UnitVerdict((UnitTouch(3, 50.0),), 100.0, 104, p, 0.01, 5, 1e-3 * extra_ms)
    return MapVerdict(verdict, extra_ms, extra_ms, setup_ms)


def phantom(name: str) -> Phantom:
    return Phantom(name, Scene(), "units")


def test_a_report_says_of_each_phantom_how_sure_it_is_and_of_all_what_went_unseen() -> None:
    first, second = phantom("1"), phantom("2")
    empty, wrong = np.zeros(PAPER.grid.shape), np.ones(PAPER.grid.shape)
    right, off = (score(one, empty) for one in (empty, wrong))
    results = [(first, [right, right]), (second, [off, off])]
    verdicts = {
        id(first): [checked(0.4, 1.0, 500.0), checked(0.005, 3.0)],
        id(second): [checked(1e-9, 5.0, 700.0), checked(0.6, 7.0)],
    }
    found: dict[str, Any] = {"phantoms": [{"name": "1"}, {"name": "2"}]}
    add_verdicts(found, results, verdicts)
    assert found["phantoms"][0] == {
        "name": "1", "p_value": pytest.approx(0.2025), "flagged": 0.5, "extra_ms": 2.0,
        "touch_list": [{"unit": 3, "contrast": 50.0}],
    }  # fmt: skip
    assert found["phantoms"][1]["flagged"] == 0.5
    every = found["verified"]
    assert isinstance(every, dict)
    assert (every["wrong"], every["wrong_unflagged"], every["right_flagged"]) == (2, 1, 1)
    assert every["flagged"] == 0.5
    assert (every["extra_ms_median"], every["setup_ms_median"]) == (4.0, 600.0)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["bench", "verify", "--only", "nothing of it"], "expected a part of one of: 1 to 6 units, N1"),
        (["bench", "verify", "--each", "0"], "must be at least 1"),
        (["bench", "verify", "--sets", "-1"], "at least 0"),
    ],
)
def test_bad_options_of_the_benchmark_are_one_line(
    arguments: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 2
    assert says in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "status", "says"),
    [
        (["--single", "10", "--at-rest", "5"], 1, "--at-rest needs --solver verified"),
        (["--single", "10", "--cloud", "fitted", "--solver", "tikhonov"], 1, "--cloud fitted needs --solver verified"),
        (["--devices", "lab", "--solver", "verified", "--at-rest", "5"], 2, "--at-rest"),
    ],
)
def test_sheets_are_seen_at_rest_by_physics_alone(
    arguments: list[str], status: int, says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["evaluate", *arguments]) == status
    assert says in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.heavy
def test_a_network_with_the_shape_that_physics_finds_is_nearer_than_with_a_flat_cloud(
    capsys: pytest.CaptureFixture[str],
) -> None:
    drawn, rms = ["--single", "10", "--deformations", "3", "--each", "2", "--seed", "5", "--json"], []
    for cloud in ("fitted", "flat"):
        assert main(["evaluate", *drawn, "--cloud", cloud]) == 0
        rms.append(json.loads(capsys.readouterr().out)["localisation_rms_mm"])
    assert rms[0] < 0.8 * rms[1]


@pytest.mark.slow
@pytest.mark.heavy
def test_units_of_an_independent_mesh_are_explained_and_wrong_ones_flagged() -> None:
    """The network shows the first set as it is, and of the second all but one unit."""
    phantoms = random((2, 2), 1, 2, "A", "units")
    first, second = (unit_shares(truth_map(one).reshape(PAPER.grid.shape), PAPER.grid) for one in phantoms)
    second[np.flatnonzero(second)[0]] = 0.0
    images = iter([PAPER.grid.map_from_units(one) for one in (first, second)])
    verified = VerifiedNetwork(Run(lambda _: next(images), "pre"), Noise("N2"), "units", "raise", PAPER)
    (results,) = evaluate_all(phantoms, [verified.run], Conditions("N2"))
    (_, (right,)), (_, (wrong,)) = results
    said, of_wrong = (one.verdict for one in verified.checked)
    assert (right.exact, said.flagged) == (1.0, False)
    assert wrong.exact == 1.0 or (of_wrong.flagged and of_wrong.p_value < 1e-6)
