"""What a front end does wrong: gain and offset errors of every row, cut-off, rows that fade, wires that are swapped.

An error that was there when the reference was taken and one that came since are different things: a gain that both
share cancels in V / V0, an offset that both share does not.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.normalise import WEAK_FRACTION, relative_change
from eitskin_sim.measurement.noise import add_noise
from eitskin_tools.bench.stability.harness.limits import explain_noise
from eitskin_tools.bench.stability.harness.samples import Disturb, Sample
from eitskin_tools.bench.stability.harness.sweep import Stress
from eitskin_tools.bench.stability.sweeps.noise import PUBLISHED, spread_of

Array = npt.NDArray[np.float64]

GAINS: Final = (1e-4, 3e-4, 1e-3, 3e-3, 0.01, 0.03, 0.1, 0.3)
OFFSETS: Final = (1e-7, 1e-6, 1e-5, 1e-4, 3e-4, 1e-3, 3e-3, 0.01, 0.03)
CUT_OFF: Final = (2.0, 1.5, 1.2, 1.0, 0.8, 0.5, 0.3, 0.1, 0.03, 0.01)
FADING: Final = (1.0, 0.1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-8)
FLIPS: Final = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0)

HELD: Final = 20
"""Frames within which a failure is named."""

FADED_ROWS: Final = 8
"""The weakest of the 104 rows that fade together."""

HARDWARE_DB: Final = 60.0
"""Of N3, on frames with fading rows: without any noise the smallest voltage would still divide exactly."""


def stresses() -> list[Stress]:
    """Return the disturbances of the front end."""
    per_row = "relative, rms"
    rules: tuple[tuple[str, Disturb, tuple[str, ...] | None], ...] = (
        ("weighed by spread", _faded, PUBLISHED),
        ("give 0", _faded_as(relative_change), None),
        ("no rule", _faded_as(_divided), None),
        ("floor under the divisor", _faded_as(_floored), None),
    )
    fading = [
        Stress(f"{FADED_ROWS} weakest rows fade, {rule}", "times", FADING, disturb, _explain_fading, True, 1.0,
               random=True, solvers=solvers)
        for rule, disturb, solvers in rules
    ]  # fmt: skip
    return [
        Stress("gain error, reference too", per_row, GAINS, _gain_always, _explain_common, True, random=True),
        Stress("gain error since the reference", per_row, GAINS, _gain_since, _explain_gain, True, random=True),
        Stress("offset, reference too", "of largest |V0|", OFFSETS, _offset_always, _explain_offset, True, random=True),
        Stress(
            "offset since the reference", "of largest |V0|", OFFSETS, _offset_since, _explain_offset, True, random=True
        ),
        Stress("saturation", "full scale / largest |V0|", CUT_OFF, _cut_off, _explain_cut_off, True),
        *fading,
        Stress("sign flips since the reference", "rows", FLIPS, _flipped, _explain_flips, True, random=True),
        Stress(f"sign flips, {HELD} frames later", "rows", FLIPS, _flipped_for_a_while, _explain_flips, True,
               random=True, solvers=PUBLISHED),
    ]  # fmt: skip


def _with_reference(sample: Sample, change: Callable[[Array], Array]) -> Sample:
    """Return a sample whose frames and references all pass the same distortion."""
    return replace(
        sample,
        voltages=change(sample.voltages),
        flat=change(sample.flat),
        sheet=replace(sample.sheet, untouched=change(sample.sheet.untouched)),
    )


def _gain_always(sample: Sample, size: float, rng: np.random.Generator) -> Sample:
    gain = 1.0 + size * rng.standard_normal(len(sample.flat))
    return _with_reference(sample, lambda volts: volts * gain)


def _explain_common(samples: Sequence[Sample], size: float) -> str:
    rng = np.random.default_rng(0)
    gain = 1.0 + size * rng.standard_normal(104)
    apart = [relative_change(s.voltages * gain, s.flat * gain) - relative_change(s.voltages, s.flat) for s in samples]
    return f"a gain that reference and frame share leaves dV within {np.abs(apart).max():.1e}"


def _gain_since(sample: Sample, size: float, rng: np.random.Generator) -> Sample:
    return replace(sample, voltages=sample.voltages * (1.0 + size * rng.standard_normal(len(sample.flat))))


def _explain_gain(samples: Sequence[Sample], size: float) -> str:
    text = explain_noise(samples, lambda s: size * np.abs(s.voltages))
    return f"a gain that wanders by {size:.3g} is N2 at {-20 * np.log10(size):.3g} dB: {text}"


def _offset(sample: Sample, size: float, rng: np.random.Generator) -> Array:
    return np.asarray(size * np.abs(sample.flat).max() * rng.standard_normal(len(sample.flat)))


def _offset_always(sample: Sample, size: float, rng: np.random.Generator) -> Sample:
    offset = _offset(sample, size, rng)
    return _with_reference(sample, lambda volts: volts + offset)


def _offset_since(sample: Sample, size: float, rng: np.random.Generator) -> Sample:
    return replace(sample, voltages=sample.voltages + _offset(sample, size, rng))


def _explain_offset(samples: Sequence[Sample], size: float) -> str:
    flat = np.abs(samples[0].flat)
    least, beaten = flat.min() / flat.max(), np.count_nonzero(flat < size * flat.max())
    return (
        f"the smallest |V0| is {least:.2g} of the largest, and {beaten} of 104 rows are smaller than an offset of "
        f"{size:.2g}: their divisor is mostly offset"
    )


def _cut_off(sample: Sample, scale: float, rng: np.random.Generator) -> Sample:
    return replace(sample, full_scale_V=scale * float(np.abs(sample.flat).max()))


def _explain_cut_off(samples: Sequence[Sample], scale: float) -> str:
    cut = [np.count_nonzero(np.abs(s.voltages) > scale * np.abs(s.flat).max()) for s in samples]
    return f"{np.median(cut):.0f} of 104 rows are cut off, and read a change that is none; each such frame says so"


def _weakest(sample: Sample) -> npt.NDArray[np.intp]:
    return np.argsort(np.abs(sample.flat))[:FADED_ROWS]


def _faded(sample: Sample, factor: float, rng: np.random.Generator) -> Sample:
    """Let the weakest rows fade, reference included, under noise that does not fade with them, and which it knows."""
    scale = np.ones(len(sample.flat))
    scale[_weakest(sample)] = factor
    sheet = replace(sample.sheet, untouched=sample.sheet.untouched * scale)
    noisy = add_noise(sample.voltages * scale, sample.flat, "N3", HARDWARE_DB, rng)
    spread = spread_of(replace(sample, flat=sample.flat * scale), "N3", HARDWARE_DB)
    return replace(sample, voltages=noisy, flat=sample.flat * scale, sheet=sheet, spread=spread)


def _divided(volts: Array, reference: Array) -> Array:
    return np.asarray(volts / reference - 1.0)


def _floored(volts: Array, reference: Array) -> Array:
    floor = WEAK_FRACTION * np.abs(reference).max()
    return np.asarray((volts - reference) / np.copysign(np.maximum(np.abs(reference), floor), reference))


def _faded_as(change: Callable[[Array, Array], Array]) -> Disturb:
    """The same with another normalisation: its dV is carried over to the reference that did not fade."""

    def disturb(sample: Sample, factor: float, rng: np.random.Generator) -> Sample:
        faded = _faded(sample, factor, rng)
        volts = sample.flat * (1.0 + change(faded.voltages, faded.flat))
        # Classical solvers divide by the bent sheet's untouched voltages: choose those that give them their own dV.
        post = volts / (1.0 + change(faded.voltages, faded.sheet.untouched))
        return replace(sample, voltages=volts, sheet=replace(sample.sheet, untouched=post), spread=None)

    return disturb


def _explain_fading(samples: Sequence[Sample], factor: float) -> str:
    sample = samples[0]
    rows = np.abs(sample.flat[_weakest(sample)])
    noise = 10.0 ** (-HARDWARE_DB / 20.0) * np.sqrt(np.mean(sample.voltages**2))
    weak = np.count_nonzero(factor * rows < WEAK_FRACTION * np.abs(sample.flat).max())
    return (
        f"noise of {HARDWARE_DB:g} dB (N3) is {noise / (factor * rows.mean()):.3g} times the faded rows' |V0|; "
        f"{weak} of {FADED_ROWS} are under {WEAK_FRACTION:g} of the largest"
    )


def _flipped(sample: Sample, rows: float, rng: np.random.Generator) -> Sample:
    which = rng.permutation(len(sample.flat))[: int(rows)]
    volts = sample.voltages.copy()
    volts[which] *= -1.0
    return replace(sample, voltages=volts)


def _flipped_for_a_while(sample: Sample, rows: float, rng: np.random.Generator) -> Sample:
    """The same, once the runtime has had time to leave out the electrode to which such rows belong."""
    return replace(_flipped(sample, rows, rng), held=HELD)


def _explain_flips(samples: Sequence[Sample], rows: float) -> str:
    turned = np.median([np.sqrt(np.mean((-2.0 * s.voltages / s.flat) ** 2)) for s in samples])
    both = max(
        float(np.abs(relative_change(-s.voltages, -s.flat) - relative_change(s.voltages, s.flat)).max())
        for s in samples
    )
    return (
        f"a turned row reads dV - 2 V / V0, an error of {turned:.3g} rms in {rows:.0f} of 104 rows, which no touch can "
        f"make; turned in the reference too it changes dV by {both:.1g}"
    )
