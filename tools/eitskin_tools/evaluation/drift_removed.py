"""Trials with the runtime's own correction of drift: frames of the untouched sheet go through it before each touch.

::

    met        the runtime has just been started, with a reference from before the drift; of each deformation it sees
               the untouched sheet, and its scan
    followed   it ran while the sheet drifted, flat and untouched; then the same

Each deformation is seen untouched for ``LOOKS``, three seconds at 200 frames/s. What the gate says of the corrected
frames counts, as it does in a stream.
"""

from collections.abc import Callable
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin.errors import BundleError
from eitskin.health.drift import Drift
from eitskin.health.imputation import MISSING, Consistency
from eitskin.model.bundle import Bundle
from eitskin_tools.evaluation.gate_judge import judge_of

Array = npt.NDArray[np.float64]

MODES: Final = ("met", "followed")

LOOKS: Final = 26
TOGETHER: Final = 24
REFERENCE_FRAMES: Final = 100

SLOW_LOOKS: Final = 3500
SLOW_TOGETHER: Final = 120
"""The drift takes 35 minutes at 200 frames/s."""


class DriftRemoved:
    """The runtime's drift, on trials.

    Args:
        bundle: Its consistency.npz and its gate are used.
        mode: One of ``MODES``.

    Raises:
        BundleError: The bundle knows nothing of drift.
    """

    def __init__(self, bundle: Bundle, mode: str) -> None:
        arrays = bundle.consistency_arrays()
        if arrays is None:
            raise BundleError(f"{bundle.path}: telling drift is {MISSING}")
        self._drift = Drift(Consistency.of(arrays))
        self._judge, self._mode = judge_of(bundle), mode
        self._reference = np.ones(0)

    def begin(self, reference: Array, drifted: Array, noisy: Callable[[Array, int], Array]) -> None:
        """Take a device over; see :class:`eitskin_sim.evaluation.devices.runs.Follower`."""
        self._reference = reference
        spread = noisy(reference, REFERENCE_FRAMES).std(axis=0, ddof=1) / np.abs(reference)
        self._drift.restart(spread, REFERENCE_FRAMES, fresh=self._mode == "followed")
        if self._mode == "followed":
            moved = np.log(drifted / reference)
            for part in np.linspace(0.0, 1.0, SLOW_LOOKS) if moved.any() else (0.0,):
                self._show(noisy(reference * np.exp(part * moved), SLOW_TOGETHER), None)

    def meet(self, untouched: Array, predicted_log: Array | None, noisy: Callable[[Array, int], Array]) -> None:
        """See a deformation, untouched."""
        for _ in range(LOOKS):
            self._show(noisy(untouched, TOGETHER), predicted_log)

    def correct(self, volts: Array) -> Array:
        """Return (104,) V without drift."""
        change = np.asarray(volts / self._reference - 1.0, dtype=np.float32)
        self._drift.correct(change)
        return np.asarray((change.astype(np.float64) + 1.0) * self._reference)

    def _show(self, volts: Array, predicted_log: Array | None) -> None:
        change = np.asarray(volts / self._reference - 1.0, dtype=np.float32)
        scan: Any = np.zeros(len(self._reference)) if predicted_log is None else predicted_log
        touched = self._judge(self.correct(volts[-1]), self._reference)
        self._drift.look(change, scan.astype(np.float32), touched=touched)
