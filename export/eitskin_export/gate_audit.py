"""When a map may overrule the gate: at more touched pixels than the network ever shows of an untouched sheet.

The runtime infers one in fifty of the frames that the gate calls untouched (:mod:`eitskin.pipeline.gate_audit`). A
network shows ghosts now and then, most of all of a bent sheet without a cloud; so the number of pixels above one half
that counts as a strong touch is taken from untouched sheets at bends that neither network nor gate learned from, twice
their largest.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin.pipeline.gate_audit import STRONG_VALUE
from eitskin_export import parity
from eitskin_proto.sensor.grid import N_PIXELS
from eitskin_proto.skin.cloud import flat_cloud, network_input
from eitskin_training.gate.material import noisy_change

FEWEST_PIXELS: Final = 9
"""10 mm square: the least that counts as a strong touch, however quiet the network is."""

MARGIN: Final = 2
"""Times the largest ghost."""

Array = npt.NDArray[np.float64]


def audit_pixels(geometry: bytes, head: bytes, bends: Array, reference: Array, frames: int = 400) -> int:
    """Return how many pixels above one half make a strong touch.

    Args:
        geometry: The geometry graph.
        head: The head.
        bends: (n, 104) log(V / V0) of untouched sheets that nothing learned from.
        reference: (104,) V0.
        frames: How many are looked at, with the cloud of the flat sheet and no prediction.
    """
    rng = np.random.default_rng(0xA0D17)
    dv = noisy_change(bends[rng.integers(len(bends), size=frames)], reference, rng).astype(np.float32)
    flat = np.repeat(network_input(flat_cloud())[np.newaxis], frames, axis=0)
    maps = parity.run_graphs(geometry, head, dv, flat, np.zeros_like(dv))["map"]
    largest = int(np.count_nonzero(maps > STRONG_VALUE, axis=1).max())
    return min(max(FEWEST_PIXELS, MARGIN * largest), N_PIXELS)
