"""Whole frames of a device as volts, for as long as it streams."""

import time
from collections.abc import Iterator
from typing import Any, Final

import numpy as np
import numpy.typing as npt

PATIENCE_S: Final = 10.0
"""Without a whole frame for so long, the line is taken for silent."""


def frames_of(device: Any) -> Iterator[npt.NDArray[np.float64]]:
    """Yield (104,) V of every whole frame that is fit; end when none comes.

    Args:
        device: It streams.
    """
    from eitskin.acquisition.capture import whole_frames
    from eitskin.reference.front_end import stuck
    from eitskin.reference.normaliser import Normaliser

    normaliser = Normaliser(device.hello.volts_per_count)
    came = True
    while came:
        came = False
        for view in whole_frames(device, time.perf_counter() + PATIENCE_S):
            came = True
            normaliser.load(view.counts)
            if not view.saturation and not stuck(normaliser.counts):
                yield normaliser.voltages().copy()
