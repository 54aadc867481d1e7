"""Keyframes that nobody has yet: while they are solved, whoever waits is told."""

import numpy as np

from eitskin_tools.scripted_scene import keyframes
from eitskin_tools.scripted_scene import script as prepare
from eitskin_tools.scripted_scene.script import demonstration


def test_where_no_bar_can_be_drawn_a_line_says_that_it_takes_a_while(monkeypatch, capsys):
    monkeypatch.setattr(keyframes, "solve", lambda scene: np.ones(104))
    script = demonstration()
    found = prepare.prepare(script, script.period_s, workers=1, cache=False)
    said = capsys.readouterr().err
    assert f"solving {len({moment.scene for moment in script.moments(script.period_s)})} moments" in said
    assert len(said.splitlines()) == 1
    assert len(found.times_s) == len(script.moments(script.period_s))
