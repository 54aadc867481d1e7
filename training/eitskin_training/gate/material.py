"""Random untouched and touched frames for the gate, with noise, in any number.

A drawn bend is a solved one, or is between two of them or between one and flat: the voltages of a partial bend are
close to a mean of logarithms. A drawn touch is put on it by adding its own logarithm log(V touched / V untouched),
which hardly depends on the bend. Bend and touch are each shown in any of the skin's mirror
images, since the image of a sheet is a sheet. If devices drift, each frame also has its own common factor.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.normalise import relative_change
from eitskin_proto.skin.skin import Skin
from eitskin_sim.arrays import Array
from eitskin_sim.devices.draws import draw_drift
from eitskin_sim.measurement.noise import NOISES, Kind, add_noise
from eitskin_training.gate.untouched import Bends
from eitskin_training.network.mirror import mirrors
from eitskin_training.samples.batches import TrainingData

MAX_TOUCHES: Final = 20_000
"""How many of a data set's samples are learned from."""

SOLVED_BEND_SHARE: Final = 0.5
"""Share of bends that are solved ones, not mixtures."""

SNR_DB: Final = 50.0


def images_of(skin: Skin) -> npt.NDArray[np.intp]:
    """Return the (n, 104) rows of a skin's mirror images."""
    return np.array([mirror.rows for mirror in mirrors(skin)])


@dataclass(frozen=True, slots=True)
class Material:
    """What frames are made of.

    Args:
        reference: (104,) V of the flat sheet.
        bends: (n, 104) log(V / V0) untouched.
        touches: (t, 104) log(V touched / V untouched).
        images: (i, 104) rows of the skin's mirror images.
        devices: By whose law every frame drifts; None of the nominal device, which does not.
    """

    reference: Array
    bends: Array
    touches: Array
    images: npt.NDArray[np.intp]
    devices: Skin | None = None

    @classmethod
    def of(cls, data: TrainingData, bends: Bends, rng: np.random.Generator) -> "Material":
        """Return material of a data set's training samples and of solved bends and touches."""
        rows = data.train[data.labels[data.touch_set[data.train]].any(axis=1)]
        rows = rng.permutation(rows)[:MAX_TOUCHES]
        ratio = data.voltages[rows] / data.untouched[data.deformation[rows]]
        if data.drift is not None:
            ratio = ratio / data.drift[rows, None]
        usable = ((ratio > 1e-4) & (ratio < 1e4)).all(axis=1)
        touches = np.concatenate([np.log(ratio[usable]), bends.touches])
        return cls(data.reference, bends.train, touches, images_of(data.skin), bends.devices)

    def noisy_untouched(self, count: int, rng: np.random.Generator) -> Array:
        """Return (count, 104) noisy dV of untouched sheets."""
        return noisy_change(self.untouched(count, rng), self.reference, rng)

    def touched(self, touches: Array, count: int, rng: np.random.Generator) -> Array:
        """Return (count, 104) noisy dV of some of (t, 104) log(V touched / V untouched), each as likely."""
        chosen = touches[rng.integers(len(touches), size=count)]
        return noisy_change(self.untouched(count, rng) + self._image(chosen, rng), self.reference, rng)

    def untouched(self, count: int, rng: np.random.Generator) -> Array:
        """Return (count, 104) log(V / V0) of untouched sheets, free of noise."""
        return drifted(self._bends(count, rng), self.devices, rng)

    def _bends(self, count: int, rng: np.random.Generator) -> Array:
        one, other = self.bends[rng.integers(len(self.bends), size=(2, count))]
        kind, share = rng.random(count)[:, None], rng.random(count)[:, None]
        mixed = share * one + np.where(kind < (1.0 + SOLVED_BEND_SHARE) / 2, 0.0, 1.0 - share) * other
        return self._image(np.where(kind < SOLVED_BEND_SHARE, one, mixed), rng)

    def _image(self, logs: Array, rng: np.random.Generator) -> Array:
        return np.take_along_axis(logs, self.images[rng.integers(len(self.images), size=len(logs))], axis=1)


def drifted(logs: Array, devices: Skin | None, rng: np.random.Generator) -> Array:
    """Return (n, 104) log(V / V0) with a common factor drawn for each; as they are where nothing drifts."""
    return logs if devices is None else logs + np.log(draw_drift(devices, len(logs), rng))[:, None]


def noisy_change(
    logs: Array, reference: Array, rng: np.random.Generator, kind: Kind | None = None, snr_db: float = SNR_DB
) -> Array:
    """Return (n, 104) dV of (n, 104) log(V / V0) with noise.

    Args:
        logs: Free of noise.
        reference: (104,) V0.
        rng: Source of the noise.
        kind: Of noise; any of the three for each frame by default.
        snr_db: Of the noise.
    """
    voltages = reference * np.exp(logs)
    if kind is not None:
        return relative_change(add_noise(voltages, reference, kind, snr_db, rng), reference)
    which = rng.integers(len(NOISES), size=len(voltages))
    noisy = np.empty_like(voltages)
    for index, name in enumerate(NOISES):
        noisy[which == index] = add_noise(voltages[which == index], reference, name, snr_db, rng)
    return relative_change(noisy, reference)
