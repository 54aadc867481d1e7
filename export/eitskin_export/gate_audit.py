"""When a map may overrule the gate: at more touched pixels than the network ever shows of an untouched sheet.

The runtime infers one in fifty of the frames that the gate calls untouched (:mod:`eitskin.pipeline.frame_pipeline`). A
network shows ghosts now and then, most of all of a bent sheet without a cloud; so the number of pixels above one half
that counts as a strong touch is taken from untouched sheets at bends that neither network nor gate learned from, twice
their largest.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin.pipeline.frame_pipeline import STRONG_VALUE
from eitskin_export import parity
from eitskin_proto.skin.cloud import network_input
from eitskin_proto.skin.grid import Grid
from eitskin_training.gate.material import noisy_change

FEWEST_MM2: Final = 100.0
"""10 mm square: the least that counts as a strong touch, however quiet the network is."""

MARGIN: Final = 2
"""Times the largest ghost."""

Array = npt.NDArray[np.float64]


def audit_pixels(geometry: bytes, head: bytes, bends: Array, reference: Array, grid: Grid, frames: int = 400) -> int:
    """Return how many pixels above one half make a strong touch.

    Args:
        geometry: The geometry graph.
        head: The head.
        bends: (n, 104) log(V / V0) of untouched sheets that nothing learned from.
        reference: (104,) V0.
        grid: Of the map.
        frames: How many are looked at, with the cloud of the flat sheet and no prediction.
    """
    rng = np.random.default_rng(0xA0D17)
    dv = noisy_change(bends[rng.integers(len(bends), size=frames)], reference, rng).astype(np.float32)
    flat = np.repeat(network_input(grid.flat_cloud_mm(), grid)[np.newaxis], frames, axis=0)
    maps = parity.run_graphs(geometry, head, dv, flat, np.zeros_like(dv))["map"]
    largest = int(np.count_nonzero(maps > STRONG_VALUE, axis=1).max())
    return min(max(round(FEWEST_MM2 / grid.pixel_mm2), 1, MARGIN * largest), grid.n_pixels)
