"""Is the sheet at rest, and is it as it was? Told from its frames alone, never from a clock.

Of the last ``WINDOW`` frames two halves are compared. At rest their means differ by noise: by what single frames step,
over the root of the frames. A sheet is away from its reference where rows changed unevenly by more than noise and
``LEAST``; what all rows share may be drift, and counts for nothing.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

WINDOW: Final = 20
LEAST: Final = 0.002
"""Rms of a row's relative change beside the common one: a light press has about 0.01."""

SURE: Final = 4.0
"""Changes are that many times what noise alone would make."""

STILL: Final = 2.0
"""Halves of a window may differ by so many times their noise; rms over a hundred rows is known to a tenth."""

CREEP: Final = 0.05
"""Of the change itself may still be on its way: soft sheets creep."""

LOUD: Final = 0.05
"""Rows with more relative noise than that tell nothing."""


class Watch:
    """The last frames of a skin."""

    def __init__(self) -> None:
        self._frames: list[Array] = []
        self._reference: Array | None = None
        self._rows: npt.NDArray[np.bool_] = np.ones((), dtype=np.bool_)  # of any number

    def add(self, voltages_V: Array) -> None:
        """Take a frame, (104,) or (208,) V, of as many rows as the others."""
        self._frames.append(np.array(voltages_V))
        del self._frames[:-WINDOW]

    def begin(self) -> None:
        """Forget the frames so far: something else is looked at from now on."""
        self._frames.clear()

    def refer(self, mean_V: Array, noise_V: Array) -> None:
        """Hold frames against a reference from now on.

        Args:
            mean_V: (rows,) of it.
            noise_V: (rows,) standard deviation of a frame.
        """
        self._reference, self._rows = mean_V, noise_V < LOUD * np.abs(mean_V)

    @property
    def last(self) -> Array:
        """The newest frame, (rows,) V."""
        return self._frames[-1]

    @property
    def full(self) -> bool:
        """Whether there are enough frames to tell."""
        return len(self._frames) == WINDOW

    @property
    def steady(self) -> bool:
        """Whether the sheet is at rest."""
        if not self.full:
            return False
        frames = np.array(self._frames)
        scale = np.abs(frames.mean(axis=0))
        rows = self._rows & (scale > 0.0)
        halves = (frames[: WINDOW // 2].mean(axis=0) - frames[WINDOW // 2 :].mean(axis=0))[rows] / scale[rows]
        noise = step_noise(frames)[rows] / scale[rows] * np.sqrt(4.0 / WINDOW)
        moved, expected = _rms(halves), _rms(noise)
        return bool(moved <= STILL * expected + (CREEP * self.away if self._reference is not None else 0.0))

    @property
    def away(self) -> float:
        """Rms of the rows' change since the reference, beside the common one."""
        if self._reference is None or not self._frames:
            return 0.0
        change = np.mean(self._frames, axis=0)[self._rows] / self._reference[self._rows] - 1.0
        return _rms(change - np.median(change))

    @property
    def floor(self) -> float:
        """What :attr:`away` must exceed to be more than noise."""
        if self._reference is None or not self.full:
            return np.inf
        noise = step_noise(np.array(self._frames))[self._rows] / np.abs(self._reference[self._rows])
        return max(LEAST, SURE * _rms(noise) / float(np.sqrt(len(self._frames))))


def step_noise(frames: Array) -> Array:
    """Return (rows,) standard deviations of a frame, from the steps between those of (n, rows)."""
    return np.asarray(np.sqrt(np.mean(np.diff(frames, axis=0) ** 2, axis=0) / 2.0))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0
