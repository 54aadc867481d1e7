"""Standard streams that take no more: on a full disk, or since nobody reads them."""

import os
import subprocess
import sys

import pytest

pytestmark = pytest.mark.process


def shell(words, closed, **environment):
    return subprocess.run(
        ["/bin/sh", "-c", f"exec '{sys.executable}' {words} {closed}"],
        capture_output=True, text=True, timeout=120, check=False, env={**os.environ, **environment},
    )  # fmt: skip


def test_a_full_standard_output_is_one_line_and_a_failure():
    done = shell("-m eitskin_tools.cli skin check paper", ">/dev/full", PYTHONUNBUFFERED="")
    assert done.returncode == 1
    assert done.stderr.partition(": ")[2] == "no space left where this is written; free some, or write elsewhere\n"


STUBBED = """
import socket, sys
from eitskin_tools import cli
from eitskin_tools.commands import doctor

def run(arguments):
    print("ok" * 5000)
    print("the end", flush=True)
    return 0

def failed(arguments):
    print("ok")
    raise ValueError("it broke")

def elsewhere(arguments):
    ours, theirs = socket.socketpair()
    theirs.close()
    ours.send(b"x")

doctor.run = {run}
sys.exit(cli.main(["doctor"]))
"""
"""A command that prints, one that fails, and one that is cut off from something else than its reader."""


def unread(words, unbuffered):
    """Return exit status and standard error of what is run while nobody reads its standard output."""
    reads, writes = os.pipe()
    os.close(reads)
    done = subprocess.run(
        [sys.executable, *words], stdout=writes, stderr=subprocess.PIPE, text=True,
        timeout=120, check=False, env={**os.environ, "PYTHONUNBUFFERED": unbuffered},
    )  # fmt: skip
    os.close(writes)
    return done.returncode, done.stderr


@pytest.mark.parametrize(
    ("words", "unbuffered"),
    [(["-m", "eitskin_tools.cli", "--help"], "1"), (["-c", STUBBED.replace("{run}", "run")], "")],
)
def test_a_standard_output_that_nobody_reads_ends_well_without_a_word(words, unbuffered):
    assert unread(words, unbuffered) == (0, "")


def test_a_failure_stays_one_where_nobody_reads_the_rest():
    assert unread(["-c", STUBBED.replace("{run}", "failed")], "") == (1, "eitskin doctor: it broke\n")


def test_a_log_on_a_full_disk_ends_no_command_and_changes_no_result():
    code = (
        "import sys; from eitskin_tools import cli; from eitskin_tools.console.run_log import RunLog; "
        "log = RunLog(sys.stderr); [log.warn('x' * 4000) for _ in range(9)]; log.failed('x', 'y'); log.end(); "
        "sys.exit(cli.main(['skin', 'check', 'paper']))"
    )
    assert shell(f'-c "{code}"', "2>/dev/full").returncode == 0
