"""The commands as a user starts them: exit status, one line on stderr, one object on stdout."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import eitskin
from eitskin.reference.captured import load

pytestmark = pytest.mark.process


def command(*words, **options):
    return subprocess.Popen(
        [sys.executable, "-W", "error", "-m", "eitskin_tools.cli", *map(str, words)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **options,
    )


def finished(*words):
    process = command(*words)
    out, err = process.communicate(timeout=120)
    return process.returncode, out, err


def wait_until_ready(process):
    seen = []
    for line in process.stderr:
        seen.append(line)
        if line.startswith("ready "):
            return "".join(seen)
    raise AssertionError("".join(seen))


@pytest.fixture
def endpoints(tmp_path):
    return ["--publish", f"ipc://{tmp_path}/frames", "--control", f"ipc://{tmp_path}/control"]


def test_run_publishes_reports_what_it_got_and_ends_cleanly_on_sigterm(virtual_skin, tiny_path, tmp_path, endpoints):
    with virtual_skin(touches=[[0.6, 60, 0.3]]) as port:
        words = ["--bundle", tiny_path, "--reference-frames", 20, *endpoints, "--json"]
        process = command("run", "--port", port, *words)
        report = wait_until_ready(process)
        for found in ("open, exclusive", "low-latency mode", "VIRTUAL-0001", "gate: false-alarm rate", "median spread"):
            assert found in report
        with eitskin.subscribe(f"ipc://{tmp_path}/frames", mode="all", timeout_s=60) as frames:
            taken = [next(frames) for _ in range(60)]
        assert taken[-1].touched
        assert taken[-1].latency_s < 1.0
        process.send_signal(signal.SIGTERM)
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


def test_a_subscriber_that_names_no_endpoint_finds_a_runtime_that_names_none(
    virtual_skin, tiny_path, tmp_path, monkeypatch
):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    with virtual_skin(touches=[[0.2, 60, 0.3]]) as port:
        process = command("run", "--port", port, "--bundle", tiny_path, "--reference-frames", 20)
        wait_until_ready(process)
        with eitskin.subscribe() as frames:
            assert next(frames).map.shape == (30, 45)
        code, out, err = finished("subscribe", "--frames", 5, "--json")
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=10)
    assert code == 0, err
    assert json.loads(out)["frames"] == 5


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


def test_a_reference_of_another_device_is_refused(virtual_skin, tiny_path, tmp_path, endpoints):
    stored = tmp_path / "skin.json"
    with virtual_skin(serial_number="FIRST") as port:
        assert finished("reference", "--port", port, "--out", stored, "--bundle", tiny_path)[0] == 0
    with virtual_skin(serial_number="SECOND") as port:
        code, out, err = finished("run", "--port", port, "--bundle", tiny_path, "--reference", stored, *endpoints)
    assert (code, out) == (1, "")
    assert "found FIRST, expected SECOND" in err.splitlines()[-1]


def test_a_missing_port_is_one_line_and_exit_1(tiny_path):
    code, out, err = finished("run", "--port", "/dev/ttyNONE9", "--bundle", tiny_path)
    assert (code, out) == (1, "")
    assert err.splitlines()[-1].startswith("eitskin run: no port /dev/ttyNONE9")
    assert "Traceback" not in err


def test_a_busy_port_is_one_line_and_exit_1(virtual_skin, tiny_path, endpoints):
    with virtual_skin() as port:
        first = command("run", "--port", port, "--bundle", tiny_path, *endpoints)
        wait_until_ready(first)
        code, _, err = finished("run", "--port", port, "--bundle", tiny_path)
        first.send_signal(signal.SIGINT)
        first.communicate(timeout=120)
    assert first.returncode == 0
    assert code == 1
    assert "open in another program" in err.splitlines()[-1]


def test_a_port_that_vanishes_is_one_line_and_exit_1(virtual_skin, tiny_path, endpoints):
    with virtual_skin(faults=["unplug@1.0:30"]) as port:
        code, out, err = finished("run", "--port", port, "--bundle", tiny_path, *endpoints)
    assert (code, out) == (1, "")
    assert "vanished" in err.splitlines()[-1]
    assert "Traceback" not in err


def test_an_address_in_use_is_one_line_and_exit_1(virtual_skin, tiny_path, endpoints, tmp_path):
    from eitskin.messaging.publish import Publisher

    holder = Publisher(f"ipc://{tmp_path}/frames")
    with virtual_skin() as port:
        code, _, err = finished("run", "--port", port, "--bundle", tiny_path, *endpoints)
    holder.close()
    assert code == 1
    assert "is in use" in err.splitlines()[-1]


def test_a_damaged_bundle_and_a_foreign_device_exit_1(virtual_skin, tiny_path, tmp_path, endpoints):
    broken = tmp_path / "broken.eitskin"
    broken.write_bytes(tiny_path.read_bytes()[:5000])
    code, _, err = finished("run", "--port", "/dev/null", "--bundle", broken)
    assert code == 1
    assert "no intact bundle" in err
    with virtual_skin(faults=["foreign"]) as port:
        code, _, err = finished("run", "--port", port, "--bundle", tiny_path, *endpoints)
    assert code == 1
    assert "protocol_id: found 00000000f0e1d2c3" in err.splitlines()[-1]


def test_a_budget_that_nothing_meets_exits_1_and_says_what_would(virtual_skin, tiny_path, endpoints):
    with virtual_skin() as port:
        code, _, err = finished("run", "--port", port, "--bundle", tiny_path, "--budget-ms", "0.0001", *endpoints)
    assert code == 1
    assert "budget of 0.0001 ms cannot be met: the fastest solver, tikhonov, takes" in err.splitlines()[-1]


@pytest.mark.parametrize(
    "words",
    [
        ["--frames", "0"], ["--seconds", "-1"], ["--budget-ms", "0"], ["--reference-frames", "1"],
        ["--affinity", "one"], ["--budget-ms", "nan"], ["--speed", "9"], ["--solver", "magic"], ["--idle-after", "0"],
    ],
)  # fmt: skip
def test_bad_usage_of_run_exits_2(words):
    code, out, err = finished("run", "--port", "/dev/null", *words)
    assert (code, out) == (2, "")
    assert words[0] in err


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


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--publish", "here"], "endpoint 'here': expected ipc:///path or tcp://address:port"),
        (["--control", "ipc://relative"], "expected an absolute path"),
        (["--curve-keys", "/nowhere"], "/nowhere/server.key_secret is no CURVE key"),
    ],
)
def test_what_cannot_be_bound_is_refused_before_the_port_is_opened(words, said):
    code, out, err = finished("run", "--port", "/dev/ttyNONE9", *words)
    assert (code, out, err.count("\n")) == (1, "", 1)
    assert said in err


def test_real_time_options_say_what_was_got(virtual_skin, tiny_path, endpoints):
    cpu = min(os.sched_getaffinity(0))
    words = ["--affinity", str(cpu), "--mlock", "--sched-fifo", "1"]
    with virtual_skin() as port:
        code, _, err = finished("run", "--port", port, "--bundle", tiny_path, "--frames", "20", *words, *endpoints)
    assert code == 0, err
    assert f"affinity: CPU {cpu}" in err
    for name in ("mlockall: ", "SCHED_FIFO 1: "):
        answer = err.partition(name)[2]
        assert answer.startswith(("got", "refused"))


def test_subscribe_prints_frames_and_one_object(virtual_skin, running, tmp_path):
    with virtual_skin(touches=[[0.2, 60, 0.3]]) as port, running(port, tmp_path) as runtime:
        code, out, err = finished("subscribe", runtime.publisher.endpoint, "--frames", 20, "--mode", "all")
        assert code == 0, err
        assert len(out.splitlines()) == 20
        assert "solver vd2t" in out
        code, out, err = finished("subscribe", runtime.publisher.endpoint, "--frames", 20)
        assert code == 0, err
        assert 1 <= len(out.splitlines()) < 10  # one a second, and the last
        assert "vd2t" in out
        code, out, err = finished("subscribe", runtime.publisher.endpoint, "--frames", 20, "--mode", "all", "--json")
        assert code == 0, err
        summary = json.loads(out)
    assert (summary["frames"], summary["lost"], summary["rejected"]) == (20, 0, 0)
    assert "deliver" in summary["stages_us"]


def test_a_region_outside_the_sheet_exits_2_and_names_the_sheet():
    code, out, err = finished("subscribe", "ipc:///tmp/x", "--region", "0", "0", "200", "10")
    assert (code, out) == (2, "")
    assert "x is 0 to 150, y 0 to 100 mm" in err


def test_ctrl_c_ends_subscribe_without_a_traceback_before_and_after_the_first_frame(
    virtual_skin, running, tmp_path, monkeypatch
):
    from eitskin.messaging.publish import Publisher

    silent = Publisher(f"ipc://{tmp_path}/silent")
    process = command("subscribe", silent.endpoint, "--timeout-s", 60)
    while not silent.wanted and process.poll() is None:  # it waits for its first frame as soon as it has subscribed
        silent.look()
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=30)
    silent.close()
    assert (process.returncode, out, err) == (0, "", "")
    (tmp_path / "r").mkdir()
    with virtual_skin() as port, running(port, tmp_path / "r") as runtime:
        process = command(
            "subscribe", runtime.publisher.endpoint, "--mode", "all", env={**os.environ, "PYTHONUNBUFFERED": "1"}
        )
        process.stdout.readline()
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=30)
    assert (process.returncode, err) == (0, "")


def test_subscribe_without_a_runtime_gives_up_with_one_line(tmp_path):
    start = time.perf_counter()
    code, out, err = finished("subscribe", f"ipc://{tmp_path}/nobody", "--timeout-s", "0.2")
    assert (code, out) == (1, "")
    assert "nobody listens there" in err
    assert "'eitskin run --port PORT'" in err
    assert time.perf_counter() - start < 100
    assert finished("subscribe", "ipc:///tmp/x", "--frames", "0")[0] == 2


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


def test_reference_without_a_file_to_go_to_is_bad_usage():
    assert finished("reference", "--port", "/dev/null")[0] == 2
    assert finished("reference")[0] == 2
    assert finished("reference", "--show", "/nowhere.json")[0] == 1


def ticks(pid):
    """Return {thread: (name, clock ticks)} of a process."""
    found = {}
    for thread in Path(f"/proc/{pid}/task").iterdir():
        fields = (thread / "stat").read_text().rpartition(")")[2].split()
        found[int(thread.name)] = ((thread / "comm").read_text().strip(), int(fields[11]) + int(fields[12]))
    return found


def test_one_thread_computes_and_no_other_runs(virtual_skin, tiny_path, tmp_path, endpoints):
    with virtual_skin(touches=[[0.15, 60, 0.3]], rate_hz=200.0) as port:
        words = ["--bundle", tiny_path, "--reference-frames", 10, *endpoints]
        process = command("run", "--port", port, *words)
        wait_until_ready(process)
        with eitskin.subscribe(f"ipc://{tmp_path}/frames", timeout_s=60) as frames:
            before = ticks(process.pid)
            end = time.perf_counter() + 2
            while time.perf_counter() < end:
                next(frames)
            after = ticks(process.pid)
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=120)
    used = {thread: after[thread][1] - before.get(thread, ("", 0))[1] for thread in after}
    main = used.pop(process.pid)
    others = {thread: spent for thread, spent in used.items() if not after[thread][0].startswith("ZMQbg")}
    assert main >= 5  # 50 ms of work in 2 s: the measurement sees what runs
    assert sum(others.values()) <= 1, (main, others, after)
