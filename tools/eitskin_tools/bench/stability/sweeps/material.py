"""The sheet itself changes: it dries or warms, unevenly too; contacts age; touches conduct more or less than foreseen.

All of it after the reference was taken, and all of it solved anew. Classical solvers keep the post-deformation
reference of the sheet as it was.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache, partial
from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_sim.fem.borders.cut_elements import touch
from eitskin_sim.fem.forward import Factor
from eitskin_sim.scene.parts import Scene, Touch
from eitskin_sim.scene.shapes import Rect
from eitskin_sim.solvers.operators import SATURATED
from eitskin_tools.bench.stability.harness.limits import explain_change
from eitskin_tools.bench.stability.harness.samples import Disturb, Sample, system_of, voltages_of
from eitskin_tools.bench.stability.harness.sweep import Explain, Stress

Array = npt.NDArray[np.float64]

DRIFT: Final = (0.0, 0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5)
WORSE: Final = (1.0, 10.0, 100.0, 1000.0)
BETTER: Final = (1.0, 0.5, 0.2, 0.1)
HIGHER: Final = (50.0, 100.0, 1e3, 1e4, 1e5, 1e6)
LOWER: Final = (50.0, 20.0, 10.0, 5.0, 3.0, 2.0, 1.5, 1.0, 0.1, 1e-2, 1e-4)

STEPS: Final = 6
"""Strips across the sheet that make a gradient of conductivity."""

ASIDE: Final = " (no row is measured at a driven electrode, and voltmeters take no current)"
"""Why contact impedance matters so little: what is left is the current that contacts short-circuit."""

TRAINED_CONTRAST: Final = 50.0
"""Paper section V.A: 1 S/m untouched, 50 S/m touched."""


_stress = partial(Stress, solved=True)


def stresses() -> list[Stress]:
    """Return drift, contact impedance and contrast."""
    all_contacts, one_contact = _explained(_all_contacts, ASIDE), _explained(_one_contact, ASIDE)
    return [
        _stress("drying, everywhere", "conductivity lost", DRIFT, _dried, _explained(_dried)),
        _stress("drying, in a gradient along x", "conductivity lost", DRIFT, _dried_at_one_end,
                _explained(_dried_at_one_end)),
        _stress("contact impedance of all, worse", "times", WORSE, _all_contacts, all_contacts, True),
        _stress("contact impedance of all, better", "times", BETTER, _all_contacts, all_contacts, True),
        _stress("contact impedance of one, worse", "times", WORSE, _one_contact, one_contact, True),
        _stress("contact impedance of one, better", "times", BETTER, _one_contact, one_contact, True),
        _stress("contrast, higher", "S/m over S/m", HIGHER, _contrast, _explain_contrast, True),
        _stress("contrast, lower", "S/m over S/m", LOWER, _contrast, _explain_contrast, True),
    ]  # fmt: skip


def _explained(disturb: Disturb, aside: str = "") -> Explain:
    def explain(samples: Sequence[Sample], level: float) -> str:
        bare = [disturb(sample.bare(), level, np.random.default_rng(0)) for sample in samples]
        return f"at {level:.3g}{aside}, " + explain_change(samples, bare)

    return explain


def _dried(sample: Sample, lost: float, rng: np.random.Generator) -> Sample:
    sheet = replace(sample.scene.sheet, conductivity_S_per_m=(1.0 - lost) * sample.scene.sheet.conductivity_S_per_m)
    return replace(sample, voltages=voltages_of(replace(sample.scene, sheet=sheet)))


def _dried_at_one_end(sample: Sample, lost: float, rng: np.random.Generator) -> Sample:
    if lost == 0.0:
        return sample
    length, width = sample.scene.sheet.size_mm
    background = sample.scene.sheet.conductivity_S_per_m
    edges = np.linspace(0.0, length, STEPS + 1)
    strips = tuple(
        Touch((Rect(float(a), 0.0, float(b), width),), background * (1.0 - lost * (a + b) / 2 / length))
        for a, b in pairwise(edges)
    )
    return replace(sample, voltages=voltages_of(replace(sample.scene, touches=strips + sample.scene.touches)))


def _all_contacts(sample: Sample, factor: float, rng: np.random.Generator) -> Sample:
    return replace(sample, voltages=_with_contacts(sample.scene, tuple([factor] * 16)))


def _one_contact(sample: Sample, factor: float, rng: np.random.Generator) -> Sample:
    factors = np.ones(16)
    factors[int(rng.integers(16))] = factor
    return replace(sample, voltages=_with_contacts(sample.scene, tuple(factors.tolist())))


@lru_cache(maxsize=2048)
def _with_contacts(scene: Scene, factors: tuple[float, ...]) -> Array:
    """Return (104,) V with each electrode's contact impedance multiplied by its own factor."""
    touched = touch(system_of(scene), scene.touches)
    contacts = touched.system.contacts
    more = contacts.impedance_ohm_m2 * (np.array(factors)[contacts.electrode] - 1.0)
    density = 1.0 / (1.0 / touched.density + more)  # in series with what was there, fringe and all
    return scene.current_A * Factor(touched.system, touched.blocks, density).voltages()


def _contrast(sample: Sample, contrast: float, rng: np.random.Generator) -> Sample:
    conductivity = contrast * sample.scene.sheet.conductivity_S_per_m
    touches = tuple(replace(touch, conductivity_S_per_m=conductivity) for touch in sample.scene.touches)
    return replace(sample, voltages=voltages_of(replace(sample.scene, touches=touches)))


def effective(contrast: float) -> float:
    """Return the effective contrast 2 (c - 1) / (c + 1) of a disc."""
    return SATURATED * (contrast - 1.0) / (contrast + 1.0)


def _explain_contrast(samples: Sequence[Sample], contrast: float) -> str:
    share = effective(contrast) / effective(TRAINED_CONTRAST)
    changed = [_contrast(sample, contrast, np.random.default_rng(0)) for sample in samples]
    left = np.median([
        np.linalg.norm(c.voltages - s.sheet.untouched) / np.linalg.norm(s.voltages - s.sheet.untouched)
        for s, c in zip(samples, changed, strict=True)
    ])  # fmt: skip
    return (
        f"at {contrast:.3g} a touch's effective contrast 2 (c - 1) / (c + 1) is {effective(contrast):.3g}, "
        f"{share:.3g} of that at {TRAINED_CONTRAST:g}, and its change of V is {left:.3g} of it"
    )
