"""Under pressure a faster solver takes over, stale frames are dropped, and the best one comes back."""

import itertools
import time

import numpy as np
import pytest
from tests.runtime.made_up_skin import begin_touches

from eitskin.errors import BudgetError
from eitskin.pipeline.frame_pipeline import Pipeline
from eitskin.skin import Skin


def test_a_budget_below_the_fastest_solver_is_refused_with_its_time(tiny, hello):
    with pytest.raises(
        BudgetError, match=r"budget of 1e-06 ms cannot be met: the fastest solver, tikhonov, takes \d+\.\d+"
    ):
        Pipeline(tiny, hello, budget_ns=1)


ORDER = ["vd2t", "vd2t-int8", "tikhonov"]
"""Engines, from the most accurate to the fastest."""


def assert_one_level_down_at_each_overrun(frames):
    """One level at once, in the next frame; an untouched frame does not say which level it has."""
    for earlier, later in itertools.pairwise(frame for frame in frames if frame.touched):
        if "overrun" in earlier.events and later.number == earlier.number + 1:
            level = ORDER.index(earlier.solver)
            assert later.solver == ORDER[min(level + 1, len(ORDER) - 1)]


class Slow:
    """An engine that takes its time, as under load."""

    def __init__(self, engine, seconds):
        self.name, self.engine, self.seconds = engine.name, engine, seconds

    def infer(self):
        time.sleep(self.seconds)
        self.engine.infer()


def test_when_nothing_is_fast_enough_stale_frames_are_dropped_for_the_newest(virtual_skin, tiny_path):
    with (
        virtual_skin(touches=[[0.15, 60, 0.3]], touches_wait=True, rate_hz=100.0) as port,
        Skin(port, bundle=tiny_path, budget_ms=20.0) as skin,
    ):
        skin.capture_reference(5)
        begin_touches(port)
        skin.pipeline.engines[:] = [Slow(engine, 0.06) for engine in skin.pipeline.engines]
        frames = []
        for frame in skin.frames(timeout_s=120.0):
            if frame.touched:
                frames.append(frame)
            if len(frames) > 40 and skin.pipeline.intake.withheld["stale"] > 50:
                break
        stale = skin.pipeline.intake.withheld["stale"]
    assert_one_level_down_at_each_overrun(frames)
    levels = [ORDER.index(frame.solver) for frame in frames]
    assert levels == sorted(levels)
    assert levels[-1] == len(ORDER) - 1
    assert all("overrun" in frame.events for frame in frames)
    assert stale > 50  # they arrived and were not computed
    # Six frames come while one is computed: without dropping, the age would grow by 50 ms a frame
    assert np.median([frame.age_us for frame in frames[10:]]) < 500_000
