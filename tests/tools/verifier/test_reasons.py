"""Why a verdict is flagged: each reason, and none where it is not."""

import pytest

from eitskin.messaging.streams.verified import TIME, UNEXPLAINED
from eitskin_sim.verification.shape_verdict import ShapeVerdict
from eitskin_sim.verification.verdict import Verdict
from eitskin_tools.verifier.checkers import reason_of


@pytest.mark.parametrize(("p_value", "unfinished", "why"), [
    (0.4, False, ""), (0.009, False, UNEXPLAINED), (0.009, True, TIME), (0.046, True, TIME),
])  # fmt: skip
def test_shapes(p_value, unfinished, why):
    verdict = ShapeVerdict((), 100.0, 100, p_value, 0.01, 1, 0.1, unfinished)
    assert reason_of(verdict) == why
    assert verdict.flagged == bool(why)


@pytest.mark.parametrize(("p_value", "unfinished", "why"), [
    (0.4, False, ""), (0.4, True, ""), (0.001, False, UNEXPLAINED), (0.001, True, TIME),
])  # fmt: skip
def test_units(p_value, unfinished, why):
    assert reason_of(Verdict((), 100.0, 100, p_value, 0.01, 1, 0.1, unfinished)) == why
