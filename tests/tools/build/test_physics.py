import json
import subprocess
import sys

import numpy as np
import pytest

import eitskin
from eitskin_proto.skin.toml import parse
from eitskin_sim.scene.parts import Bend
from eitskin_sim.tank.round_sheet import RoundSheet

pytestmark = [pytest.mark.slow, pytest.mark.heavy, pytest.mark.process]

ROUND = f"""
format = "eitskin-skin"
version = 1
name = "round"
outline = {{kind = "disc", size_mm = [100.0, 100.0]}}
electrodes = {{contact = "edge", size_mm = 5.0, arc_length_mm = {[round(19.634954 * k, 6) for k in range(16)]}}}
map = {{shape = [30, 30], units = [9, 9]}}
touches = {{kind = "lower", size_mm = [10.0, 18.0]}}
"""

BUILD = """
import sys
sys.modules["torch"] = None
from pathlib import Path
from eitskin_proto.skin.toml import load
from eitskin_tools.build.physics import build
if __name__ == "__main__":
    import json
    bends = {"learn": 14, "choose": 6, "measure": 2}
    print(json.dumps(build(load(sys.argv[1]), Path(sys.argv[2]), 1, bends=bends)))
"""
"""A few bends: enough to find touches, too few for a gate without false alarms."""


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Return the bundle of a round skin, and what its build printed, made by a process that has no torch."""
    folder = tmp_path_factory.mktemp("physics")
    (folder / "round.toml").write_text(ROUND)
    (folder / "build.py").write_text(BUILD)
    out = folder / "round.eitskin"
    command = [sys.executable, str(folder / "build.py"), str(folder / "round.toml"), str(out)]
    done = subprocess.run(command, check=True, capture_output=True, text=True, timeout=1200)
    return out, json.loads(done.stdout)


def test_a_touch_on_a_bent_disc_is_where_it_is_without_a_cloud(built):
    sheet, rng = RoundSheet(parse(ROUND), element_mm=2.0), np.random.default_rng(1)
    reference, centres = sheet.voltages(), sheet.skin.grid.pixel_centres_mm()
    for bend in (None, Bend(angle_deg=90.0, stretch_along=1.05)):
        for x, y in ((30.0, 60.0), (75.0, 35.0)):
            volts = sheet.voltages(bend, [(x, y, 7.0, 0.4)]) * (1 + 10**-2.5 * rng.standard_normal(104))
            found = eitskin.reconstruct(volts, reference, built[0])
            assert found.solver == "l1"
            assert found.touched.all()
            high = np.where(found.map[0] > 0.5, found.map[0], 0.0)
            place = (high[..., None] * centres).sum(axis=(0, 1)) / high.sum()
            assert np.linalg.norm(place - (x, y)) < 5.0
            assert not found.map[0].ravel()[~sheet.inside].any()


def test_evaluation_takes_its_best_solver_and_says_what_it_has(built, tmp_path, capsys):
    from eitskin_tools.cli import main

    sheet = RoundSheet(parse(ROUND), element_mm=2.0)
    reference, size = sheet.voltages(), 14.0
    touched = np.array([sheet.voltages(None, [(x, 50.0, size / 2, 0.4)]) for x in (30.0, 70.0)])
    volts = np.concatenate([touched, np.tile(reference, (10, 1))])
    volts *= 1.0 + 10**-2.5 * np.random.default_rng(3).standard_normal(volts.shape)
    kinds = np.array(["press"] * 2 + ["untouched"] * 10)
    np.savez(tmp_path / "m.npz", reference_V=reference, voltages_V=volts, kind=kinds)
    (tmp_path / "round.toml").write_text(ROUND)
    command = ["evaluate", "--measured", str(tmp_path / "m.npz"), "--skin", str(tmp_path / "round.toml")]
    assert main([*command, "--bundle", str(built[0]), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["solver"] == "l1"
    assert [one["touched"] for one in found["samples"][:2]] == [True, True]
    assert main([*command, "--bundle", str(built[0]), "--solver", "vd2t"]) == 1
    assert "holds no network 'vd2t'; it has l1, tikhonov" in capsys.readouterr().err


def test_the_card_says_how_well_both_solvers_and_the_gate_do(built):
    card = built[1]["card"]
    assert list(card["solvers"]) == ["l1", "tikhonov"]
    assert card["solvers"]["l1"]["cc"] > 0.5
    assert eitskin.load_bundle(built[0]).manifest["metrics"]["card"] == card
    assert set(card["gate"]) == {"false_alarm_rate", "missed_rate", "felt_mm"}


@pytest.mark.parametrize("option", [["--hours", "2"], ["--work", "folder"], ["--threads", "1"]])
def test_options_of_training_are_refused(option, tmp_path, capsys):
    from eitskin_tools.cli import main

    assert main(["build", "paper", "--physics", "--out", str(tmp_path / "x.eitskin"), *option]) == 2
    assert f"{option[0]} does nothing with --physics" in capsys.readouterr().err
