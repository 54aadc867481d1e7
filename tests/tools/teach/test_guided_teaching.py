"""``eitskin teach --port`` on a terminal, with a virtual skin that is pressed where it is asked for."""

import json
import os
import pty
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from eitskin_sim.calibration import solved
from eitskin_sim.fem.solve import factorise_scene
from eitskin_sim.scene.parts import Scene, Touch
from eitskin_sim.scene.shapes import Disc
from eitskin_tools.teach.places import grid_places

PLACES = grid_places((150.0, 100.0), "rectangle", 12)
SKIN = Path(__file__).parents[1] / "guided" / "pressed_skin.py"


def volts(touches=()):
    return (3e-5 * factorise_scene(Scene(touches=touches, element_size_mm=solved.ELEMENT_MM)).voltages()).tolist()


def write(path, text):
    """Replace a file that is read all the while."""
    fresh = path.with_suffix(".new")
    fresh.write_text(text)
    fresh.replace(path)


def follow(terminal, press, release):
    """Press and let go as it is asked for, to the end; return what was said."""
    said, seen = "", 0
    while True:
        try:
            more = os.read(terminal, 4096)
        except OSError:  # the other side is gone
            return said
        said += more.decode(errors="replace")
        for found in re.finditer(r"press (\w\d+) \(|Let go", said[seen:]):
            press(found[1]) if found[1] else release()
        seen = max(said.rfind("\n"), seen)


@pytest.mark.process
@pytest.mark.slow  # two processes, twelve presses of a second
def test_a_sheet_is_pressed_where_it_is_asked_and_taught(tmp_path):
    state, file, out = tmp_path / "state", tmp_path / "presses.npz", tmp_path / "mine.eitskin"
    write(state, "flat")
    discs = {p.name: volts((Touch((Disc(p.x_mm, p.y_mm, 9.0),), contrast=0.4, border_mm=4.0),)) for p in PLACES}
    options = json.dumps({"state": str(state), "volts": {"flat": volts(), **discs}})
    skin = subprocess.Popen([sys.executable, str(SKIN), options], stdout=subprocess.PIPE)
    ours, theirs = pty.openpty()
    try:
        port = skin.stdout.readline().decode().strip()
        words = ["teach", str(file), "--out", str(out), "--port", port, "--presses", "12", "--frames", "10"]
        command = subprocess.Popen(
            [sys.executable, "-m", "eitskin_tools.cli", *words], stdin=theirs, stdout=theirs, stderr=subprocess.PIPE
        )
        os.close(theirs)
        said = follow(ours, lambda name: write(state, name), lambda: write(state, "flat"))
        error = command.communicate()[1].decode()
    finally:
        skin.terminate()
        skin.wait()
        skin.stdout.close()
        os.close(ours)
    assert command.returncode == 0, said + error
    assert "12 of 12: felt" in said
    assert out.exists()
    with np.load(file) as recorded:
        assert recorded["xy_mm"][1::2].tolist() == [[one.x_mm, one.y_mm] for one in PLACES]
        assert recorded["table"].shape == (104, 4)
        found = np.log(recorded["voltages_V"][1::2] / recorded["voltages_V"][::2])
    expected = np.array([np.log(np.divide(discs[one.name], volts())) for one in PLACES])
    assert np.abs(found - expected).max() < 6.0 * 0.003 * np.sqrt(2 / 10)


def test_the_grid_is_written_at_its_true_size(tmp_path, capsys):
    from eitskin_tools import cli

    grid = tmp_path / "grid.svg"
    assert cli.main(["teach", "p.npz", "--out", str(tmp_path / "b.eitskin"), "--grid", str(grid)]) == 0
    assert "places on 150 x 100 mm. Print it at 100 %" in capsys.readouterr().out
    text = grid.read_text()
    assert 'width="152mm" height="102mm" viewBox="-1 -1 152 102"' in text
    assert text.count("<text") == len(grid_places((150.0, 100.0), "rectangle", 60))
