"""``eitskin run --verify``: what is wrong is one line, before the port is opened."""

from eitskin_tools import cli
from eitskin_tools.command_line import needs

NOWHERE = ["run", "--port", "/dev/ttyNONE9"]


def test_without_scipy_it_is_said_which_extra_to_install(monkeypatch, capsys):
    monkeypatch.setattr(needs, "find_spec", lambda name: None)
    assert cli.main([*NOWHERE, "--verify", "always"]) == 1
    said = capsys.readouterr().err
    assert said == "eitskin run: --verify always needs scipy: pip install 'eitskin[sim]'\n"
