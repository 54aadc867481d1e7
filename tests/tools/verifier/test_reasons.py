"""Why a verdict is flagged: each reason, and none where it is not."""

import numpy as np
import pytest

from eitskin.messaging.verified.message import CONTESTED, TIME, UNEXPLAINED
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.verification.free.found import FreeVerdict, map_of
from eitskin_sim.verification.verdict import Verdict
from eitskin_tools.verifier import reasons

TOUCH = np.array([[0, 60.0, 45.0, 12.0, 10.0, 0.0, 50.0, 0.0]])
SPECK = np.array([[0, 60.0, 45.0, 2.0, 2.0, 0.0, 50.0, 0.0]])
SHOWN = map_of(TOUCH)[None]
QUICK, SLOW, BUDGET_S = 0.1, 0.18, 0.2


def shapes(pieces, p_value, seconds, contested):
    return FreeVerdict(
        (), 100.0, 100, p_value, 0.01, 1, seconds, pieces=pieces, contested=contested, likely=((1.0, pieces),)
    )


@pytest.mark.parametrize(("pieces", "p_value", "seconds", "contested", "why"), [
    (TOUCH, 0.4, SLOW, False, ""),
    (TOUCH, 0.009, QUICK, False, UNEXPLAINED),
    (TOUCH, 0.009, SLOW, True, TIME),
    (TOUCH, 0.046, SLOW, True, TIME),
    (SPECK, 0.4, QUICK, True, CONTESTED),
    (SPECK, 0.4, SLOW, True, CONTESTED),
    (TOUCH[:0], 0.4, SLOW, True, CONTESTED),
    (SPECK, 0.001, QUICK, True, UNEXPLAINED),
])  # fmt: skip
def test_shapes(pieces, p_value, seconds, contested, why):
    verdict = shapes(pieces, p_value, seconds, contested)
    assert reasons.of_shapes(verdict, SHOWN, PAPER, BUDGET_S) == why
    assert verdict.flagged == bool(why)


@pytest.mark.parametrize(("p_value", "seconds", "why"), [
    (0.4, SLOW, ""), (0.001, QUICK, UNEXPLAINED), (0.001, SLOW, TIME),
])  # fmt: skip
def test_units(p_value, seconds, why):
    assert reasons.of_units(Verdict((), 100.0, 100, p_value, 0.01, 1, seconds), BUDGET_S) == why
