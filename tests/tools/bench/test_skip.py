"""``bench skip``: what is timed are frames that the runtime publishes."""

import numpy as np

from eitskin.model.bundle import default_path, load_bundle
from eitskin_tools.bench.skip import FrameRunner, Material


def test_no_frame_is_withheld_because_it_repeats():
    shown = Material.of(np.random.default_rng(0), 300)
    runner = FrameRunner(shown.frames, shown.frames.pipeline(load_bundle(default_path("area"))), shown.one_V)
    runner()
    for index in range(1, 300):
        runner.prepare(index)
        assert runner()
