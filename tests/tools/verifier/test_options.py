"""``eitskin run --verify``: what is wrong is one line, before the port is opened."""

import os

from eitskin_tools import cli
from eitskin_tools.command_line import needs
from eitskin_tools.verifier import options

NOWHERE = ["run", "--port", "/dev/ttyNONE9"]


def test_without_scipy_it_is_said_which_extra_to_install(monkeypatch, capsys):
    monkeypatch.setattr(needs, "find_spec", lambda name: None)
    assert cli.main([*NOWHERE, "--verify", "always"]) == 1
    said = capsys.readouterr().err
    assert said == "eitskin run: --verify always needs scipy: pip install 'eitskin[sim]'\n"


def test_the_verifier_takes_what_the_runtime_leaves():
    parser = cli._parser("run")
    every = sorted(os.sched_getaffinity(0))
    assert options.cpus(parser.parse_args(["run", "--affinity", "0"]), {0, 1, 2}) == (1, 2)
    assert options.cpus(parser.parse_args(["run", "--affinity", "0"]), {0}) == (0,)
    assert options.cpus(parser.parse_args(["run"]), set(every)) == tuple(every)
    assert options.cpus(parser.parse_args(["run", "--verify-affinity", "2"]), {0, 2}) == (2,)
