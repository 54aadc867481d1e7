"""``eitskin evaluate --tank``: a tank of our own, as the measured one's file is."""

import json
from dataclasses import replace

import numpy as np
import pytest
from tests.sim.tank import simulated_tank as tank

from eitskin_proto.skin.parts import Outline, Ring
from eitskin_proto.skin.quantity import Quantity
from eitskin_proto.skin.skin import PAPER
from eitskin_proto.skin.toml import to_toml
from eitskin_tools import cli

SETS = [[(4, "plastic"), (12, "metal")], [(9, "metal")]]


@pytest.fixture(scope="module")
def frames():
    return dict(tank.frame(objects, seed) for seed, objects in enumerate(SETS))


def test_objects_are_found_and_counted(tmp_path, frames, capsys):
    np.savez(tmp_path / "tank.npz", **frames, saline=next(iter(frames.values())))
    assert cli.main(["evaluate", "--tank", str(tmp_path / "tank.npz"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["objects"], found["right"], found["ghosts"]) == (3, 3, 0)
    assert found["angle_error_deg"]["worst"] < 11.25
    assert found["solver"] == "l1"
    assert found["wiring"].startswith("the rows are in order")
    first, _, unnamed = found["frames"]
    assert [one["electrode"] for one in first["objects"]] == [4, 12]
    assert first["offset_V"] == pytest.approx([tank.OFFSET_V.real, tank.OFFSET_V.imag], abs=1e-3)
    assert unnamed["objects"] == []
    assert {one["material"] for one in unnamed["found"]} == {"metal", "plastic"}


def test_rows_off_by_one_are_named_before_any_object(tmp_path, frames, capsys):
    np.savez(tmp_path / "tank.npz", **{name: np.roll(array, 1, axis=0) for name, array in frames.items()})
    assert cli.main(["evaluate", "--tank", str(tmp_path / "tank.npz")]) == 0
    assert capsys.readouterr().out.startswith("wiring: the rows are not in the stated order: readings come 1 row late")


@pytest.mark.parametrize(
    "solver", ["tikhonov", *(pytest.param(name, marks=pytest.mark.slow) for name in ("l1", "sbl"))]
)
def test_every_solver_finds_either_sign_and_common_drift_changes_nothing(tmp_path, capsys, solver):
    arrays = {}
    for common in (0.0, 0.02):
        arrays |= {f"{common}_{name}": array for name, array in (tank.frame(objects, 0, common) for objects in SETS)}
    np.savez(tmp_path / "tank.npz", **arrays)
    assert cli.main(["evaluate", "--tank", str(tmp_path / "tank.npz"), "--solver", solver, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["solver"], found["objects"], found["right"], found["ghosts"]) == (solver, 6, 6, 0)
    sectors = [[round(one["angle_deg"] / 22.5) for one in row["found"]] for row in found["frames"]]
    assert sectors[:2] == sectors[2:]


def test_what_is_no_tank_is_one_line(tmp_path, capsys):
    np.savez(tmp_path / "tank.npz", electrode01_metal=np.zeros((3, 4)))
    assert cli.main(["evaluate", "--tank", str(tmp_path / "tank.npz")]) == 1
    assert capsys.readouterr().err.count("\n") == 1
    assert cli.main(["evaluate", "--tank", str(tmp_path / "none.npz")]) == 1
    assert "no file" in capsys.readouterr().err


def test_a_skin_tells_the_electrodes_widths_and_must_be_a_disc(tmp_path, frames, capsys):
    np.savez(tmp_path / "tank.npz", **frames)
    around = np.pi * 60.0 / 16.0 * np.arange(16)
    skin = replace(
        PAPER,
        name="tank",
        outline=Outline("disc", (60.0, 60.0)),
        electrodes=Ring(arc_length_mm=Quantity(tuple(around.tolist())), size_mm=Quantity(4.0, "normal", 1.2)),
    )
    (tmp_path / "tank.toml").write_text(to_toml(skin))
    words = ["evaluate", "--tank", str(tmp_path / "tank.npz"), "--skin"]
    assert cli.main([*words, str(tmp_path / "tank.toml"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["right"] == found["objects"] == 3
    assert np.rad2deg(2.0 / 30.0) - 1e-6 <= found["electrode_width_deg"] <= np.rad2deg(6.0 / 30.0) + 1e-6
    assert cli.main([*words, "lab"]) == 1
    assert "[outline] kind is 'rectangle', expected 'disc'" in capsys.readouterr().err
    (tmp_path / "tank.toml").write_text(
        to_toml(
            replace(skin, electrodes=replace(skin.electrodes, size_mm=Quantity(tuple((4.0 + around / 600).tolist()))))
        )
    )
    assert cli.main([*words, str(tmp_path / "tank.toml")]) == 1
    assert "all of one size_mm" in capsys.readouterr().err
