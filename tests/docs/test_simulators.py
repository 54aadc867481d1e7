"""The page about simulators: its programs run, and what they press is felt."""

import numpy as np
import pytest

from eitskin_sim.press import Press

from .markdown import ROOT, code_blocks

FEEL, GYMNASIUM, LAW = code_blocks(ROOT / "docs/simulators.md", "python")


def test_the_page_feels_a_press():
    here = {}
    exec(FEEL, here)
    assert np.allclose(here["touch"].centre_mm, (60.0, 40.0), atol=4.0)  # one noisy frame: 0.8 mm each way
    exec(LAW, here)
    assert here["sheet"].law.depths_mm == (0.0, 6.0)


@pytest.mark.slow
def test_maps_are_observations_of_gymnasium():
    gymnasium = pytest.importorskip("gymnasium", reason="observations need the extra 'simulators'")
    here, presses = {}, []
    exec(f"{FEEL}\n{GYMNASIUM}", here)
    env = here["SkinObservation"](gymnasium.make("CartPole-v1"), here["sheet"], lambda _: presses)
    with env.skin:
        assert env.reset(seed=0)[0]["map"].max() == 0.0
        presses.append(Press(40.0, 30.0, 8.0, 11.0))
        seen = env.step(1)[0]
    assert seen in env.observation_space
    assert np.unravel_index(seen["map"].argmax(), (30, 45)) in [(row, column) for row in (8, 9) for column in (11, 12)]
