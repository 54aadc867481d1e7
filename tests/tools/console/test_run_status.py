"""What ``eitskin run`` says while it runs: when, in which format, and that it costs the frame loop nothing."""

import contextlib
import io
import json
import os

from eitskin_tools.console.run_log import RunLog
from eitskin_tools.console.run_status import SILENT_S, RunStatus


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
    status.check()
    return skin, status


def test_a_healthy_stream_is_a_line_a_minute_where_nobody_looks_on():
    stream = io.StringIO()
    skin, status = looked_at(stream)
    for _ in range(int(2 * SILENT_S)):
        skin.pass_second()
        status.check()
    lines = stream.getvalue().splitlines()
    assert lines == ["eitskin run: 200.0 frames/s, untouched, 0 lost, 0 corrupt, all electrodes work"] * 2


def test_a_loss_a_withheld_frame_and_a_failed_electrode_are_said_at_once_with_their_names():
    stream = io.StringIO()
    skin, status = looked_at(stream)
    skin.pass_second(lost=3)
    status.check()
    skin.pass_second(withheld_by_reason={"stale": 0, "corrupt": 2}, touched=7)
    status.check()
    drift = {"percent": 34.3, "sd_percent": 15.0, "uneven_percent": None, "followed": False}
    skin.pass_second(electrodes=["5:detached:imputed"], drift=drift)
    status.check()
    skin.pass_second()
    status.check()
    lines = stream.getvalue().splitlines()
    assert len(lines) == 3
    assert "3 lost" in lines[0]
    assert "touched" in lines[1]
    assert "2 withheld (corrupt: 2)" in lines[1]
    assert "electrode 5 detached (rows estimated), drift unknown while touched or bent" in lines[2]


def test_json_is_one_object_a_line_with_rate_and_reasons():
    stream = io.StringIO()
    skin, status = looked_at(stream, "json")
    RunLog(stream, "json").ready("ipc:///a", "ipc:///b")
    skin.pass_second(frames=100, corrupt=1)
    status.check()
    ready, found = (json.loads(line) for line in stream.getvalue().splitlines())
    assert (ready["event"], ready["publish"], ready["control"]) == ("ready", "ipc:///a", "ipc:///b")
    assert (found["event"], found["rate_hz"], found["corrupt"]) == ("status", 100.0, 1)
    assert found["withheld_by_reason"] == {"stale": 0}
    assert found["time_utc"].endswith("+00:00")


def test_a_line_for_which_there_is_no_room_is_left_out_and_nobody_waits_for_it():
    """The parent process no longer reads the log: the pipe is full."""
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
