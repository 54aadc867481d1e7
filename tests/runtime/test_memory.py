"""Nothing grows: memory of a frame and of a long stream, and a slow subscriber's place in it."""

import tracemalloc
from itertools import pairwise

from eitskin.skin import Skin

from .made_up_skin import begin_touches


class Taker:
    """Takes every message and keeps none."""

    wanted = True

    def __init__(self, short):
        self.short = short

    def send(self, message):
        assert len(message) > 100


def test_a_frame_leaves_nothing_behind(virtual_skin, tiny_path):
    with (
        virtual_skin(touches=[[0.2, 60, 0.3]], touches_wait=True, rate_hz=200.0) as port,
        Skin(port, bundle=tiny_path, skip_unchanged=True) as skin,
    ):
        skin.capture_reference(10)
        begin_touches(port)
        sizes = [1 << 60] * 6  # the least of every hundred: what is in flight when the machine is busy comes on top
        tracemalloc.start(1)
        for number, _ in enumerate(skin.publish(Taker(short=True))):
            if number == 100 * len(sizes):
                break
            sizes[number // 100] = min(sizes[number // 100], tracemalloc.get_traced_memory()[0])
        tracemalloc.stop()
    grown = sorted(later - earlier for earlier, later in pairwise(sizes[2:]))  # the first hundreds fill caches
    # What every frame left behind would show in every hundred; what a pause of the machine brings along comes once.
    assert grown[1] < 1300, sizes


def test_what_a_frame_takes_for_a_moment_is_small(virtual_skin, tiny_path):
    peaks = []
    with (
        virtual_skin(touches=[[0.2, 60, 0.3]], touches_wait=True, rate_hz=200.0) as port,
        Skin(port, bundle=tiny_path) as skin,
    ):
        skin.capture_reference(10)
        begin_touches(port)
        tracemalloc.start(1)
        for _ in skin.publish(Taker(short=False)):
            if skin.statistics.frames > 100:
                now, peak = tracemalloc.get_traced_memory()
                peaks.append(peak - now)
                tracemalloc.reset_peak()
            if len(peaks) == 100:
                break
        tracemalloc.stop()
    # New each time are the bytes read from the line (up to 4 kB a read, split and decoded) and, in a frame far from its
    # reference, its counts as a list and a set of numbers: 12 kB. A map would add 5400.
    assert sorted(peaks)[50] < 17_000, sorted(peaks)[::10]
