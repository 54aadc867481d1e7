import pytest

from eitskin.pipeline.latency_budget import HOLD_FRAMES, LatencyBudget, in_ns

SLOW, FAST, FAIR = 2_000_000, 100_000, 800_000
BUDGET = 1_000_000


def test_overruns_go_down_in_order_and_are_counted():
    budget = LatencyBudget(BUDGET, 3)
    seen = []
    for _ in range(5):
        assert budget.judge(SLOW, inferred=True)
        seen.append((budget.engine, budget.drops_stale))
    assert seen == [(1, False), (2, False), (2, True), (2, True), (2, True)]
    assert budget.overruns == 5


def test_room_is_taken_back_step_by_step():
    budget = LatencyBudget(BUDGET, 3)
    for _ in range(3):
        budget.judge(SLOW, inferred=True)
    levels = [budget.level]
    for _ in range(4 * HOLD_FRAMES):
        budget.judge(FAST, inferred=True)
        levels.append(budget.level)
    assert [levels.index(level) for level in (3, 2, 1, 0)] == [0, HOLD_FRAMES, 2 * HOLD_FRAMES, 3 * HOLD_FRAMES]


def test_a_budget_is_of_milliseconds_and_within_a_quarter_of_an_hour():
    assert in_ns(None) is None
    assert in_ns(2.5) == 2_500_000
    for budget_ms in (0.0, -1.0, float("nan"), float("inf"), 2e6):
        with pytest.raises(ValueError, match="expected more than 0 and at most 1000000"):
            in_ns(budget_ms)
