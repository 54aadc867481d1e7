"""Which signals ask a command to end, and what is left by one that ends."""

import signal
import subprocess
import sys

import pytest

from eitskin_tools.processes.signals import endings, met_by

WRITER = """
import signal, sys
from eitskin_proto.files.writing import replacing
from eitskin_tools import cli
from eitskin_tools.commands import doctor

def run(arguments):
    with replacing(sys.argv[1]) as file:
        file.write(b"half of it")
        for _ in range(int(sys.argv[3])):
            try:
                signal.raise_signal(int(sys.argv[2]))
            finally:
                print("met", flush=True)
                if sys.argv[3] == "2":
                    signal.raise_signal(int(sys.argv[2]))
                    print("not the last thing", flush=True)
    return 0

doctor.run = run
sys.exit(cli.main(["doctor"]))
"""
"""A command that gets a signal, once or twice, while it writes."""


def test_a_closed_terminal_asks_for_an_end_unless_the_parent_ignores_sighup():
    with met_by(signal.SIG_DFL, signal.SIGHUP):
        assert endings() == (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    with met_by(signal.SIG_IGN, signal.SIGHUP):
        assert endings() == (signal.SIGINT, signal.SIGTERM)


def ended(path, number, times, *before):
    """Run the writer, and return its status and what it printed."""
    command = [*before, sys.executable, "-c", WRITER, str(path), str(number), str(times)]
    with met_by(signal.SIG_DFL, signal.SIGHUP, signal.SIGINT):  # these tests may run under nohup themselves, or by "&"
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=120, check=False, stdin=subprocess.DEVNULL
        )
    assert "Traceback" not in done.stderr
    return done.returncode, done.stdout


@pytest.mark.process
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_what_ends_a_command_while_it_writes_leaves_nothing_half_written(tmp_path, number):
    assert ended(tmp_path / "a.json", number, 1) == (-number, "met\n")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.process
def test_the_second_signal_ends_it_at_once(tmp_path):
    assert ended(tmp_path / "a.json", signal.SIGINT, 2) == (-signal.SIGINT, "met\n")


AT_THE_EDGES = """
import atexit, signal, sys

when = sys.argv.pop()

class TouchFinder:
    def find_spec(self, name, path=None, target=None):
        if name == when:
            signal.raise_signal(signal.SIGINT)

sys.meta_path.insert(0, TouchFinder())
if when == "the end":
    atexit.register(signal.raise_signal, signal.SIGINT)
from eitskin_tools.entry import main
sys.exit(main())
"""
"""The command, with Ctrl-C when it imports something, or when the interpreter ends."""


@pytest.mark.process
@pytest.mark.parametrize("when", ["eitskin_tools.command_line.files", "the end"])
def test_ctrl_c_before_and_behind_a_command_is_no_traceback(when):
    with met_by(signal.SIG_DFL, signal.SIGINT):
        done = subprocess.run(
            [sys.executable, "-c", AT_THE_EDGES, "--version", when],
            capture_output=True, text=True, timeout=120, check=False,
        )  # fmt: skip
    assert (done.returncode, done.stderr) == (-signal.SIGINT, "")
