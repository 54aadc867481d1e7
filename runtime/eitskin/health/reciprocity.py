"""A sheet reads the same when drive and measurement change places, whatever its shape and whatever touches it.

A front end that scans all 208 rows shows both readings of every pair of pairs. A contact that carries less current than
it should, or a wire that reads less than it should, makes them differ in all 13 rows of both of its pairs ::

    gap of a row = |mean(V_km - V_mk)| / mean(|V_km| + |V_mk|)        of a pair: the median of its 13 rows
    gap of an electrode = the smaller one of its two pairs, since a neighbour has one bad pair too

Means run over ``MEAN_FRAMES`` frames, so that neither noise nor a quick touch, which changes between the two readings,
looks like a failure. This sees a contact of a thousand times its impedance, which 104 rows do not.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.table import N_ELECTRODES, N_ROWS, RECIPROCAL_IN_FULL, ROW_IN_FULL, TABLE

MEAN_FRAMES: Final = 8
"""Frames of the running means."""

LARGEST_GAP: Final = 0.03
"""Above it an electrode is suspicious in a stream: noise of 50 dB, of the rms over the rows, makes 0.003. An electrode
that is wrongly given up costs accuracy, and a quick touch that falls between the two readings of a few frames is left
in a mean of eight."""

LARGEST_RECORDED_GAP: Final = 0.02
"""The same in a recording of some seconds, of which each row's gap is the median: a touch leaves no trace in that, and
what comes of it is no more than advice. So it may be stricter."""

AGREEING_FRAMES: Final = 12
"""Frames in a row with the same suspect; failures that 104 rows show are reported after ten."""

Array = npt.NDArray[np.float64]

_OF_PAIR: Final = np.array([np.flatnonzero(np.equal(TABLE, pair).any(axis=1)) for pair in range(N_ELECTRODES)])
_BEFORE: Final = np.roll(np.arange(N_ELECTRODES), 1)


def row_gaps(counts: npt.NDArray[np.number]) -> tuple[Array, Array]:
    """Return (104,) differences and (104,) sums of the sizes of rows and their reciprocals.

    Args:
        counts: (208,) of a frame.
    """
    straight, back = counts[ROW_IN_FULL].astype(np.float64), counts[RECIPROCAL_IN_FULL].astype(np.float64)
    return straight - back, np.abs(straight) + np.abs(back)


def electrode_gaps(gap: Array) -> Array:
    """Return the (16,) gaps of electrodes from the (104,) of rows."""
    pairs = np.median(gap[_OF_PAIR], axis=1)
    return np.asarray(np.minimum(pairs, pairs[_BEFORE]))


class Reciprocity:
    """Follows the gaps, one frame after another."""

    __slots__ = ("_apart", "_frames", "_last", "_size", "_streak", "gaps")

    def __init__(self) -> None:
        self.gaps: Array = np.zeros(N_ELECTRODES)
        """(16,) as the frames so far show them."""
        self.restart()

    def restart(self) -> None:
        """Forget every frame."""
        self._apart, self._size = np.zeros(N_ROWS), np.zeros(N_ROWS)
        self._frames = self._streak = 0
        self._last = -1
        self.gaps = np.zeros(N_ELECTRODES)

    @property
    def suspect(self) -> int | None:
        """The electrode that has not been reciprocal for ``AGREEING_FRAMES`` frames, if there is one."""
        return self._last if self._streak >= AGREEING_FRAMES else None

    def add(self, counts: npt.NDArray[np.number], known: frozenset[int] = frozenset()) -> None:
        """Take a frame.

        Args:
            counts: (208,)
            known: Electrodes that are out of use already, and are no news.
        """
        self._frames += 1
        apart, size = row_gaps(counts)
        share = 1.0 / min(self._frames, MEAN_FRAMES)
        self._apart += share * (apart - self._apart)
        self._size += share * (size - self._size)
        self.gaps = electrode_gaps(np.abs(self._apart) / np.maximum(self._size, 1e-30))
        shown = self.gaps.copy()
        shown[list(known)] = 0.0
        worst = int(np.argmax(shown))
        if shown[worst] <= LARGEST_GAP:
            self._last, self._streak = -1, 0
            return
        self._streak = self._streak + 1 if worst == self._last else 1
        self._last = worst
