"""The process that supervises: what becomes of one skin touches no other, and in the end nobody is left."""

import signal
import socket
import subprocess
import sys

import pytest

from eitskin.robot.described import FILE
from eitskin_tools.processes.children import Backoff
from eitskin_tools.processes.signals import met_by

from .conftest import HERE, PATIENCE_S, gone

pytestmark = pytest.mark.process


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_all_end_when_it_is_told_to_and_nothing_is_left(family, number):
    with met_by(signal.SIG_DFL, signal.SIGHUP), family(a="good", b="other") as found:
        assert found.ready()["skins"] == ["a", "b"]
        pids = [one.pid for one in found.states().values()]
        found.process.send_signal(number)
        assert found.ended() == 0
    assert all(gone(pid) for pid in pids)
    assert not (found.folder / FILE).exists()
    assert not [event for event in found.heard if event["event"] == "error"]


def test_one_that_falls_is_named_with_its_reason_and_the_other_runs_on(family):
    with family(a="fails", b="good") as found:
        ready = found.ready()
        assert (ready["skins"], ready["of"]) == (["b"], 2)
        (error,) = [event for event in found.heard if event["event"] == "error" and "status" in event["text"]]
        assert error["skin"] == "a"
        assert "ended with status 1: no port /dev/ttyNONE; 1 of 2 skins run on" in error["text"]
        states = found.states()
        assert (states["a"].state, states["a"].pid, states["b"].state) == ("failed", 0, "ready")
        assert "no port /dev/ttyNONE" in states["a"].why
        found.process.terminate()
        assert found.ended() == 0


def test_a_skin_starts_again_where_that_is_asked_for_and_the_others_do_not_notice(family):
    with family("on-failure", a="once", b="good") as found:
        found.until(lambda event: event["event"] == "ready" and event.get("skin") == "b")
        before = found.states()["b"].pid
        while (ready := found.states()["a"]).state != "ready":
            found.until(lambda event: event["event"] in ("ready", "error"))
        assert ready.restarts == 1
        assert "signal 9" in ready.why
        assert (found.states()["b"].pid, found.states()["b"].restarts) == (before, 0)
        assert any("starts again in 0.05 s" in event["text"] for event in found.heard if event["event"] == "error")


def test_pauses_between_starts_double_up_to_the_longest():
    backoff = Backoff()
    assert [backoff.pause_s(count) for count in range(1, 8)] == [1.0, 2.0, 4.0, 8.0, 16.0, 30.0, 30.0]
    assert backoff.pause_s(10**6) == 30.0


def test_when_nobody_is_left_it_ends_and_fails(family):
    with family(a="fails", b="usage") as found:
        assert found.ended() == 1
    assert not (found.folder / FILE).exists()


def test_one_that_prints_without_end_keeps_nobody_from_ending(family):
    with family(a="prints", b="good") as found:
        found.until(lambda event: event["event"] == "ready" and event.get("skin") == "b")
        found.process.terminate()
        assert found.ended() == 0


def test_one_that_hears_nothing_is_ended_by_force(family):
    with family(a="deaf", b="good", grace_s=0.3) as found:
        found.ready()
        pid = found.states()["a"].pid
        found.process.terminate()
        assert found.ended() == 0
        assert gone(pid)


def test_the_skins_end_with_a_parent_that_is_killed(family):
    with family(a="good", b="other") as found:
        found.ready()
        pids = [one.pid for one in found.states().values()]
        found.process.kill()
        assert all(gone(pid) for pid in pids)


def test_a_folder_in_use_is_refused(family, tmp_path):
    with family(a="good") as found:
        found.ready()
        second = subprocess.run(
            [sys.executable, HERE / "family_process.py", tmp_path / "robot.toml", "1", "60"],
            capture_output=True, check=False, text=True, timeout=PATIENCE_S,
        )  # fmt: skip
        assert "is in use: another 'eitskin run --config' runs skins there" in second.stderr
        assert found.states()["a"].state == "ready"  # nobody wrote over what is known of it


def test_systemd_hears_of_all_and_the_skins_do_not_speak_to_it(family, tmp_path):
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as ear:
        ear.bind(str(tmp_path / "notify"))
        ear.settimeout(PATIENCE_S)
        environment = {"NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "200000"}
        with family(a="environment", b="fails", environment=environment) as found:
            heard = []
            while "READY=1" not in heard or heard.count("WATCHDOG=1") < 3:
                heard.append(ear.recv(4000).decode())
            found.ready()
            found.process.terminate()
            while heard[-1] != "STOPPING=1":
                heard.append(ear.recv(4000).decode())
            assert found.ended() == 0
    told = [event["text"] for event in found.heard if event["event"] == "info"]
    assert len(told) == 1
    assert told[0] == "none none"
    assert any(line.startswith("STATUS=1 of 2 skins publish; b failed: ended with status 1") for line in heard)
