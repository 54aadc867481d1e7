"""``eitskin flash`` as a command, on the C core in memory and on the virtual skin's pseudo-terminal."""

import json
import signal
import subprocess
import sys

import pytest
from tests.emulator.device_core import HostDevice
from tests.emulator.firmware import missing_tools

from eitskin_proto.wire import config_toml, framing, messages
from eitskin_tools import cli
from eitskin_tools.commands import flash
from eitskin_tools.flash import procedure

FAST = config_toml.named("fast")


@pytest.fixture
def device(monkeypatch):
    missing = missing_tools("host")
    if missing:
        pytest.skip(f"the C core needs {', '.join(missing)}: apt-get install build-essential")
    made = HostDevice()
    made.run(1000)
    monkeypatch.setattr(flash, "open_line", lambda port, baud: made)
    return made


def run(capsys, *words):
    status = cli.main(["flash", *words])
    out, err = capsys.readouterr()
    return status, out, err


def report(capsys, *words):
    status, out, _ = run(capsys, *words, "--port", "host", "--json")
    return status, json.loads(out)


def test_show_write_verify_diff_and_rollback_tell_one_story(device, capsys):
    status, shown = report(capsys, "show")
    assert (status, shown["active"]["name"], shown["active"]["generation"], shown["other"]) == (0, "paper", 0, None)
    assert shown["flags"] == ["FACTORY"]
    assert report(capsys, "write", "full208")[0] == 0
    status, written = report(capsys, "write", "fast")
    assert (status, written["generation"], written["digest"]) == (0, 2, f"{FAST.digest:08x}")
    assert report(capsys, "verify", "fast") == (
        0,
        {"action": "verify", "differences": [], "configuration": "fast", "digest": f"{FAST.digest:08x}", "same": True},
    )
    status, compared = report(capsys, "diff", "full208")
    assert status == 1
    assert {"field": "rows", "device": 104, "file": 208} in compared["differences"]
    assert report(capsys, "rollback") == (0, {"action": "rollback", "configuration": "full208", "generation": 1})
    assert report(capsys, "show")[1]["active"]["name"] == "full208"


@pytest.mark.parametrize("step", procedure.STATE_AFTER)
def test_an_interrupted_write_says_what_the_device_is_left_with(device, capsys, monkeypatch, step):
    said = []

    def interrupted(line):
        said.append(line)
        if line == f"{step} ...":
            raise KeyboardInterrupt

    monkeypatch.setattr(flash, "note", interrupted)
    status, out, err = run(capsys, "write", "fast", "--port", "host")
    assert (status, out, err) == (130, "", "")
    assert procedure.STATE_AFTER[step] in said[-1]
    device.run(31_000_000, step_us=10_000)  # longer than a trial
    monkeypatch.undo()
    monkeypatch.setattr(flash, "open_line", lambda port, baud: device)
    assert report(capsys, "show")[1]["active"]["name"] == ("fast" if step == "done" else "paper")
    assert report(capsys, "write", "full208")[0] == 0, "and it can be flashed again"


def test_show_says_what_becomes_of_either_slot(device, capsys):
    def states():
        found = report(capsys, "show")[1]
        return found["active_state"], found["other_state"]

    def ask(request):
        device.write(framing.encode(request.pack()))
        device.run(1000)
        device.take()

    nothing = "nothing to go back to: empty, rolled back or not intact"
    assert states() == ("running, built in", nothing)
    assert report(capsys, "write", "full208")[0] == 0
    assert states() == ("running, confirmed", nothing)
    assert report(capsys, "write", "fast")[0] == 0
    assert states() == ("running, confirmed", "confirmed: a rollback returns to it")
    ask(messages.ConfigRollback(7, 2))
    assert states() == ("running, rolled back: the next boot runs the other", "confirmed: the next boot runs it")
    status, out, err = run(capsys, "write", "idle", "--port", "host")
    assert (status, out) == (1, "")
    assert "NOT_CONFIRMED: what runs is on trial or was rolled back; confirm it, or restart the device" in err
    device.run(10_000_000, step_us=10_000)  # until the lock expires
    assert report(capsys, "rollback") == (0, {"action": "rollback", "configuration": "full208", "generation": 1})
    assert states() == ("running, confirmed", nothing)
    paper = config_toml.named("paper")
    ask(
        messages.ConfigBegin(token=7, size=64, digest=paper.digest, hardware_id=paper.hardware_id, revision=1, format=1,
                             name="paper")
    )  # fmt: skip
    assert states() == ("running, confirmed", "being written")
    for at in (0, 32):
        ask(messages.ConfigWrite(7, at, paper.to_blob()[at : at + 32]))
    ask(messages.ConfigCommit(7, paper.digest))
    assert states() == ("running, confirmed", "not confirmed: the next boot tries it")
    device.boot()
    assert states() == ("running, on trial", "confirmed: a rollback returns to it")
    device.boot()
    assert states()[1] == "not confirmed: it failed its trial, or the next boot tries it"


def test_a_dry_run_changes_nothing_with_or_without_a_device(device, capsys):
    before = device.changes
    status, planned = report(capsys, "write", "fast", "--dry-run")
    assert (status, planned["dry_run"]) == (0, True)
    assert {"field": "sample_bytes", "device": 3, "file": 2} in planned["differences"]
    assert run(capsys, "write", "fast", "--dry-run")[0] == 0
    assert report(capsys, "rollback", "--dry-run")[0] == 0
    assert device.changes == before


def test_mistakes_are_status_1_with_one_line_and_the_device_as_it_was(device, capsys, tmp_path):
    text = config_toml.to_toml(FAST)
    cases = {
        "kilohertz": (
            text.replace("frequency_Hz = 50000", "frequency_kHz = 50"),
            "[drive] lacks frequency_Hz, expected a whole number",
        ),
        "rate": (text.replace("rate_Hz = 350.0", "rate_Hz = 580.0"), "a line of 92160 bytes/s reaches at most 354"),
        "front_end": (text.replace("rate_Hz = 350.0", "rate_Hz = 5000.0"), "reaches at most"),
        "hardware": (text.replace("eitskin-16", "eitskin-99"), "hardware 'eitskin-99' is unknown"),
        "downgrade": (
            config_toml.to_toml(config_toml.named("paper")).replace("revision = 1", "revision = 0"),
            "DOWNGRADE",
        ),
    }
    before = device.changes
    for name, (content, expected) in cases.items():
        file = tmp_path / f"{name}.toml"
        file.write_text(content)
        status, out, err = run(capsys, "write", str(file), "--port", "host")
        assert (status, out) == (1, "")
        assert expected in err
        assert len([line for line in err.splitlines() if line.startswith("eitskin flash:")]) == 1
    assert run(capsys, "write", str(tmp_path / "none.toml"), "--port", "host")[0] == 1
    assert run(capsys, "rollback", "--port", "host")[0] == 1
    assert device.changes == before
    status, out, _ = run(capsys, "write", str(tmp_path / "downgrade.toml"), "--port", "host", "--allow-downgrade")
    assert status == 0


@pytest.mark.process
def test_the_virtual_skin_is_flashed_over_its_pseudo_terminal(capsys):
    sim = subprocess.Popen(
        [sys.executable, "-m", "eitskin_tools.cli", "virtual-skin", "--noise=none"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        port = sim.stdout.readline().split()[-1]
        for words in (["write", "fast"], ["verify", "fast"]):
            status, out, err = run(capsys, *words, "--port", port, "--json")
            assert status == 0, err
        assert json.loads(out)["same"] is True
        status, out, err = run(capsys, "rollback", "--port", port, "--json")
        assert (status, "no earlier configuration" in err) == (1, True)
    finally:
        sim.send_signal(signal.SIGINT)  # it then removes its port's folder
        sim.communicate(timeout=120.0)
