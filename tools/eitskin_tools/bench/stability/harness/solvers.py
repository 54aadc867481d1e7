"""Everything that is put under stress: the network and its int8 twin, the projection, classical solvers, the gate.

The first three run in the pipeline, ungated, so that each frame shows a map; the gate runs in a pipeline of its own
and is judged by its verdicts on touched and untouched sheets. Classical solvers run where they run in
``eitskin evaluate``, with the post-deformation reference.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin.model.bundle import Bundle
from eitskin_sim.evaluation.harness import SOLVERS
from eitskin_sim.evaluation.metrics import correlation
from eitskin_tools.bench.stability.harness.samples import Labels, Sample
from eitskin_tools.bench.stability.harness.stream import Stream
from eitskin_tools.bench.stability.harness.tally import Tally

Array = npt.NDArray[np.float64]

ENGINES: Final = {"vd2t": "vd2t", "vd2t-int8": "vd2t-int8", "vd2t-small": "vd2t-small", "projection": "tikhonov"}
"""What is published: this table's name -> the runtime's."""

CLASSICAL: Final = {"tikhonov": "tikhonov", "l1": "l1", "sbl": "sbl"}
"""Solvers of ``eitskin evaluate``, on the units that unit labels name."""

GATE: Final = "gate"
"""Touched or not; right on the touched sheets and on their untouched twins."""


class Subjects:
    """The solvers of one bundle.

    Args:
        bundle: Network and gate.
        tally: Counts what is published.
    """

    def __init__(self, bundle: Bundle, tally: Tally) -> None:
        self.labels: Labels = "units" if bundle.labels == "units" else "area"
        self.bundle, self.tally = bundle, tally
        self.plain = Stream(bundle, tally, gated=False)
        self.gated = Stream(bundle, tally, gated=True) if bundle.gate_arrays() is not None else None
        self._calm: dict[tuple[str, int], tuple[Sample, Array | None]] = {}

    def names(self) -> list[str]:
        """Return every solver; classical ones for unit labels only, whose 126 cells they solve in milliseconds."""
        found = [name for name, engine in ENGINES.items() if engine in self.plain.engines]
        found += list(CLASSICAL) if self.labels == "units" else []
        return found + ([GATE] if self.gated else [])

    def image(self, name: str, sample: Sample) -> Array | None:
        """Return a solver's (30, 45) map, None where the frame was withheld or the solver gave up."""
        if name in ENGINES:
            return self.plain.show(sample, ENGINES[name])
        try:
            found = np.asarray(SOLVERS[CLASSICAL[name]](sample.case()), dtype=np.float64)
        except (ValueError, np.linalg.LinAlgError) as error:  # it says that it cannot; anything else is a defect
            self.tally.refused[f"{name}: {type(error).__name__}"] += 1
            return None
        self.tally.take(found)
        return found

    def calm(self, name: str, sample: Sample) -> Array | None:
        """Return a solver's map of an undisturbed sample, made once: every sweep begins with the same ones."""
        key = name, id(sample)
        if key not in self._calm:
            self._calm[key] = sample, self.image(name, sample)  # the sample is kept, and so is its id
        return self._calm[key][1]

    def verdicts(self, touched: Sequence[Sample], bare: Sequence[Sample]) -> tuple[list[bool], int]:
        """Return whether the gate was right on each of the shown frames, and how many were withheld."""
        assert self.gated is not None
        right, withheld = [], 0
        for group, expected in ((touched, True), (bare, False)):
            for sample in group:
                if self.gated.show(sample) is None:
                    withheld += 1
                else:
                    right.append(self.gated.touched is expected)
        return right, withheld


def accuracy(image: Array | None, sample: Sample) -> float:
    """Return a map's correlation with the truth; 0 for a map that was not shown."""
    return 0.0 if image is None else correlation(image, sample.truth)
