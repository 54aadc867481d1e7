"""Noise in its three definitions, and the converter's bits, which are a fourth.

The reference is of the same front end, so its frames vary by the same noise, and rows are weighed by that
(:mod:`eitskin.reference.row_noise`). N1 is noise of what a touch changes, of which a reference has none. What the
weighing is worth is shown by the same sweep once more with a reference that does not say how much it varied.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from eitskin_sim.measurement.noise import add_noise
from eitskin_tools.bench.stability.harness.limits import explain_noise, rms
from eitskin_tools.bench.stability.harness.samples import Disturb, Sample
from eitskin_tools.bench.stability.harness.solvers import ENGINES, GATE
from eitskin_tools.bench.stability.harness.sweep import Stress

Array = npt.NDArray[np.float64]
Kind = Literal["N1", "N2", "N3"]

SNR_DB: Final = (80.0, 70.0, 60.0, 50.0, 45.0, 40.0, 35.0, 30.0, 25.0, 20.0)
BITS: Final = (24.0, 22.0, 20.0, 18.0, 16.0, 14.0, 12.0, 10.0)

PUBLISHED: Final = (*ENGINES, GATE)
"""What runs in the runtime, where rows are weighed."""

HEADROOM: Final = 2.0
"""Full scale of the converter over the largest voltage of the reference: a bend must fit."""


def stresses() -> list[Stress]:
    """Return noise N1, N2, N3 from 80 to 20 dB and converters of 24 to 10 bits."""
    found = [
        Stress(f"noise {kind}", "dB", SNR_DB, _noisy(kind), partial(_explain, kind), random=True)
        for kind in ("N1", "N2", "N3")
    ]
    unsaid = _noisy("N3", said=False)
    found.append(
        Stress("noise N3, rows not weighed", "dB", SNR_DB, unsaid, partial(_explain, "N3"), random=True,
               solvers=PUBLISHED)
    )  # fmt: skip
    return [*found, Stress("converter", "bits", BITS, _converted, _explain_bits)]


def _noisy(kind: Kind, *, said: bool = True) -> Disturb:
    def disturb(sample: Sample, snr_db: float, rng: np.random.Generator) -> Sample:
        voltages = add_noise(sample.voltages, sample.flat, kind, snr_db, rng)
        spread = spread_of(sample, kind, snr_db) if said and kind != "N1" else None
        return replace(sample, voltages=voltages, spread=spread)

    return disturb


def spread_of(sample: Sample, kind: Kind, snr_db: float) -> Array:
    """Return (104,) V by which frames of the flat sheet vary under noise N2 or N3."""
    return _spread(kind, 10.0 ** (-snr_db / 20.0))(replace(sample, voltages=sample.flat))


def _explain(kind: Kind, samples: Sequence[Sample], snr_db: float) -> str:
    return f"at {snr_db:.3g} dB " + explain_noise(samples, _spread(kind, 10.0 ** (-snr_db / 20.0)))


def _spread(kind: Kind, level: float) -> Callable[[Sample], Array]:
    """Standard deviation of each row in V, by the definition of :mod:`eitskin_sim.measurement.noise`."""

    def spread(sample: Sample) -> Array:
        if kind == "N1":
            return np.asarray(level * rms(sample.voltages / sample.flat - 1.0) * np.abs(sample.flat))
        if kind == "N2":
            return np.asarray(level * np.abs(sample.voltages))
        return np.full_like(sample.voltages, level * rms(sample.voltages))

    return spread


def _step(sample: Sample, bits: float) -> float:
    """Volts a count, of a converter whose full scale is twice the largest reference."""
    return float(2.0 * HEADROOM * np.abs(sample.flat).max() / 2.0**bits)


def _converted(sample: Sample, bits: float, rng: np.random.Generator) -> Sample:
    step = _step(sample, bits)
    spread = np.full_like(sample.flat, step / np.sqrt(12.0))
    return replace(sample, voltages=step * np.rint(sample.voltages / step), spread=spread)


def _explain_bits(samples: Sequence[Sample], bits: float) -> str:
    steps = np.median([_step(sample, bits) / np.sqrt(12.0) / rms(sample.voltages) for sample in samples])
    below = np.median([np.count_nonzero(np.abs(s.flat) < _step(s, bits)) for s in samples])
    return (
        f"at {bits:.3g} bits the step's noise equals N3 at {-20 * np.log10(steps):.3g} dB, and {below:.0f} reference "
        "rows are below one count; "
        + explain_noise(samples, lambda s: np.full_like(s.voltages, _step(s, bits) / np.sqrt(12.0)))
    )
