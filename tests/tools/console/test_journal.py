"""Lines for the journal: a prefix where the stream is the journal's, and nowhere else."""

import os

import pytest

from eitskin_tools.console.run_log import RunLog


@pytest.fixture
def stream(tmp_path):
    with (tmp_path / "log").open("w+") as found:
        yield found


@pytest.fixture
def named(stream, monkeypatch):
    found = os.fstat(stream.fileno())
    monkeypatch.setenv("JOURNAL_STREAM", f"{found.st_dev}:{found.st_ino}")
    return stream


def lines(stream):
    stream.seek(0)
    return stream.read().splitlines()


def test_each_event_has_its_level_before_it(named):
    log = RunLog(named)
    log.say("a port")
    log.warn("a doubt")
    log.ready("p", "c")
    log.failed("stands still", "one\ntwo")
    found = lines(named)
    assert [line[:3] for line in found] == ["<6>", "<4>", "<5>", "<3>"]
    assert found[0] == "<6>eitskin run: a port"
    assert "two" in found[3]  # all of an event is one line
