"""``eitskin run --verify``: what is wrong is one line, before the port is opened."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

from eitskin_proto.skin.parts import Deformations
from eitskin_proto.skin.skin import PAPER
from eitskin_tools import cli
from eitskin_tools.command_line import needs
from eitskin_tools.errors import UsageError
from eitskin_tools.verifier.options import verifying

NOWHERE = ["run", "--port", "/dev/ttyNONE9"]


def test_without_scipy_it_is_said_which_extra_to_install(monkeypatch, capsys):
    monkeypatch.setattr(needs, "find_spec", lambda name: None)
    assert cli.main([*NOWHERE, "--verify", "always"]) == 1
    said = capsys.readouterr().err
    assert said == "eitskin run: --verify always needs scipy: pip install 'eitskin[sim]'\n"


def test_a_shape_is_fitted_only_by_a_verifier_and_only_of_a_skin_that_bends(capsys):
    assert cli.main([*NOWHERE, "--cloud", "fitted"]) == 2
    assert "--cloud needs --verify idle or --verify always" in capsys.readouterr().err
    stiff = replace(PAPER, deformations=Deformations(*((0.0, 0.0),) * 4, (1.0, 1.0), (1.0, 1.0), (0.0, 0.0)))
    skin = SimpleNamespace(pipeline=SimpleNamespace(skin=stiff))
    arguments = SimpleNamespace(verify="always", cloud="fitted")
    with pytest.raises(UsageError, match=r"\[deformations\] are all fixed"), verifying(skin, None, arguments):
        pass


def test_a_disc_is_refused():
    disc = SimpleNamespace(outline=replace(PAPER.outline, kind="disc", size_mm=(100.0, 100.0)))
    skin = SimpleNamespace(pipeline=SimpleNamespace(skin=disc))
    with pytest.raises(UsageError, match="needs a rectangle"), verifying(skin, None, SimpleNamespace(verify="always")):
        pass
