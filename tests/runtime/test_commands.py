"""The commands as a user starts them: exit status, one line on stderr, one object on stdout."""

import json
import os
import re
import signal
import time
from dataclasses import replace
from functools import partial

import pytest

import eitskin
from eitskin.reference.captured import load
from eitskin_proto.skin.parts import Outline
from eitskin_proto.skin.skin import PAPER
from eitskin_proto.skin.toml import to_toml

from .command_line import command, finished, wait_until_ready
from .made_up_skin import begin_touches

pytestmark = pytest.mark.process


def test_run_publishes_reports_what_it_got_and_ends_cleanly_when_told_to(virtual_skin, tiny_path, tmp_path, endpoints):
    with virtual_skin(touches=[[0.6, 60, 0.3]], touches_wait=True) as port:
        words = ["--bundle", tiny_path, "--reference-frames", 20, *endpoints, "--json"]
        process = command("run", "--port", port, *words)
        report = wait_until_ready(process)
        begin_touches(port)
        for found in ("open, exclusive", "low-latency mode", "VIRTUAL-0001", "gate: false-alarm rate", "median spread"):
            assert found in report
        with eitskin.subscribe(f"ipc://{tmp_path}/frames", mode="all", timeout_s=60) as frames:
            taken = [next(frames) for _ in range(60)]
            while not taken[-1].touched and len(taken) < 10_000:
                taken.append(next(frames))
        assert taken[-1].touched
        assert min(frame.latency_s for frame in taken) < 1.0
        process.terminate()
        out, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    assert out.count("\n") == 1
    summary = json.loads(out)
    assert summary["frames"] >= 60
    assert summary["withheld"] == summary["withheld_by_reason"]["stale"]  # those that came before it published
    assert set(summary["latency_us"]) == {"p50", "p99", "p999", "max"}
    assert set(summary["stages_us"]) == {"decode", "normalise", "gate", "infer", "pack", "publish"}
    assert not (tmp_path / "frames").exists()
    assert not (tmp_path / "control").exists()


def test_run_ends_after_a_number_of_frames_and_uses_a_stored_reference(virtual_skin, tiny_path, tmp_path, endpoints):
    stored = tmp_path / "skin.json"
    with virtual_skin() as port:
        code, out, err = finished(
            "reference", "--port", port, "--out", stored, "--bundle", tiny_path, "--frames", 30, "--json"
        )
        assert code == 0, err
        assert json.loads(out)["frames"] == load(stored).frames == 30
        code, out, err = finished(
            "run", "--port", port, "--bundle", tiny_path, "--reference", stored, "--frames", 50, *endpoints, "--json"
        )
        assert code == 0, err
        assert json.loads(out)["frames"] == 50
        assert "capturing" not in err
    code, out, _ = finished("reference", "--show", stored)
    assert code == 0
    assert "30 frames of VIRTUAL-0001" in out


def test_what_run_says_is_json_where_it_is_asked_to_and_nearly_nothing_where_quiet(
    virtual_skin, tiny_path, tmp_path, endpoints
):
    words = ["--bundle", tiny_path, "--frames", 300, "--reference-frames", 20, *endpoints]
    with virtual_skin(faults=["drop@1.2/0.4"]) as port:
        code, _, err = finished("run", "--port", port, *words, "--log-format", "json")
        assert code == 0, err
        found = [json.loads(line) for line in err.splitlines()]
        events = [one["event"] for one in found]
        assert events.count("ready") == 1
        statuses = [one for one in found if one["event"] == "status"]
        assert statuses[-1]["lost"] > 0
        assert {"rate_hz", "touched", "corrupt", "withheld_by_reason", "electrodes"} <= set(statuses[-1])
        code, out, err = finished("run", "--port", port, *words, "--quiet", "--json")
        assert (code, err.splitlines()[0].split()[0], len(err.splitlines())) == (0, "ready", 1)
        assert json.loads(out)["frames"] == 300
    code, _, err = finished("run", "--port", "/dev/ttyNONE9", "--bundle", tiny_path, "--log-format", "json")
    assert code == 1
    assert json.loads(err.splitlines()[-1])["event"] == "error"


def test_subscribe_prints_frames_and_one_object(virtual_skin, running, tmp_path):
    with virtual_skin(touches=[[0.2, 60, 0.3]], touches_wait=True) as port, running(port, tmp_path) as runtime:
        code, out, err = finished("subscribe", runtime.publisher.endpoint, "--frames", 20, "--mode", "all")
        assert code == 0, err
        assert len(out.splitlines()) == 20
        assert "  vd2t  " in out
        code, out, err = finished("subscribe", runtime.publisher.endpoint, "--frames", 20)
        assert code == 0, err
        assert 1 <= len(out.splitlines()) < 20  # one a second, and the last
        assert "vd2t" in out
        code, out, err = finished("subscribe", runtime.publisher.endpoint, "--frames", 20, "--mode", "all", "--json")
        assert code == 0, err
        summary = json.loads(out)
    assert (summary["frames"], summary["lost"], summary["rejected"]) == (20, 0, 0)
    assert "deliver" in summary["stages_us"]


def test_places_are_in_mm_only_if_the_runtime_has_that_sheet(virtual_skin, running, tmp_path):
    small = tmp_path / "small.toml"
    small.write_text(to_toml(replace(PAPER, outline=Outline(size_mm=(148.0, 100.0)))))  # its maps have the same shape
    with virtual_skin(touches=[[0.2, 600, 0.3]], touches_wait=True) as port, running(port, tmp_path) as runtime:
        begin_touches(port)
        words = ["subscribe", runtime.publisher.endpoint, "--frames", 200, "--mode", "all"]
        places = re.findall(r"peak \S+ at (\w+)", finished(*words)[1])
        assert set(places) == {"x"}
        places = re.findall(r"peak \S+ at (\w+)", finished(*words, "--skin", small)[1])
        assert set(places) == {"row"}


def test_ctrl_c_ends_subscribe_without_a_traceback_before_and_after_the_first_frame(
    virtual_skin, running, tmp_path, monkeypatch
):
    from eitskin.messaging.publish import Publisher

    silent = Publisher(f"ipc://{tmp_path}/silent")
    behind_ampersand = partial(signal.signal, signal.SIGINT, signal.SIG_IGN)  # which a shell's script does to it
    process = command("subscribe", silent.endpoint, "--timeout-s", 60, preexec_fn=behind_ampersand)
    while not silent.wanted and process.poll() is None:  # it waits for its first frame as soon as it has subscribed
        silent.update()
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=120)
    silent.close()
    assert (process.returncode, out, err) == (0, "", "")
    (tmp_path / "r").mkdir()
    with virtual_skin() as port, running(port, tmp_path / "r") as runtime:
        process = command(
            "subscribe", runtime.publisher.endpoint, "--mode", "all", env={**os.environ, "PYTHONUNBUFFERED": "1"}
        )
        process.stdout.readline()
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=120)
    assert (process.returncode, err) == (0, "")


def test_doctor_reports_and_makes_keys(virtual_skin, tmp_path):
    with virtual_skin() as port:
        code, out, err = finished("doctor", "--port", port, "--json")
    assert code == 0, err
    found = json.loads(out)
    assert found["device"]["serial_number"] == "VIRTUAL-0001"
    assert {"ports", "bundles", "limits", "problems"} <= set(found)
    code, out, _ = finished("doctor", "--make-curve-keys", tmp_path / "keys", "--json")
    assert code == 0
    assert len(json.loads(out)["files"]) == 4
    assert finished("doctor", "--port", "/dev/ttyNONE9")[0] == 1
