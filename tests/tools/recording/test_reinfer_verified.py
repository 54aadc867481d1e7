"""The verified solver on recorded frames: what it is given, what is counted, and what the command says of it."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eitskin import WireFrame
from eitskin.model.bundle import L1_FILE, load_bundle
from eitskin_export.bundle import write as write_bundle
from eitskin_proto.files.arrays import pack_arrays
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.fem.jacobian import flat_jacobian
from eitskin_sim.solvers.whitened import l1_arrays
from eitskin_sim.verification.snapped_units import UnitVerdict
from eitskin_tools import cli
from eitskin_tools.evaluation.verified import recorded as module
from eitskin_tools.evaluation.verified.recorded import VerifiedSolver
from eitskin_tools.evaluation.verified.solver import MapVerdict
from eitskin_tools.evaluation.verified.untouched_baseline import BASELINE_FRAMES
from eitskin_tools.recording.reinfer import Rerun, reinfer, write
from eitskin_tools.recording.script import Script, Step

from . import conftest
from .conftest import CLOUD, TINY, measured, recorded


class Physics:
    """Stands for a verifier: explains every other frame, and leaves the map as it is."""

    def __init__(self, network: Any, *_: Any) -> None:
        self._network = network
        self.checked: list[Any] = []
        self.cases: list[Any] = []
        self.rested: list[tuple[Any, int]] = []

    def use_untouched(self, voltages_V: Any, frames: int) -> None:
        self.rested.append((voltages_V, frames))

    def solve(self, case: Any) -> Any:
        self.cases.append(case)
        p = 0.5 if len(self.cases) % 2 else 1e-9
        verdict = UnitVerdict((), 1.0, 104, p, 0.01, 1, 0.004)
        self.checked.append(MapVerdict(verdict, 4.0, 4.0, 100.0 * (len(self.cases) == 1)))
        return self._network.solver(case)


@pytest.fixture
def physics(monkeypatch: pytest.MonkeyPatch) -> list[Physics]:
    made: list[Physics] = []

    def make(*words: Any) -> Physics:
        made.append(Physics(*words))
        return made[-1]

    monkeypatch.setattr(
        VerifiedSolver, "_of", lambda self, reference: make(module.Run(lambda case: self._image, "pre"))
    )
    return made


def test_touched_frames_are_given_with_the_cloud_and_the_reference_that_held(
    physics: list[Physics], tmp_path: Path
) -> None:
    recorded(tmp_path / "a.mcap", measured(330, skip_unchanged=True))
    script, bundle = Script(tmp_path / "a.mcap"), load_bundle(TINY)
    found = reinfer(script, bundle, VerifiedSolver(script, bundle), keep=1000)
    fields = found.fields()
    touched = sum(step.frame.touched for step in script.steps())
    assert fields["against_recorded"]["touched_agreement"] == 1.0
    assert fields["verified"]["frames"] == touched == sum(len(one.cases) for one in physics) > 10
    assert fields["verified"]["flagged_share"] == pytest.approx(0.5, abs=0.1)
    assert fields["verified"]["ms_median"] == 4.0
    assert fields["verified"]["not_verified"] == {}
    before, behind = physics  # a cloud was given amid the touch
    ((at_rest_V, frames),) = before.rested
    assert frames == BASELINE_FRAMES
    assert at_rest_V == pytest.approx(before.cases[0].flat_reference, rel=5e-3)
    assert len(behind.rested) == 1, "once more, since the touch is gone"
    assert np.allclose(behind.cases[0].sheet.cloud_mm, CLOUD, atol=1e-3)
    assert not np.allclose(before.cases[0].sheet.cloud_mm, CLOUD, atol=1e-3)
    change = before.cases[0].voltages / before.cases[0].flat_reference - 1.0
    assert np.abs(change).max() == pytest.approx(0.3, abs=0.02)
    write(tmp_path / "maps.npz", found)
    with np.load(tmp_path / "maps.npz") as arrays:
        assert arrays["flagged"].dtype == np.bool_
        assert np.isnan(arrays["p_value"]).tolist() == (~arrays["touched"]).tolist()
        assert arrays["flagged"].sum() == round(fields["verified"]["flagged_share"] * touched)
        assert set(arrays) == {
            "seq", "touched", "solver", "wall_ns", "map", "recorded_map", "p_value", "flagged",
        }  # fmt: skip


def test_the_command_says_what_physics_says(
    file: Path, physics: list[Physics], capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["reinfer", str(file), "--bundle", str(TINY), "--solver", "verified", "--every", "5", "--quiet"]
    assert cli.main(words) == 0
    assert "flagged; p " in capsys.readouterr().out
    assert cli.main([*words, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["solver"] == "verified"
    assert found["other_bundle"] == found["bundle"]
    assert found["verified"]["frames"] == 10


def test_physics_starts_from_l1_where_a_bundle_has_no_network(
    file: Path, physics: list[Physics], tmp_path: Path
) -> None:
    operators = l1_arrays(np.eye(104), flat_jacobian(PAPER), "raise")
    files = {L1_FILE: pack_arrays(operators), "gate.npz": load_bundle(TINY).files["gate.npz"]}
    facts = {"labels": "area", "touches": "raise", "gate": {}, "metrics": {}}
    write_bundle(tmp_path / "p.eitskin", files, facts, PAPER)
    script, bundle = Script(file), load_bundle(tmp_path / "p.eitskin")
    assert reinfer(script, bundle, VerifiedSolver(script, bundle)).fields()["verified"]["frames"] > 10


@pytest.mark.slow
@pytest.mark.heavy
def test_the_real_verifier_explains_a_touch_of_a_real_sheet(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from eitskin_sim.verification.network_map import map_of
    from eitskin_sim.verification.sheet_model import model_of_cloud

    piece = np.array([[0, 60.0, 45.0, 12.0, 10.0, 0.0, 50.0, 0.0]])
    change = model_of_cloud(CLOUD).solve(piece)[1]

    def scans(frames: int) -> list[Step]:
        rng, found = np.random.default_rng(3), []
        for index in range(frames):
            read = conftest.counts() * (1.0 + change * (index == frames - 1)) * (1 + 1e-4 * rng.standard_normal(104))
            payload = conftest.WireScan(100 + index, 1000 + 5000 * index, np.rint(read).astype(np.int32)).pack()
            found.append(Step(WireFrame(payload, 100 + index, index * 5_000_000), 10**9 + index * 5_000_000))
        return found

    monkeypatch.setattr(conftest, "scans", scans)
    recorded(tmp_path / "a.mcap", measured(6))
    image = map_of(piece).astype(np.float32)
    monkeypatch.setattr(Rerun, "_map", lambda self: image)
    script, bundle = Script(tmp_path / "a.mcap"), load_bundle(TINY)
    found = reinfer(script, bundle, VerifiedSolver(script, bundle), keep=10)
    fields = found.fields()["verified"]
    assert (fields["frames"], fields["flagged_share"], fields["not_verified"]) == (1, 0.0, {})
    assert fields["p_value_median"] > 1e-3
    assert fields["ms_median"] > 0
    assert np.corrcoef(found.kept[-1][1].map.ravel(), image.ravel())[0, 1] > 0.95
