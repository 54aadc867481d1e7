"""A press says which way touches go, whatever the sheet has drifted by."""

import json

import numpy as np
import pytest

from eitskin_proto.sensor.table import TABLE
from eitskin_proto.skin.skin import PAPER
from eitskin_proto.skin.toml import load, to_toml
from eitskin_sim.calibration.way import PressError, press_way
from eitskin_sim.devices.readings import responses_of
from eitskin_sim.fem.solve import factorise_scene
from eitskin_sim.measurement.front_end import FrontEnd
from eitskin_sim.scene.parts import Scene, Sheet, Touch
from eitskin_sim.scene.shapes import Disc
from eitskin_tools.cli import main

PLACE = (105.0, 65.0)


def frames(contrast=None, factor=1.0, seed=0):
    touches = () if contrast is None else (Touch((Disc(*PLACE, 8.0),), contrast=contrast, border_mm=3.0),)
    scene = Scene(Sheet(), touches=touches, element_size_mm=6.0)
    volts = factor * FrontEnd().read(responses_of(factorise_scene(scene).differences()), TABLE)
    return volts * (1.0 + 3e-3 * np.random.default_rng(seed).standard_normal((40, 104)))


@pytest.mark.parametrize(("contrast", "kind"), [(0.5, "lower"), (3.0, "raise")])
def test_a_press_says_which_way_touches_go_and_where_it_is(contrast, kind):
    found = press_way(frames(), frames(contrast, 1.004, 1), PAPER)
    assert found.kind == kind
    assert np.hypot(*np.subtract(found.xy_mm, PLACE)) < 8.0


def test_drift_alone_is_no_press():
    with pytest.raises(PressError, match="the press is not felt"):
        press_way(frames(), frames(None, 1.003, 1), PAPER)


def test_doctor_writes_the_way_into_the_skin_s_file(tmp_path, capsys):
    np.save(tmp_path / "press.npy", np.concatenate([frames(), frames(0.5, 1.0, 1)]))
    (tmp_path / "ours.toml").write_text(to_toml(PAPER))
    words = ["doctor", "--touch", "--recorded", str(tmp_path / "press.npy")]
    assert main(words) == 0
    assert 'kind = "lower"' in capsys.readouterr().out
    out = tmp_path / "known.toml"
    assert main([*words, "--skin", str(tmp_path / "ours.toml"), "--out", str(out), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["kind"] == "lower"
    assert load(out).touches.kind == "lower"
    assert main([*words, "--out", str(out)]) == 2
    assert "--out needs --skin FILE" in capsys.readouterr().err
    assert main(["doctor", "--out", str(out)]) == 2
