"""``eitskin calibrate --guided`` on a terminal, with a virtual skin that is pressed when it is asked for."""

import json
import os
import pty
import subprocess
import sys
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from eitskin_proto.skin.parts import Touches
from eitskin_proto.skin.skin import PAPER
from eitskin_proto.skin.toml import load, to_toml
from eitskin_sim.calibration import solved
from eitskin_sim.fem.solve import factorise_scene
from eitskin_sim.scene.parts import Scene, Touch
from eitskin_sim.scene.shapes import Disc

CONTRAST = 0.4
STATED = replace(
    PAPER,
    name="ours",
    touches=Touches(kind="lower", border_mm=(0.0, 8.0)),
    front_end=replace(PAPER.front_end, snr_db=(50.0, 50.0)),
)


def volts(touches=()):
    scene = Scene(touches=touches, element_size_mm=solved.ELEMENT_MM)
    return (3e-5 * factorise_scene(scene).voltages()).tolist()


@contextmanager
def served(tmp_path, volts):
    """Yield the port of a skin that reads as the file ``state`` says."""
    state = tmp_path / "state"
    state.write_text("flat")
    options = json.dumps({"state": str(state), "volts": volts})
    words = [sys.executable, str(Path(__file__).parent / "pressed_skin.py"), options]
    skin = subprocess.Popen(words, stdout=subprocess.PIPE)
    try:
        yield skin.stdout.readline().decode().strip()
    finally:
        skin.terminate()
        skin.wait()
        skin.stdout.close()


def guided(words, answers):
    """Run a command on a terminal, and return what it said; ``answers`` take the terminal."""
    ours, theirs = pty.openpty()
    try:
        command = subprocess.Popen(
            [sys.executable, "-m", "eitskin_tools.cli", "calibrate", *words],
            stdin=theirs, stdout=theirs, stderr=subprocess.PIPE, text=False,
        )  # fmt: skip
        os.close(theirs)
        said = follow(ours, {text: (lambda answer=answer: answer(ours)) for text, answer in answers.items()})
        error = command.communicate()[1].decode()
        assert command.returncode == 0, said + error
        return said
    finally:
        os.close(ours)


@pytest.mark.process
@pytest.mark.slow  # two processes, and a press that is fitted on the usual mesh
def test_a_press_is_asked_for_seen_and_fitted(tmp_path):
    disc = Touch((Disc(75.0, 50.0, 8.0),), contrast=CONTRAST, border_mm=4.0)
    (tmp_path / "ours.toml").write_text(to_toml(STATED))
    out, state = tmp_path / "calibrated.toml", tmp_path / "state"
    with served(tmp_path, {"flat": volts(), "pressed": volts((disc,))}) as port:
        words = [str(tmp_path / "r.npz"), "--guided", "--port", port, "--out", str(out)]
        words += ["--skin", str(tmp_path / "ours.toml"), "--bends", "1", "--presses", "1", "--stamp", "16"]
        said = guided(words, {
            "bend the sheet": lambda terminal: os.write(terminal, b"s\n"),
            "press the disc of 16 mm at (75, 50)": lambda _: write(state, "pressed"),
            "Let go": lambda _: write(state, "flat"),
        })  # fmt: skip
    assert "the device scans 104 rows: a configuration of 208 would find more about its front end" in said
    assert "A press: contrast 0." in said
    low, high = load(out).touches.lowering_contrast
    assert low < CONTRAST < high
    with np.load(tmp_path / "r.npz") as recorded:
        assert recorded["press_xy_mm"].tolist() == [[75.0, 50.0]]
        assert str(recorded["skin_digest"]) == STATED.digest
        assert "bent_V" not in recorded


def write(path, text):
    """Replace a file that is read all the while."""
    fresh = path.with_suffix(".new")
    fresh.write_text(text)
    fresh.replace(path)


def follow(terminal, answers):
    """Read a terminal to its end, doing each thing once it is asked for; return what was said."""
    said = ""
    left = dict(answers)
    while True:
        try:
            more = os.read(terminal, 4096)
        except OSError:  # the other side is gone
            return said
        if not more:
            return said
        said += more.decode(errors="replace")
        for text in [one for one in left if one in said]:
            left.pop(text)()
