"""Under pressure a faster solver takes over, stale frames are dropped, and the best one comes back."""

import itertools
import threading
import time

import numpy as np
import pytest

from eitskin.errors import BudgetError
from eitskin.model.geometry import GeometryGraph
from eitskin.pipeline import latency_budget
from eitskin.pipeline.frame_pipeline import Pipeline
from eitskin.reference.captured import Reference
from eitskin.skin import Skin

from .passing import go, payload


def test_a_budget_below_the_fastest_solver_is_refused_with_its_time(tiny, hello):
    with pytest.raises(
        BudgetError, match=r"budget of 1e-06 ms cannot be met: the fastest solver, tikhonov, takes 0\.\d+"
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


def test_under_pressure_a_faster_solver_takes_over_and_gives_back(virtual_skin, tiny_path, monkeypatch):
    monkeypatch.setattr(latency_budget, "HOLD_FRAMES", 10)
    with (
        virtual_skin(touches=[[0.15, 60, 0.3]], rate_hz=50.0) as port,
        Skin(port, bundle=tiny_path, budget_ms=200.0) as skin,
    ):
        skin.capture_reference(5)
        engines = skin.pipeline.engines
        fast, engines[0] = engines[0], Slow(engines[0], 0.3)
        frames, loaded = [], True
        for frame in skin.frames(timeout_s=120.0):
            if not loaded and frame.solver == "vd2t":
                break
            frames.append(frame)
            if frame.solver == "vd2t":
                engines[0], loaded = fast, False  # the load is over
        overruns = frame.counts["overrun"] - ("overrun" in frame.events)
    assert not loaded
    assert frame.solver == "vd2t"
    assert overruns == sum("overrun" in frame.events for frame in frames)
    assert_one_level_down_at_each_overrun(frames)
    slow = next(index for index, frame in enumerate(frames) if frame.solver == "vd2t")
    assert "overrun" in frames[slow].events
    assert "vd2t" not in [frame.solver for frame in frames[slow + 1 :]]
    assert len(frames) - slow > latency_budget.HOLD_FRAMES  # what is taken back is held for a while first


def test_when_nothing_is_fast_enough_stale_frames_are_dropped_for_the_newest(virtual_skin, tiny_path):
    with (
        virtual_skin(touches=[[0.15, 60, 0.3]], rate_hz=100.0) as port,
        Skin(port, bundle=tiny_path, budget_ms=20.0) as skin,
    ):
        skin.capture_reference(5)
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


@pytest.mark.slow  # its threads compute for as long as the machine takes to be overrun
@pytest.mark.parametrize("budget_ms", [8.0, 4.0])
def test_real_engines_under_load_give_way_to_faster_ones_and_come_back(virtual_skin, tiny_path, monkeypatch, budget_ms):
    # The load is threads that hold the interpreter for 5 ms in turn whenever an engine has let go of it. Other
    # processes would not do: the kernel lets a loop that mostly sleeps go first, however busy the processor is.
    monkeypatch.setattr(latency_budget, "HOLD_FRAMES", 3)
    loaded = threading.Event()
    loaded.set()

    def burn():
        while loaded.is_set():
            pass

    burners = [threading.Thread(target=burn) for _ in range(3)]
    with (
        virtual_skin(touches=[[0.15, 60, 0.3]], rate_hz=50.0) as port,
        Skin(port, bundle=tiny_path, budget_ms=budget_ms) as skin,
    ):
        skin.capture_reference(5)
        for burner in burners:
            burner.start()
        frames, under_load, rose = [], [], False
        try:
            for frame in skin.frames(timeout_s=120.0):
                if not frame.touched:
                    continue
                if loaded.is_set():
                    under_load.append(frame.solver)
                    if frame.solver == ORDER[-1]:  # untouched frames overrun too, so the first touched one may be down
                        loaded.clear()
                elif ORDER.index(frame.solver) < ORDER.index(frames[-1].solver):
                    rose = True
                frames.append(frame)
                if rose:
                    break
        finally:
            loaded.clear()
            for burner in burners:
                burner.join()
    assert under_load
    assert under_load[-1] == ORDER[-1]
    assert rose
    assert frames[-1].counts["overrun"] >= 2
    assert_one_level_down_at_each_overrun(frames)


@pytest.mark.parametrize("solver", ORDER)
def test_every_real_engine_takes_less_processor_time_than_a_budget_of_4_ms(tiny, hello, counts, solver):
    pipeline = Pipeline(tiny, hello, solver=solver)
    pipeline.use_reference(Reference(counts * 1e-9, counts * 0.0, 2, "TEST-1", 0xABCD, "paper", ""))
    pipeline.start_with(GeometryGraph(tiny).geometry(None, None, 0))
    touched = np.rint(counts * (1 + 0.3 * np.cos(np.arange(104)))).astype(np.int32)
    spent_ns = []
    for sequence in range(1, 101):
        packed, before_ns = payload(touched, sequence), time.process_time_ns()
        assert go(pipeline, packed)
        spent_ns.append(time.process_time_ns() - before_ns)
        assert pipeline.record.solver == solver
    assert np.median(spent_ns) < 4e6  # waiting for the processor does not count
