"""``eitskin run --verify``: what is wrong is one line, before the port is opened."""

import os

import pytest

from eitskin_tools import cli
from eitskin_tools.command_line import needs
from eitskin_tools.verifier import options

NOWHERE = ["run", "--port", "/dev/ttyNONE9"]


@pytest.mark.parametrize(("words", "says"), [
    (["--verify", "often"], "--verify is 'often', expected one of off, idle, always"),
    (["--verify", "alway"], "always"),
    (["--verify", "always", "--verify-budget-ms", "0"], "--verify-budget-ms is 0, expected more than 0 and at"),
    (["--verify", "always", "--verify-budget-ms", "inf"], "-ms is inf, expected more than 0 and at most 1000000; "),
    (["--verify", "always", "--verify-budget-ms", "1e7"], "expected more than 0 and at most 1000000"),
    (["--verify", "idle", "--verify-budget-ms", "-3"], "expected more than 0"),
    (["--verify", "idle", "--verify-budget-ms", "nan"], "expected more than 0"),
    (["--verify-budget-ms", "5"], "--verify-budget-ms goes with --verify idle or --verify always"),
    (["--verify-nice", "5"], "--verify-nice goes with"),
    (["--verify", "always", "--verify-nice", "20"], "--verify-nice is 20, expected 0 to 19"),
    (["--verify", "always", "--verify-affinity", "4000"], "--verify-affinity: CPU [4000]: expected some of"),
    (["--verify", "always", "--verify-affinity", "one"], "expected CPU numbers such as 2 or 2,3"),
])  # fmt: skip
def test_bad_options_are_bad_usage(words, says, capsys):
    assert cli.main([*NOWHERE, *words]) == 2
    said = capsys.readouterr().err
    assert len(said.splitlines()) == 1
    assert says in said


def test_without_scipy_it_is_said_which_extra_to_install(monkeypatch, capsys):
    monkeypatch.setattr(needs, "find_spec", lambda name: None)
    assert cli.main([*NOWHERE, "--verify", "always"]) == 1
    said = capsys.readouterr().err
    assert said == "eitskin run: --verify always needs scipy: pip install 'eitskin[sim]'\n"


def test_a_port_that_is_missing_is_said_first_of_all_that_is_started(capsys):
    assert cli.main([*NOWHERE, "--verify", "always"]) == 1
    assert "/dev/ttyNONE9" in capsys.readouterr().err


def test_the_verifier_takes_what_the_runtime_leaves():
    parser = cli._parser("run")
    every = sorted(os.sched_getaffinity(0))
    assert options.cpus(parser.parse_args(["run", "--affinity", "0"]), {0, 1, 2}) == (1, 2)
    assert options.cpus(parser.parse_args(["run", "--affinity", "0"]), {0}) == (0,)
    assert options.cpus(parser.parse_args(["run"]), set(every)) == tuple(every)
    assert options.cpus(parser.parse_args(["run", "--verify-affinity", "2"]), {0, 2}) == (2,)
