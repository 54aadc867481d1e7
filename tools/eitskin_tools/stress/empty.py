"""The empty scene: what each solver shows of a sheet that nothing touches, with the noise of an ordinary front end.

Classical images are scaled to maximum 1, so noise alone fills them; it is the gate that keeps them from being
published. The rows say how large the largest pixel is with the gate and without.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from eitskin_sim.noise import add_noise
from eitskin_tools.stress.rows import Row, rounded
from eitskin_tools.stress.samples import SEED, Sample
from eitskin_tools.stress.solvers import ENGINES, GATE, Subjects

SNR_DB: Final = 50.0
"""Of N2, an ordinary front end."""

SHOWN: Final = 0.5
"""A pixel above this is a touch."""


def empty_rows(subjects: Subjects, samples: Sequence[Sample]) -> list[Row]:
    """Return a row a solver."""
    rng = np.random.default_rng(SEED)
    bare = [sample.bare() for sample in samples]
    bare += [replace(sample, voltages=add_noise(sample.voltages, sample.flat, "N2", SNR_DB, rng)) for sample in bare]
    rows = []
    for name in subjects.names():
        if name == GATE:
            continue
        largest = [float(image.max()) for image in (subjects.image(name, s) for s in bare) if image is not None]
        gated: list[float] = []
        if name in ENGINES and subjects.gated is not None:
            shown = (subjects.gated.show(sample, ENGINES[name]) for sample in bare)
            gated = [float(image.max()) for image in shown if image is not None]
        text = f"largest pixel {max(largest):.3g} without the gate, in {sum(x > SHOWN for x in largest)} of "
        text += f"{len(largest)} frames above {SHOWN:g}"
        text += (
            f"; with it {max(gated):.3g}, in {sum(x > SHOWN for x in gated)}" if gated else "; it is never published"
        )
        scaled = name not in ("vd2t", "vd2t-int8")
        rows.append(
            {
                "sweep": "empty scene",
                "solver": name,
                "unit": "largest pixel",
                "unstressed": 0.0,
                "worst": rounded(max(largest)),
                "worst_gated": rounded(max(gated)) if gated else None,
                "frames": len(largest) + len(gated),
                "degrades_10pct_at": None,
                "breaks_at": None,
                "why": text + ("; its images are scaled to maximum 1, so noise alone fills them" if scaled else ""),
            }
        )
    return rows
