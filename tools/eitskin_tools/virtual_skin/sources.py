"""Where the virtual skin's voltages come from: a script's keyframes with noise on top."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from eitskin_sim.measurement.noise import add_noise

if TYPE_CHECKING:
    from eitskin_tools.scripted_scene.keyframes import Keyframes
    from eitskin_tools.scripted_scene.script import Script

Array = npt.NDArray[np.float64]


@dataclass(slots=True, eq=False)
class Noise:
    """Noise of one kind at one level, in order from a seed.

    Args:
        kind: "N1", "N2", "N3" or "none"; see :mod:`eitskin_sim.measurement.noise`.
        snr_db: Signal to noise ratio.
        seed: Of the generator.
        reference: (104,) V, flat and untouched; N1 needs it.
        converter_V: Noise of the converter itself, that every front end has; none with "none".
    """

    kind: str = "N2"
    snr_db: float = 50.0
    seed: int = 0
    reference: Array | None = None
    converter_V: float = 0.0
    _rng: np.random.Generator = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng(self.seed)

    def on(self, voltages: Array) -> Array:
        """Return (104,) V as a noisy front end measures them."""
        reference = voltages if self.reference is None else self.reference
        noisy = add_noise(voltages, reference, self.kind, self.snr_db, self._rng)  # type: ignore[arg-type]
        if self.kind != "none" and self.converter_V > 0.0:
            noisy = noisy + self.converter_V * self._rng.standard_normal(noisy.shape)
        return noisy


@dataclass(frozen=True, slots=True, eq=False)
class ScriptSource:
    """Voltages of a script, interpolated between its keyframes."""

    script: "Script"
    keyframes: "Keyframes"
    noise: Noise

    def voltages(self, time_s: float) -> Array:
        """Return the (104,) V at a time since the first START."""
        return self.noise.on(self.script.voltages_at(time_s, self.keyframes))
