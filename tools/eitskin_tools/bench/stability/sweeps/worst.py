"""The worst input for the int8 head that a search can find among inputs that a front end can deliver.

From each real scene a search goes up hill: every voltage may be off by three standard deviations of 50 dB noise (N2),
a box in which the sharpest difference between the int8 and the float32 map is looked for. Steps push a random tenth
of the rows to the other side of the box and are kept if the difference grows. A rigorous bound through the layers says
only 1, since every layer's rounding may add up; what is stated is what a search of so many steps reaches.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.normalise import relative_change
from eitskin_sim.evaluation.metrics import correlation
from eitskin_tools.bench.stability.harness.rows import Row, rounded
from eitskin_tools.bench.stability.harness.samples import SEED, Sample
from eitskin_tools.bench.stability.harness.stream import Stream

Array = npt.NDArray[np.float64]

BOX: Final = 3.0 * 10.0 ** (-50.0 / 20.0)
"""Largest relative error of a voltage: three standard deviations of 50 dB."""

MOVED: Final = 0.1
"""Share of the rows that a step moves."""


class Heads:
    """Both heads on the same inputs.

    Args:
        stream: Ungated; its buffers are written.
    """

    def __init__(self, stream: Stream) -> None:
        self.stream = stream
        self.evaluations = 0

    def maps(self, change: Array) -> tuple[Array, Array]:
        """Return the float32 and the int8 map (1350,) of dV (104,)."""
        found = []
        buffers = self.stream.pipeline.buffers
        for name in ("vd2t", "vd2t-int8"):
            buffers.change[0] = change
            self.stream.engine(name).infer()
            self.stream.tally.take(buffers.map)
            found.append(np.array(buffers.map[0], dtype=np.float64))
        self.evaluations += 1
        return found[0], found[1]

    def apart(self, change: Array) -> float:
        """Return the largest difference of the two maps."""
        exact, quick = self.maps(change)
        return float(np.abs(exact - quick).max())


def worst_row(stream: Stream, samples: Sequence[Sample], steps: int) -> Row:
    """Return the row of the search.

    Args:
        stream: Ungated, with an int8 head.
        samples: Real scenes to start from.
        steps: Evaluations from each.
    """
    heads = Heads(stream)
    rng = np.random.default_rng(SEED)
    plain, drawn, climbed, alike = [], [], [], []
    for sample in samples:
        stream.show(sample)  # loads the sample's cloud
        ratio = 1.0 + relative_change(sample.read, sample.flat)
        plain.append(heads.apart(ratio - 1.0))
        drawn.append(
            max(heads.apart(ratio * (1.0 + rng.uniform(-BOX, BOX, len(ratio))) - 1.0) for _ in range(steps // 4))
        )
        worst, sign = _climb(heads, ratio, rng, steps)
        climbed.append(worst)
        alike.append(correlation(*heads.maps(ratio * (1.0 + BOX * sign) - 1.0)))
    return {
        "sweep": "int8 head: worst input in a box of noise",
        "solver": "vd2t-int8",
        "unit": "map",
        "from": 0.0,
        "to": rounded(BOX),
        "unstressed": rounded(max(plain)),
        "worst": rounded(max(climbed)),
        "random_worst": rounded(max(drawn)),
        "cc_of_the_two_maps_at_the_worst": rounded(min(alike)),
        "evaluations": heads.evaluations,
        "degrades_10pct_at": None,
        "breaks_at": None,
        "break_rule": "correlation of the int8 map with the float32 map under half",
        "why": (
            f"max |int8 - float32|: {max(plain):.3g} on real scenes, {max(drawn):.3g} on {steps // 4} random points of "
            f"each box, {max(climbed):.3g} after {steps} steps up hill; there the maps correlate by {min(alike):.4f}"
        ),
    }


def _climb(heads: Heads, ratio: Array, rng: np.random.Generator, steps: int) -> tuple[float, Array]:
    """Return the largest difference found and the (104,) corner of the box, +1 or -1 a row, where it is."""
    sign = np.sign(rng.standard_normal(len(ratio)))
    best = heads.apart(ratio * (1.0 + BOX * sign) - 1.0)
    for _ in range(steps):
        other = np.where(rng.random(len(ratio)) < MOVED, -sign, sign)
        value = heads.apart(ratio * (1.0 + BOX * other) - 1.0)
        if value > best:
            best, sign = value, other
    return best, sign
