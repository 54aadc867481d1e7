"""Whole frames of a device as volts, for as long as it streams."""

import time
from collections.abc import Iterator
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin_tools.guided.guide import GuideError

PATIENCE_S: Final = 10.0
"""Without a whole frame for so long, the line is taken for silent."""

UNFIT: Final = 100
"""Frames in a row that cannot be used: then none will come."""


def frames_of(device: Any) -> Iterator[npt.NDArray[np.float64]]:
    """Yield the V of every whole frame that is fit, (208,) of a device that scans all rows, else (104,).

    It ends when none comes.

    Args:
        device: It streams.

    Raises:
        GuideError: ``UNFIT`` frames in a row cannot be used.
    """
    from eitskin.acquisition.capture import whole_frames
    from eitskin.reference.front_end import stuck
    from eitskin.reference.normaliser import Normaliser

    normaliser = Normaliser(device.hello.volts_per_count)
    came, unfit = True, 0
    while came:
        came = False
        for view in whole_frames(device, time.perf_counter() + PATIENCE_S):
            came = True
            normaliser.load(view.counts)
            reason = "rows are cut off" if view.saturation else stuck(normaliser.counts)
            unfit = unfit + 1 if reason else 0
            if unfit >= UNFIT:
                raise GuideError(
                    f"the last {unfit} frames cannot be used: {reason}; check the current and the gain of the "
                    "configuration with 'eitskin flash'"
                )
            if not reason:  # not the normaliser's, which averages a row and its reciprocal
                yield view.counts * device.hello.volts_per_count
