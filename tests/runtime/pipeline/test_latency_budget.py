import itertools

import pytest

from eitskin.pipeline.latency_budget import HOLD_FRAMES, LONGEST_HOLD, Ladder

SLOW, FAST, FAIR = 2_000_000, 100_000, 800_000
BUDGET = 1_000_000


def test_without_a_budget_nothing_is_given_up():
    ladder = Ladder(None, 3)
    assert not any(ladder.judge(10**12, inferred=True) for _ in range(10))
    assert ladder.level == ladder.overruns == 0


def test_overruns_go_down_in_order_and_are_counted():
    ladder = Ladder(BUDGET, 3)
    seen = []
    for _ in range(5):
        assert ladder.judge(SLOW, inferred=True)
        seen.append((ladder.engine, ladder.drops_stale))
    assert seen == [(1, False), (2, False), (2, True), (2, True), (2, True)]
    assert ladder.overruns == 5


def test_a_frame_within_budget_that_is_not_easy_holds_the_level():
    ladder = Ladder(BUDGET, 3)
    ladder.judge(SLOW, inferred=True)
    for _ in range(1000):
        assert not ladder.judge(FAIR, inferred=True)
    assert ladder.level == 1


def test_room_is_taken_back_step_by_step():
    ladder = Ladder(BUDGET, 3)
    for _ in range(3):
        ladder.judge(SLOW, inferred=True)
    levels = [ladder.level]
    for _ in range(4 * HOLD_FRAMES):
        ladder.judge(FAST, inferred=True)
        levels.append(ladder.level)
    assert [levels.index(level) for level in (3, 2, 1, 0)] == [0, HOLD_FRAMES, 2 * HOLD_FRAMES, 3 * HOLD_FRAMES]


def test_untouched_frames_say_nothing_about_the_room_for_a_slower_engine():
    ladder = Ladder(BUDGET, 3)
    ladder.judge(SLOW, inferred=True)
    for _ in range(10 * HOLD_FRAMES):
        ladder.judge(FAST, inferred=False)
    assert ladder.level == 1


def test_the_ladder_does_not_flutter_between_two_levels():
    ladder = Ladder(BUDGET, 3)
    # fp32 is always over budget, int8 is always easy
    overruns_at = [frame for frame in range(40_000) if ladder.judge(SLOW if ladder.level == 0 else FAST, inferred=True)]
    gaps = [after - before for before, after in itertools.pairwise(overruns_at)]
    assert gaps == sorted(gaps)
    assert gaps[-1] >= LONGEST_HOLD
    assert len(overruns_at) < 15


def test_a_budget_that_is_not_positive_is_refused():
    with pytest.raises(ValueError, match="-5"):
        Ladder(-5, 3)
