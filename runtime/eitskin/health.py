"""What the runtime knows of its own senses: which electrodes have failed, and how far the reference has drifted.

Before a frame is judged, what is known is put right (``correct``); after it was published, it is looked at (``look``),
so that a healthy frame pays one copy of 104 numbers. What changes is told by the next frame. A bundle without
``consistency.npz`` has none of this, and says so where it is asked for.
"""

import threading

import numpy as np
import numpy.typing as npt

from eitskin.bundle import Bundle
from eitskin.drift import Drift
from eitskin.electrodes import ElectrodeWatch
from eitskin.errors import BundleError
from eitskin.imputation import MISSING, Consistency, without_rows
from eitskin_proto.table import N_ROWS


class Health:
    """Electrodes and drift of one skin.

    Args:
        consistency: Of the bundle.
        exclude: Electrodes left out by hand.
        compensate_drift: Whether drift is taken out of the frames.
    """

    def __init__(
        self, consistency: Consistency, *, exclude: tuple[int, ...] = (), compensate_drift: bool = False
    ) -> None:
        self._consistency = consistency
        self._lock = threading.Lock()
        self._wanted: tuple[int, ...] | None = None
        self._raw = np.zeros(N_ROWS, dtype=np.float32)
        self._events: tuple[str, ...] = ()
        self._unclear = False
        self.drift = Drift(consistency, compensate=compensate_drift)
        self.watch = ElectrodeWatch(consistency, consistency.reference, np.zeros(N_ROWS), exclude)
        self._rows_before = self.watch.missing.copy()

    def use(self, reference_V: npt.NDArray[np.float64], spread_V: npt.NDArray[np.float64]) -> None:
        """Hold frames against another reference from now on: (104,) V and the spread of its single frames."""
        by_hand = tuple(finding.electrode for finding in self.watch.findings if finding.state == "excluded")
        self.watch = ElectrodeWatch(self._consistency, reference_V, spread_V, by_hand)
        self._rows_before = self.watch.missing.copy()
        self.drift.restart()

    def exclude(self, electrodes: tuple[int, ...]) -> None:
        """Leave these electrodes out by hand from the next frame on; may be called from another thread.

        Raises:
            ValueError: One does not exist, or there are too many.
        """
        self.watch.check(electrodes)
        with self._lock:
            self._wanted = electrodes

    def correct(self, change: npt.NDArray[np.float32]) -> None:
        """Put (104,) dV right, in place, by what is known of electrodes and drift."""
        np.copyto(self._raw, change)
        if self.watch.findings:
            self.watch.correct(change)
        self.drift.correct(change)

    def look(self, predicted: npt.NDArray[np.float32], *, touched: bool) -> bool:
        """Take the last frame's evidence and return whether other rows are missing from now on.

        Args:
            predicted: (104,) log(V_pred / V0) of the cloud in use.
            touched: What the gate said.
        """
        watch, before = self.watch, self.watch.texts
        with self._lock:
            wanted, self._wanted = self._wanted, None
        if wanted is not None:
            watch.exclude(wanted)
        change = self._raw
        if watch.findings:
            change = self._raw.copy()
            watch.correct(change)
        watch.look(self._raw, change)
        if watch.texts != before:
            self._tell(tuple(f"electrode:{text}" for text in watch.texts if text not in before))
            self._tell(tuple(f"electrode:{text.split(':')[0]}:back" for text in before if text not in watch.texts))
        if watch.unclear and not self._unclear:
            self._tell(("electrodes:unclear",))
        self._unclear = watch.unclear
        if self.drift.look(change, predicted, touched=touched):
            self._tell((f"drift:{self.drift.percent:+.0f}%",))
        if np.array_equal(watch.missing, self._rows_before):
            return False
        self._rows_before = watch.missing.copy()
        return True

    def projection(self, matrix: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """Return the bundle's projection without the rows that are missing."""
        return without_rows(matrix, self._consistency.projection_inverse, self.watch.missing)

    def take_events(self) -> tuple[str, ...]:
        """Return what happened since the last call."""
        events, self._events = self._events, ()
        return events

    def _tell(self, events: tuple[str, ...]) -> None:
        self._events += tuple(event for event in events if event not in self._events)


def health_of(bundle: Bundle, *, exclude: tuple[int, ...] = (), compensate_drift: bool = False) -> Health | None:
    """Return what watches over electrodes and drift, or None for a bundle that cannot.

    Raises:
        BundleError: It cannot, but something of it is asked for; or its arrays are damaged.
        ValueError: An electrode does not exist.
    """
    arrays = bundle.consistency_arrays()
    if arrays is None:
        if exclude or compensate_drift:
            wish = "excluding electrodes" if exclude else "compensating drift"
            raise BundleError(f"{bundle.path}: {wish} is {MISSING}")
        return None
    return Health(Consistency.of(arrays), exclude=exclude, compensate_drift=compensate_drift)
