"""The two scenes without contrast: a sheet that nothing touches, and one that is touched everywhere.

Their truth is constant, so a correlation says nothing, and the rows have the maps' own values instead.

Classical images are scaled to maximum 1, so noise alone fills them; it is the gate that keeps them from being
published. The rows say how large the largest pixel is with the gate and without.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from eitskin_sim.measurement.noise import add_noise
from eitskin_tools.bench.stability.harness.rows import Row, rounded
from eitskin_tools.bench.stability.harness.samples import SEED, Sample
from eitskin_tools.bench.stability.harness.solvers import ENGINES, GATE, Subjects
from eitskin_tools.bench.stability.sweeps.shape import whole

SNR_DB: Final = 50.0
"""Of N2, an ordinary front end."""

SHOWN: Final = 0.5
"""A pixel above this is a touch."""


def constant_rows(subjects: Subjects, samples: Sequence[Sample]) -> list[Row]:
    """Return a row a solver for the empty scene, and one for the whole sheet touched."""
    return _empty_rows(subjects, samples) + _whole_rows(subjects, samples)


def _empty_rows(subjects: Subjects, samples: Sequence[Sample]) -> list[Row]:
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
        scaled = name not in ("vd2t", "vd2t-int8", "vd2t-small")
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


def _whole_rows(subjects: Subjects, samples: Sequence[Sample]) -> list[Row]:
    touched = [whole(sample) for sample in samples]
    kept = float(np.median([np.abs(s.voltages / s.sheet.untouched) for s in touched]))
    rows = []
    for name in subjects.names():
        if name == GATE:
            continue
        images = [image for image in (subjects.image(name, sample) for sample in touched) if image is not None]
        share = float(np.mean([image > SHOWN for image in images])) if images else 0.0
        rows.append(
            {
                "sweep": "whole sheet touched",
                "solver": name,
                "unit": "share of pixels shown as touched",
                "unstressed": 1.0,
                "worst": rounded(share),
                "frames": len(images),
                "degrades_10pct_at": None,
                "breaks_at": None,
                "why": f"shown as touched: {share:.3g} of the pixels, {len(samples) - len(images)} frames withheld; "
                f"all voltages fall alike (median V / V_post {kept:.2g}), like a better sheet's, without an edge",
            }
        )
    return rows
