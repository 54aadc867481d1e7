"""Commands that are started without standard streams go on, and open nothing in their place."""

import os
import subprocess
import sys

import pytest

pytestmark = pytest.mark.process

CLOSED = ["<&-", ">&-", "2>&-", "<&- >&- 2>&-"]


def shell(words: str, closed: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ["/bin/sh", "-c", f"exec '{sys.executable}' {words} {closed}"],
        capture_output=True, text=True, timeout=120, check=False, env={**os.environ, **environment},
    )  # fmt: skip


@pytest.mark.parametrize("closed", CLOSED)
def test_a_command_does_its_work_and_says_how_it_went(closed: str) -> None:
    done = shell("-m eitskin_tools.cli skin check paper", closed)
    assert done.returncode == 0
    assert "Traceback" not in done.stderr
    assert (">&-" in closed.split()) != done.stdout.startswith("paper: ")


@pytest.mark.parametrize("unbuffered", ["", "1"])
@pytest.mark.parametrize("words", ["skin check paper", "--version"])
def test_a_full_standard_output_is_one_line_and_a_failure(words: str, unbuffered: str) -> None:
    done = shell(f"-m eitskin_tools.cli {words}", ">/dev/full", PYTHONUNBUFFERED=unbuffered)
    assert done.returncode == 1
    assert done.stderr.partition(": ")[2] == "no space left where this is written; free some, or write elsewhere\n"


STUBBED = """
import socket, sys
from eitskin_tools import cli
from eitskin_tools.commands.live import doctor

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


def unread(words: list[str], unbuffered: str) -> tuple[int, str]:
    """Return exit status and standard error of what is run while nobody reads its standard output."""
    reads, writes = os.pipe()
    os.close(reads)
    done = subprocess.run(
        [sys.executable, *words], stdout=writes, stderr=subprocess.PIPE, text=True,
        timeout=120, check=False, env={**os.environ, "PYTHONUNBUFFERED": unbuffered},
    )  # fmt: skip
    os.close(writes)
    return done.returncode, done.stderr


@pytest.mark.parametrize("unbuffered", ["", "1"])
@pytest.mark.parametrize("words", [["-m", "eitskin_tools.cli", "--help"], ["-c", STUBBED.replace("{run}", "run")]])
def test_a_standard_output_that_nobody_reads_ends_well_without_a_word(words: list[str], unbuffered: str) -> None:
    assert unread(words, unbuffered) == (0, "")


def test_a_failure_stays_one_where_nobody_reads_the_rest() -> None:
    assert unread(["-c", STUBBED.replace("{run}", "failed")], "") == (1, "eitskin doctor: it broke\n")


def test_a_pipe_to_something_else_that_broke_is_a_failure_in_a_line() -> None:
    done = shell(f"-c '{STUBBED.replace('{run}', 'elsewhere')}'", "")
    assert (done.returncode, done.stderr.count("\n")) == (1, 1)
    assert "Broken pipe" in done.stderr


@pytest.mark.parametrize("encoding", ["latin-1", "ascii:surrogateescape", "utf-8"])
def test_what_a_terminal_cannot_show_is_escaped(encoding: str) -> None:
    code = STUBBED.replace("{run}", 'lambda arguments: print("a \\u2580 b") or 0')
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, timeout=120, check=False,
        env={**os.environ, "PYTHONIOENCODING": encoding, "PYTHONUTF8": "0"},
    )  # fmt: skip
    assert done.stdout == ("a \u2580 b\n".encode() if encoding == "utf-8" else b"a \\u2580 b\n")
    assert done.stderr == b""


def test_a_log_on_a_full_disk_ends_no_command_and_changes_no_result() -> None:
    code = (
        "import sys; from eitskin_tools import cli; from eitskin_tools.console.run_log import RunLog; "
        "log = RunLog(sys.stderr); [log.warn('x' * 4000) for _ in range(9)]; log.failed('x', 'y'); log.end(); "
        "sys.exit(cli.main(['skin', 'check', 'paper']))"
    )
    assert shell(f'-c "{code}"', "2>/dev/full").returncode == 0


def test_what_is_opened_next_takes_no_standard_stream_s_number() -> None:
    code = (
        "from eitskin_tools.console.closed import replace_closed; replace_closed(); import os, sys; "
        "assert os.open('/dev/null', os.O_RDONLY) > 2; "
        "[print('lost', file=stream, flush=True) for stream in (sys.stdout, sys.stderr)]; assert sys.stdin.read() == ''"
    )
    done = shell(f'-c "{code}"', "<&- >&- 2>&-")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@pytest.mark.parametrize("closed", ["2>&-", "<&- 2>&-"])
def test_a_log_without_a_stream_does_not_end_the_command(closed: str) -> None:
    code = (
        "import sys; from eitskin_tools import cli; from eitskin_tools.console.run_log import RunLog; "
        "cli.main(['skin', 'check', 'paper']); RunLog(sys.stderr).say('x')"
    )
    assert shell(f'-c "{code}"', closed).returncode == 0
