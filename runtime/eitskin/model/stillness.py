"""Decides whether a frame differs by more than noise from those before it, and averages the frames that do not.

The captured reference says how rows of a resting sheet vary from frame to frame, each by itself and together. With the
covariance C of that noise, the difference of the means of n and m frames of an unchanged scene has a known size::

    d = (mean of n - mean of m) / sqrt(1 / n + 1 / m)
    still, if d C^-1 d <= rows (1 + 4 sqrt(2 / rows))

(A spread of few frames is itself uncertain: with nu = frames - 1, a squared value follows Fisher's F(1, nu), of which
mean and variance are used. A row of which the converter shows only a few steps may rest on one and then flip between
two, so no spread is less than half a step.) About one in 3500 frames of a resting scene ends its mean needlessly. A
spread above ``LARGEST_SPREAD`` is not used, because with such a reference hardly anything would count as a change.

Two means serve, and they have no frame in common. The *mean* is that of which a map was computed. Each frame is held
against it, and a frame that is not still begins another one at once. Still frames gather, ``NEWEST`` at a time, in a
*block*. Its newest frames, and the block once it has as many frames as the mean, are held against the mean::

    not still                   they are the mean from now on: something creeps
    still, and few frames       block and mean together are the mean: of 2, 4, 8 ... frames
    still, and as many as may   after ``REFRESH_FRAMES`` the block is the mean, else it begins anew

So a change of a frame's own noise (rms over the rows) can stay unseen in one frame, and of 0.4 of it in 8 to 16
frames. At the latest after ``REFRESH_FRAMES`` a map is computed again.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.normalise import weak_rows
from eitskin_proto.sensor.table import N_ROWS

Array = npt.NDArray[np.float64]

REFRESH_FRAMES: Final = 100
"""A map is computed and published in full at least this often: half a second at 200 frames/s."""

MOST_FUSED: Final = 64
"""Frames that a mean is of, where the reference shows no drift within them: a third of a second at 200 frames/s."""

NEWEST: Final = 8
"""Frames whose mean is looked at together: 40 ms at 200 frames/s."""

SMALLEST_SPREAD: Final = 1e-5
"""Of the reference's voltage: a recording or a simulation without noise has none."""

LARGEST_SPREAD: Final = 0.01
"""Of the reference's voltage, three times the noise at 50 dB."""

FEWEST: Final = 4
"""Degrees of freedom up to which F(1, nu) has no variance."""

SIGMAS: Final = 4.0
"""By how many standard deviations of the mean square a resting scene may exceed 1."""


class Stillness:
    """Holds frames against the mean of those before them; allocates nothing a frame.

    Args:
        values: Of a frame.
    """

    __slots__ = (
        "_age", "_block", "_difference", "_gathered", "_limit", "_most", "_new", "_newest", "_shared", "_together",
        "_weight", "alone", "frames", "mean", "still_frames",
    )  # fmt: skip

    def __init__(self, values: int = N_ROWS) -> None:
        self.mean, self._block, self._newest, self._difference = np.zeros((4, values), dtype=np.float32)
        self._weight, self._shared = np.zeros(values, np.float32), np.zeros((0, values), np.float32)
        self._together = np.zeros(0, np.float32)
        self._limit, self._most = 0.0, 1
        self._age = self._gathered = self._new = 0
        self.frames = 0
        """That the mean is of; 0 before the first."""
        self.still_frames = 0
        """Frames in a row that were still."""
        self.alone = False
        """Whether each frame begins another mean, because a touch moves."""

    def use_reference(
        self,
        voltages_V: Array,
        spread_V: Array,
        frames: int,
        step_V: float = 0.0,
        shared_V: Array | None = None,
        most: int | None = None,
    ) -> None:
        """Judge dV by another reference from the next frame on.

        Args:
            voltages_V: (rows,) V.
            spread_V: (rows,) V, standard deviation of a single frame.
            frames: How many frames the spread is of; with fewer than 6 nothing is ever still.
            step_V: Of the converter.
            shared_V: (rows, k) V, the part of the noise that rows share; None for none.
            most: Frames that a mean may be of; None for ``MOST_FUSED``.
        """
        usable = ~weak_rows(voltages_V)
        size = np.abs(voltages_V[usable])
        measured = np.maximum(spread_V[usable] / size, SMALLEST_SPREAD)
        believed = np.minimum(measured, LARGEST_SPREAD)
        shared = np.zeros((len(size), 0)) if shared_V is None else shared_V[usable] / size[:, None]
        shared = shared * (believed / measured)[:, None]
        own = np.maximum(believed**2 - (shared**2).sum(axis=1), SMALLEST_SPREAD**2)
        own = np.sqrt(np.maximum(own, (0.5 * step_V / size) ** 2))
        shared /= own[:, None]
        root = np.linalg.cholesky(np.eye(shared.shape[1]) + shared.T @ shared)
        weight, less = np.zeros(len(usable)), np.zeros((shared.shape[1], len(usable)))
        weight[usable], less[:, usable] = 1.0 / own, np.linalg.solve(root, shared.T)
        self.use_noise(weight, less, frames, most)

    def use_noise(self, weight: Array, shared: Array, frames: int, most: int | None = None) -> None:
        """Judge by other noise from the next frame on: d C^-1 d = |y|^2 - |shared y|^2 with y = weight d.

        Args:
            weight: (values,), 0 for values that are not looked at.
            shared: (k, values)
            frames: As in :meth:`use_reference`.
            most: Likewise.
        """
        freedom, count = frames - 1, int(np.count_nonzero(weight))
        self._weight, self._shared = weight.astype(np.float32), shared.astype(np.float32)
        self._together = np.zeros(len(shared), np.float32)
        self._limit = -1.0
        if freedom > FEWEST:
            mean, variance = freedom / (freedom - 2), 2.0 * (freedom - 1) / (freedom - 4)
            self._limit = float(count * mean * (1.0 + SIGMAS * np.sqrt(variance / count)))
        self._most = MOST_FUSED if most is None else min(most, MOST_FUSED)
        self.reset()

    def take(self, values: npt.NDArray[np.float32], *, wanted: bool = False) -> bool:
        """Take a frame, and return whether a map of the mean is due.

        Args:
            values: (values,) of the frame.
            wanted: Whether a map is computed in any case.
        """
        if self.alone or not self.still(values):
            self.keep(values)
            return True
        self.still_frames += 1
        if not self._gather(values):
            return False
        if self._new > 1 and self._differs(self._newest, self._new):
            self._replace(self._newest, self._new)
            return True
        several = self._gathered > 0
        self._fill_block()
        if self._gathered < self.frames:
            return False
        creeps = several and self._differs(self._block, self._gathered)
        if not creeps and 2 * self.frames <= self._most:
            self._merge()
        elif creeps or wanted or self._age + self.frames > REFRESH_FRAMES:
            self._replace(self._block, self._gathered)
        else:
            self._block[:], self._gathered = 0.0, 0
            return False
        return True

    def still(self, values: npt.NDArray[np.float32], frames: int = 1) -> bool:
        """Return whether a frame is the mean of those before it within noise, and count it.

        Args:
            values: (values,) of the frame.
            frames: That it is itself the mean of.
        """
        self._age += 1
        if not self.frames:
            return False
        np.subtract(values, self.mean, out=self._difference)
        return self._is_noise(frames)

    def _is_noise(self, frames: int) -> bool:
        """Return whether what is in ``_difference``, of so many frames against the mean, is noise."""
        np.multiply(self._difference, self._weight, out=self._difference)
        size = self._difference.dot(self._difference)
        if len(self._shared):
            np.matmul(self._shared, self._difference, out=self._together)
            size -= self._together.dot(self._together)
        return bool(size <= self._limit * (1.0 / frames + 1.0 / self.frames))

    def keep(self, values: npt.NDArray[np.float32], frames: int = 1) -> None:
        """Begin another mean with this frame.

        Args:
            values: (values,) of the frame; copied.
            frames: That it is itself the mean of.
        """
        np.copyto(self.mean, values)
        self.frames, self.still_frames = frames, 0
        self._begin_block()

    def follow(self, values: npt.NDArray[np.float32], fused: int, *, keeps_map: bool) -> bool:
        """Gather a frame as it was when it was recorded, and return whether a map of the mean is due.

        Where frames that the mean needs are lacking, this frame stands alone, until there is a mean of known frames.

        Args:
            values: (values,) of the frame.
            fused: Frames that its map rests on.
            keeps_map: Whether that is the map of an earlier frame.
        """
        if fused == 1 and not keeps_map:
            self.keep(values)
            return True
        whole = self._gather(values)
        if whole and fused == self._new and not keeps_map:
            self._replace(self._newest, self._new)
            return True
        if whole:
            self._fill_block()
        if keeps_map:
            if not self.frames:
                np.copyto(self.mean, values)
            if self._gathered == self.frames:
                self._block[:], self._gathered = 0.0, 0
            return False
        if whole and fused == self._gathered:
            self._replace(self._block, self._gathered)
        elif whole and self.frames and fused == self.frames + self._gathered:
            self._merge()
        elif not self.frames or fused != self.frames:
            self.reset()
            np.copyto(self.mean, values)
        return True

    def reset(self) -> None:
        """Begin another mean with the next frame, whatever it is."""
        self.frames = self.still_frames = 0
        self._begin_block()

    def _gather(self, values: npt.NDArray[np.float32]) -> bool:
        """Add a frame to the newest, and return whether these are enough to be looked at."""
        np.add(self._newest, values, out=self._newest)
        self._new += 1
        return self._new == min(self.frames or NEWEST, NEWEST)

    def _differs(self, total: npt.NDArray[np.float32], frames: int) -> bool:
        """Return whether the mean of so many frames differs from the mean by more than noise."""
        np.multiply(total, np.float32(1.0 / frames), out=self._difference)
        np.subtract(self._difference, self.mean, out=self._difference)
        return not self._is_noise(frames)

    def _fill_block(self) -> None:
        np.add(self._block, self._newest, out=self._block)
        self._gathered += self._new
        self._newest[:], self._new = 0.0, 0

    def _begin_block(self) -> None:
        self._block[:] = self._newest[:] = 0.0
        self._gathered = self._new = self._age = 0

    def _merge(self) -> None:
        """Let the mean be that of its frames and of the block's."""
        both = self.frames + self._gathered
        np.multiply(self.mean, np.float32(self.frames), out=self.mean)
        np.add(self.mean, self._block, out=self.mean)
        np.multiply(self.mean, np.float32(1.0 / both), out=self.mean)
        self.frames = both
        self._begin_block()

    def _replace(self, total: npt.NDArray[np.float32], frames: int) -> None:
        """Let the mean be that of these frames."""
        np.multiply(total, np.float32(1.0 / frames), out=self.mean)
        self.frames = frames
        self._begin_block()
