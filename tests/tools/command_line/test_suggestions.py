"""Typing mistakes: one line, exit status 2, and what was probably meant."""

import pytest

from eitskin_proto.fields import did_you_mean
from eitskin_tools import cli


def said(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    try:
        status = cli.main(words)
    except SystemExit as end:
        status = int(str(end.code))
    out, err = capsys.readouterr()
    assert (status, out) == (2, "")
    assert err.count("\n") == 1
    return err.strip()


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["bech"], "eitskin: no command 'bech'; did you mean 'bench'?"),
        (["Demo"], "eitskin: no command 'Demo'; did you mean 'demo'?"),
        (["sim"], "eitskin: no command 'sim'; 'eitskin --help' lists them"),
        (["bench", "tradeof"], "eitskin bench: no benchmark 'tradeof'; did you mean 'tradeoff'?"),
        (["run", "--port", "p", "--slover", "x"], "eitskin run: no option '--slover'; did you mean '--solver'?"),
        (["bench", "skip", "--jsno"], "eitskin bench skip: no option '--jsno'; did you mean '--json'?"),
        (["--versoin"], "eitskin: no option '--versoin'; did you mean '--version'?"),
        (["subscribe", "a", "b"], "eitskin subscribe: found 'b', expected nothing more"),
        (["flash", "wirte", "paper"], "did you mean 'write'?"),
        (["demo", "--noise", "n2"], "--noise is 'n2', expected one of N1, N2, N3, none; did you mean 'N2'?"),
        (["run"], "eitskin run: expected --port PORT for one skin, or --config FILE.toml for several"),
        (["run", "--port", "p", "--solver", "tikonov"], "did you mean 'tikhonov'?"),
        (["demo", "--solver", "vdt2"], "did you mean 'vd2t'?"),
        (["evaluate", "--random", "2-4", "--solver", "tikhonv"], "did you mean 'tikhonov'?"),
    ],
)
def test_a_typing_mistake_is_answered_with_what_was_probably_meant(
    capsys: pytest.CaptureFixture[str], words: list[str], expected: str
) -> None:
    assert expected in said(capsys, *words)


def test_nothing_is_suggested_where_nothing_is_near() -> None:
    assert did_you_mean("reconstruct", ["run", "demo"]) == ""
    assert did_you_mean("file", ["drift", "single"]) == ""
