"""What ``eitskin run`` says while it runs: when, in which format, and that it costs the frame loop nothing."""

import contextlib
import io
import json
import os

from eitskin_tools.console.run_log import RunLog
from eitskin_tools.console.run_status import SILENT_S, RunStatus


class Terminal(io.StringIO):
    def isatty(self):
        return True


class Skin:
    """Counters that a test moves, and a clock that it moves with them."""

    def __init__(self):
        self.now_s = 0.0
        self.counters = {
            "frames": 0, "touched": 0, "lost": 0, "corrupt": 0, "withheld_by_reason": {"stale": 0}, "electrodes": [],
            "recoveries": 0, "resets": 0, "overruns": 0, "level": 0,
        }  # fmt: skip

    def status(self):
        return dict(self.counters)

    def pass_second(self, frames=200, **changes):
        self.now_s += 1.0
        self.counters.update(changes, frames=self.counters["frames"] + frames)


def looked_at(stream, form="text", quiet=False):
    skin = Skin()
    status = RunStatus(skin.status, RunLog(stream, form, quiet=quiet), lambda: skin.now_s)
    status.look()
    return skin, status


def test_a_healthy_stream_is_a_line_a_minute_where_nobody_looks_on():
    stream = io.StringIO()
    skin, status = looked_at(stream)
    for _ in range(int(2 * SILENT_S)):
        skin.pass_second()
        status.look()
    lines = stream.getvalue().splitlines()
    assert lines == ["eitskin run: 200.0 frames/s, untouched, 0 lost, 0 corrupt, electrodes well"] * 2


def test_a_loss_a_withheld_frame_and_a_failed_electrode_are_said_at_once_with_their_names():
    stream = io.StringIO()
    skin, status = looked_at(stream)
    skin.pass_second(lost=3)
    status.look()
    skin.pass_second(withheld_by_reason={"stale": 0, "corrupt": 2}, touched=7)
    status.look()
    skin.pass_second(electrodes=["5:detached:imputed"])
    status.look()
    skin.pass_second()
    status.look()
    lines = stream.getvalue().splitlines()
    assert len(lines) == 3
    assert "3 lost" in lines[0]
    assert "touched" in lines[1]
    assert "2 withheld (corrupt 2)" in lines[1]
    assert "electrodes: 5:detached:imputed" in lines[2]


def test_a_terminal_gets_one_line_that_is_rewritten():
    stream = Terminal()
    skin, status = looked_at(stream)
    for _ in range(5):
        skin.pass_second()
        status.look()
    assert stream.getvalue().count("\r") == 5
    assert "\n" not in stream.getvalue()


def test_json_is_one_object_a_line_with_rate_and_reasons():
    stream = io.StringIO()
    skin, status = looked_at(stream, "json")
    RunLog(stream, "json").ready("ipc:///a", "ipc:///b")
    skin.pass_second(frames=100, corrupt=1)
    status.look()
    ready, found = (json.loads(line) for line in stream.getvalue().splitlines())
    assert (ready["event"], ready["publish"], ready["control"]) == ("ready", "ipc:///a", "ipc:///b")
    assert (found["event"], found["rate_hz"], found["corrupt"]) == ("status", 100.0, 1)
    assert found["withheld_by_reason"] == {"stale": 0}
    assert found["time_utc"].endswith("+00:00")


def test_without_a_frame_that_can_be_used_electrodes_are_not_called_well():
    stream = io.StringIO()
    skin, status = looked_at(stream)
    skin.pass_second(frames=0, trouble="frozen", withheld_by_reason={"frozen": 200})
    status.look()
    skin.pass_second(trouble="")
    status.look()
    lines = stream.getvalue().splitlines()
    assert "200 withheld (frozen 200), no frame that can be used: frozen" in lines[0]
    assert "well" not in lines[0]
    assert "electrodes well" in lines[1]


def test_a_verifier_is_told_of_and_its_state_is_worth_a_line_but_not_its_counts():
    verifier = {
        "mode": "always", "state": "ready", "why": "", "checked": 0, "flagged": 0, "skipped": 0, "frame_ms_p50": 0.0,
        "frame_ms_p99": 0.0, "restarts": 0,
    }  # fmt: skip
    stream = io.StringIO()
    skin, status = looked_at(stream)
    skin.pass_second(verifier=verifier)
    status.look()
    assert "verify always: ready, 0 checked, 0 flagged, 0 skipped" in stream.getvalue().splitlines()[-1]
    lines = len(stream.getvalue().splitlines())
    skin.pass_second(verifier={**verifier, "checked": 9, "frame_ms_p50": 3.21, "frame_ms_p99": 7.0})
    status.look()
    assert len(stream.getvalue().splitlines()) == lines
    skin.pass_second(verifier={**verifier, "checked": 9, "state": "waiting", "why": "it hung", "restarts": 1})
    status.look()
    assert "verify always: waiting (it hung), 9 checked" in stream.getvalue()
    assert "started again 1 times" in stream.getvalue()


def test_a_line_for_which_there_is_no_room_is_left_out_and_nobody_waits_for_it():
    """Whoever started the runtime reads its log no more: the pipe is full."""
    ours, theirs = os.pipe()
    os.set_blocking(theirs, False)
    with os.fdopen(ours, "rb") as read, os.fdopen(theirs, "w") as stream:
        log = RunLog(stream)
        log.say("read")
        assert os.read(ours, 4096) == b"eitskin run: read\n"
        filled = 0
        with contextlib.suppress(BlockingIOError):
            while True:
                filled += os.write(theirs, bytes(4096))
        os.set_blocking(theirs, True)
        log.say("no room")
        log.status("no room", {})
        log.end()
        assert read.read(filled) == bytes(filled)
        log.say("read again")
        assert os.read(ours, 4096) == b"eitskin run: read again\n"
