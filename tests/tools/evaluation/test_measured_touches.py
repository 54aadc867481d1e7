"""Which way touches of a measured file go: as it says, else as its skin; a network without them is reported."""

import json
from dataclasses import replace

import numpy as np
import pytest

from eitskin_sim.evaluation import harness
from eitskin_sim.scene.parts import Phantom, Scene, Touch
from eitskin_sim.scene.shapes import Disc
from eitskin_tools import cli

PRESSED = Scene(touches=(Touch((Disc(90.0, 55.0, 8.0),), contrast=0.5),))


@pytest.fixture(scope="module")
def pressed():
    """One press; the file does not say which way touches go."""
    flat, touched = (harness.solve_scene(replace(one, element_size_mm=3.0)).voltages for one in (Scene(), PRESSED))
    truth = harness.truth_map(Phantom("", PRESSED, "area"))
    return {"reference_V": flat, "voltages_V": touched[None], "truth": truth[None]}


def evaluated(tmp_path, capsys, arrays, *words):
    """Return what was printed, and what was said on stderr."""
    np.savez(tmp_path / "m.npz", **arrays)
    assert cli.main(["evaluate", "--measured", str(tmp_path / "m.npz"), "--json", *words]) == 0
    out, said = capsys.readouterr()
    return json.loads(out), said


@pytest.mark.parametrize("solver", ["tikhonov", "vd2t"])
def test_a_file_that_does_not_say_is_of_the_touches_of_its_skin(tmp_path, capsys, pressed, solver):
    found, said = evaluated(tmp_path, capsys, pressed, "--skin", "hydrogel", "--solver", solver)
    same, _ = evaluated(tmp_path, capsys, {**pressed, "touch_kind": "lower"}, "--solver", solver)
    assert found["by_kind"] == same["by_kind"]
    assert found["by_kind"]["touched"]["missed"] == 0.0
    assert said == ""


def test_a_network_that_does_not_know_the_touches_is_told_of_in_one_line(tmp_path, capsys, pressed):
    said = [
        evaluated(tmp_path, capsys, {**pressed, **more}, "--bundle", *words)[1]
        for more, words in (
            ({"touch_kind": "lower"}, ("free",)),
            ({}, ("free", "--skin", "hydrogel")),
            ({"touch_kind": "lower"}, ("press",)),
            ({}, ("press",)),
            ({"touch_kind": "lower"}, ("free", "--solver", "tikhonov")),
        )
    ]
    assert said[0] == said[1]
    assert said[0].endswith("free.eitskin knows touches = raise, and is tried on touches = lower\n")
    assert said[0].count("\n") == 1
    assert said[2:] == ["", "", ""]
