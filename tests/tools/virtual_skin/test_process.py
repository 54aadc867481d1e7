"""``eitskin virtual-skin`` as a process: it says where it is, serves, and leaves nothing behind."""

import json
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import serial

from eitskin_proto.wire import messages as m
from eitskin_proto.wire.framing import Deframer, encode
from eitskin_tools import cli
from eitskin_tools.processes.signals import met_by
from eitskin_tools.processes.skin_log import read_log, script_start
from eitskin_tools.scripted_scene.script import demonstration, prepare

pytestmark = pytest.mark.process

COMMAND = [sys.executable, "-m", "eitskin_tools.cli", "virtual-skin"]


@contextmanager
def sim(*arguments):
    process = subprocess.Popen([*COMMAND, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        process.send_signal(signal.SIGINT)  # it then takes its port's folder along
        try:
            process.communicate(timeout=60)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()


def stream(port, frames):
    """Shake hands, take some frames, stop; who reads too late misses some, as of a device, and takes later ones."""
    found = []
    with serial.Serial(port, timeout=30.0, exclusive=True) as line:
        deframer = Deframer()
        line.write(b"\0" + encode(m.HelloRequest(1).pack()) + encode(m.Start(2).pack()))
        while sum(isinstance(message, m.Frame) for message in found) < frames:
            data = line.read(max(1, line.in_waiting))
            assert data, "the virtual skin fell silent"
            found += [m.unpack(payload) for payload in deframer.feed(data)]
    (hello,) = (message for message in found if isinstance(message, m.Hello))  # a starved skin sends an event before it
    return hello, [message for message in found if isinstance(message, m.Frame)]


def test_it_prints_its_port_first_and_streams_the_script(tmp_path):
    log, wire = tmp_path / "log", tmp_path / "wire.npy"
    with sim("--noise=none", f"--log={log}", f"--wire-times={wire}") as process:
        port = process.stdout.readline().strip()
        assert Path(port).is_symlink()
        hello, frames = stream(port, 50)
        process.send_signal(signal.SIGINT)
        assert process.wait(60.0) == 0
        assert not Path(port).parent.exists()
    script = demonstration()
    solved = prepare(script, script.period_s)
    start_us = script_start(log)["device_us"]
    for frame in frames[::7]:
        expected = script.voltages_at((frame.device_us - start_us) * 1e-6, solved)
        # flat and untouched: the only difference is half a count
        assert np.abs(frame.counts * hello.volts_per_count - expected).max() <= 0.5001 * hello.volts_per_count
    written = np.load(wire)
    sequence = np.array([frame.sequence for frame in frames])  # a starved skin skips scans that are long overdue
    assert (written[sequence] > 0).all()
    before = np.setdiff1d(np.arange(sequence[-1]), sequence)  # what comes behind may be written before the line closes
    assert not written[before].any()
    assert (np.diff(written[sequence]) > 0).all()
    assert [event["event"] for event in read_log(log)] == ["boot", "start", "stop"]


@pytest.mark.parametrize("number", [signal.SIGTERM, pytest.param(signal.SIGHUP, marks=pytest.mark.slow)])
def test_json_is_one_object_and_it_ends_cleanly_when_told_to(number):
    with met_by(signal.SIG_DFL, signal.SIGHUP), sim("--json", "--rate=100", "--serial-number=SKIN-7") as process:
        found = json.loads(process.stdout.readline())
        assert (found["rate_hz"], found["serial_number"]) == (100.0, "SKIN-7")
        before = time.perf_counter_ns()
        assert 0 < before - found["clock_epoch_ns"] < 60e9, "the epoch is on this machine's perf_counter"
        hello, frames = stream(found["port"], 3)
        assert hello.rate_mHz == 100_000
        after = time.perf_counter_ns()
        assert before < frames[0].device_us * 1000 + found["clock_epoch_ns"] < after
        process.send_signal(number)
        assert process.wait(60.0) == 0
        assert process.stdout.read() == ""
        assert not Path(found["port"]).parent.exists()


def test_a_scene_is_held_after_the_reference_phase(tmp_path):
    scene = tmp_path / "scene.json"
    scene.write_text('{"touches": [{"rect_mm": [60, 40, 80, 60]}], "element_size_mm": 6}')
    with sim("--json", "--rate=100", "--noise=none", f"--scene={scene}") as process:
        port = json.loads(process.stdout.readline())["port"]
        _, frames = stream(port, 200)
    counts = np.array([frame.counts for frame in frames], dtype=np.float64)
    change = np.sqrt(np.mean((counts / counts[0] - 1.0) ** 2, axis=1))
    since_s = 1e-6 * np.array([frame.device_us - frames[0].device_us for frame in frames])  # scans may be skipped
    assert change[since_s < 1.75].max() < 1e-4
    assert change[since_s > 1.85].min() > 0.01


@pytest.mark.parametrize(("option", "words"), [("--rate=50000", "2272"), ("--config=nowhere.toml", "nowhere.toml")])
def test_what_cannot_be_is_one_line(option, words, capsys):
    assert cli.main(["virtual-skin", option]) == 1
    out, error = capsys.readouterr()
    assert (out, error.count("\n")) == ("", 1)
    assert words in error
