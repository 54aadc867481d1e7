"""Every stage of a long piece of work is one line with its seconds."""

import re

import pytest

from eitskin_tools.console.progress import Stages


def test_a_stage_is_one_line_on_stderr_when_it_ends(capsys):
    with Stages() as tell:
        tell("folding")
        assert capsys.readouterr().err == ""
        tell("packing")
        assert re.fullmatch(r"folding: \d+\.\d s\n", capsys.readouterr().err)
    printed = capsys.readouterr()
    assert re.fullmatch(r"packing: \d+\.\d s\n", printed.err)
    assert printed.out == ""


def test_a_stage_that_fails_says_so_and_the_error_goes_on(capsys):
    def work():
        with Stages() as tell:
            tell("folding")
            raise ValueError("bad")

    with pytest.raises(ValueError, match="bad"):
        work()
    assert re.fullmatch(r"folding: stopped after \d+\.\d s\n", capsys.readouterr().err)
