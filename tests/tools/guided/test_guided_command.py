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

from eitskin.acquisition.device import Device
from eitskin.acquisition.serial_port import SerialPort
from eitskin_proto.sensor.table import FULL_TABLE, N_FULL_ROWS, N_ROWS
from eitskin_proto.skin.cloud_file import Surface, save_surface
from eitskin_proto.skin.parts import Touches
from eitskin_proto.skin.quantity import Quantity
from eitskin_proto.skin.skin import PAPER
from eitskin_proto.skin.toml import load, to_toml
from eitskin_sim.calibration import solved
from eitskin_sim.devices.readings import responses_of
from eitskin_sim.fem.solve import factorise_scene
from eitskin_sim.measurement.front_end import FrontEnd
from eitskin_sim.scene.parts import Bend, Scene, Touch
from eitskin_sim.scene.shapes import Disc
from eitskin_sim.surface.measured_cloud import measured_cloud

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
    assert "the device scans 104 rows: --full-scan would tell more of its front end" in said
    assert "a press: contrast 0." in said
    low, high = load(out).touches.lowering_contrast
    assert low < CONTRAST < high
    with np.load(tmp_path / "r.npz") as recorded:
        assert recorded["press_xy_mm"].tolist() == [[75.0, 50.0]]
        assert str(recorded["skin_digest"]) == STATED.digest
        assert "bent_V" not in recorded


@pytest.mark.process
@pytest.mark.slow  # two processes, and bends that are drawn for the scan
def test_a_sheet_that_never_lay_flat_is_scanned_in_full_and_its_gain_found(tmp_path):
    stated = replace(STATED, front_end=replace(STATED.front_end, gain=Quantity(1.0, "normal", 0.01)))
    (tmp_path / "ours.toml").write_text(to_toml(stated))
    rng = np.random.default_rng(8)
    gain = 1.0 + 0.01 * rng.standard_normal(16)
    bend = Bend(angle_deg=50.0, stretch_along=1.03, nonuniformity=0.01)
    save_surface(tmp_path / "lies.npz", Surface(measured_cloud(bend, rng).astype(np.float64)), None, stated)
    scene = Scene(bend=bend, element_size_mm=2.3)  # elements that no fit uses
    read = FrontEnd(gain=tuple(gain)).read(responses_of(factorise_scene(scene).differences()), FULL_TABLE)
    words = [str(tmp_path / "r.npz"), "--guided", "--full-scan", "--surface", str(tmp_path / "lies.npz")]
    words += ["--skin", str(tmp_path / "ours.toml"), "--bends", "0", "--out", str(tmp_path / "calibrated.toml")]
    with served(tmp_path, {"flat": (3e-5 * read).tolist()}) as port:
        said = guided([*words, "--port", port], {})
        line = SerialPort(port)
        try:
            assert Device(line).hello.rows == N_ROWS, "it scans what it scanned before"
        finally:
            line.close()
    assert "Leave the sheet as it was scanned" in said
    assert "reference: mean of 100 frames of 208 rows" in said
    assert "the device scans 104 rows again, as paper says" in said
    assert "reference: as it was scanned; what the scan does not show moves its rows" in said
    with np.load(tmp_path / "r.npz") as recorded:
        assert recorded["reference_V"].shape == (N_FULL_ROWS,)
        assert recorded["reference_cloud_mm"].shape == stated.grid.cloud_shape
    found = load(tmp_path / "calibrated.toml").front_end.gain
    assert found.spread < 0.004
    score = (np.array(found.value) - gain) / found.spread
    assert np.sum(score**2) < 45.9  # chi-square of 16: 1 in 10,000


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
