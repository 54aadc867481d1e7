"""Monitors the electrodes and the drift of the reference, and corrects frames for both.

Before a frame is judged, ``prepare`` corrects it for the gate and ``complete`` for the network; a healthy frame costs
one copy of 104 numbers. After publishing, the frame is put aside, and several frames are examined together while the
line rests. This costs a fifth of examining each alone, because the arithmetic is small and its weights leave the caches
in between, and it delays no subscriber, because other threads still hand over the frame just published. The next frame
reports changes. A bundle without ``consistency.npz`` supports none of this, and says so when asked.
"""

import threading
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin.errors import BundleError
from eitskin.health.drift import Drift
from eitskin.health.electrodes import HEALTHY, NOT_RECIPROCAL, ElectrodeWatch
from eitskin.health.gate_without_rows import GateWithoutRows
from eitskin.health.imputation import MISSING, UNPREDICTED, Consistency, without_rows
from eitskin.health.reciprocity import LARGEST_GAP, Reciprocity
from eitskin.model.bundle import Bundle
from eitskin.model.gate import Gate
from eitskin.reference.repeats import ranges
from eitskin_proto.sensor.normalise import inverse_reference
from eitskin_proto.sensor.table import N_FULL_ROWS, N_ROWS

BATCH_FRAMES: Final = 5
"""Frames whose electrodes are examined together: a failure is reported at most 4 frames later than one by one."""

MAX_BATCH: Final = BATCH_FRAMES + 1
"""Frames after which they are examined even if the line never rests."""

DRIFT_TOGETHER: Final = 24
"""The same for drift, which moves in minutes; a multiple of ``MAX_BATCH``."""

MOST_HANGING: Final = N_ROWS // 2
"""Rows that hang and are filled in from the others; with more, frames are withheld."""


class Health:
    """Electrodes and drift of one skin.

    Args:
        consistency: Of the bundle.
        exclude: Electrodes left out by hand.
        compensate_drift: Whether drift is taken out of the frames.
    """

    def __init__(
        self, consistency: Consistency, *, exclude: tuple[int, ...] = (), compensate_drift: bool = True
    ) -> None:
        self._consistency = consistency
        self._lock = threading.Lock()
        self._wanted: tuple[int, ...] | None = None
        self._raw = np.zeros((MAX_BATCH, N_ROWS), dtype=np.float32)
        self._waiting = 0
        """Frames of ``_raw`` that were published and not yet examined."""
        self._followed = np.zeros((DRIFT_TOGETHER, N_ROWS), dtype=np.float32)
        self._following = 0
        """Frames of ``_followed`` that drift has not seen yet."""
        self._touched = 0
        """Frames since then that the gate called touched."""
        self._events: tuple[str, ...] = ()
        self._unclear = self._doubtful = False
        self.drift = Drift(consistency, compensate=compensate_drift)
        self.electrodes = ElectrodeWatch(consistency, consistency.reference, np.zeros(N_ROWS), exclude)
        self.reciprocity = Reciprocity()
        """Of a device that scans all 208 rows; idle for any other."""
        self._reciprocal_again: dict[int, int] = {}
        self._rows_before = self.electrodes.missing
        self.gate_without_rows: GateWithoutRows | None = None
        """Cares for a gate on frames that lack rows; None without one."""
        self.hanging = np.zeros(N_ROWS, dtype=np.bool_)
        """(104,) rows that are filled in because they hang."""
        self.hanging_count = 0
        """How many."""
        self._moving = np.zeros(N_ROWS, dtype=np.intp)

    def use_reference(
        self,
        reference_V: npt.NDArray[np.float64],
        spread_V: npt.NDArray[np.float64],
        gate: Gate | None = None,
        *,
        frames: int = 100,
        fresh: bool = False,
        shared_V: npt.NDArray[np.float64] | None = None,
    ) -> None:
        """Compare frames with another reference from now on.

        The gate's threshold is set at once. If the same rows were missing before, as when a reference is replaced
        between frames, no frame waits for this: the old threshold holds, and the new one is set while the line rests.

        Args:
            reference_V: (104,) V.
            spread_V: (104,) V, standard deviation of its single frames.
            gate: The gate of the frames; its threshold depends on their rows.
            frames: Number of frames of which the reference is the mean.
            fresh: Whether it was captured just now.
            shared_V: (104, k) V, the part of the spread that rows share; None for none.
        """
        by_hand = tuple(finding.electrode for finding in self.electrodes.findings if finding.state == "excluded")
        self.electrodes = ElectrodeWatch(self._consistency, reference_V, spread_V, by_hand)
        known = self.gate_without_rows is not None and np.array_equal(self._rows_before, self.electrodes.missing)
        self._rows_before = self.electrodes.missing
        self.gate_without_rows = None
        if gate is not None:
            before = gate.threshold
            inverse = np.abs(inverse_reference(reference_V))
            shared = None if shared_V is None else shared_V * inverse[:, None]
            self.gate_without_rows = GateWithoutRows(self._consistency, gate, self.electrodes.sigma, shared)
            self.gate_without_rows.leave_out(self.electrodes.missing)
            if not known:
                self.gate_without_rows.finish()
            elif self.gate_without_rows.due:
                gate.threshold = before
        self.drift.restart(self.electrodes.sigma, frames, fresh=fresh)
        self.drift.leave_out(self.electrodes.missing)
        self.reciprocity.restart()
        self._reciprocal_again = {}
        self._waiting = self._following = self._touched = 0
        self.hanging[:] = self.hanging_count = 0

    def hang(self, rows: npt.NDArray[np.bool_]) -> bool:
        """Fill in rows that hang until they have moved for ``HEALTHY`` frames; return whether others are missing now.

        Args:
            rows: (104,) those that hang in the present frame.
        """
        self._moving += 1
        self._moving[rows] = 0
        new, back = rows & ~self.hanging, self.hanging & (self._moving >= HEALTHY)
        hanging = (self.hanging | new) & ~back
        if not (new.any() or back.any()) or np.count_nonzero(hanging) > MOST_HANGING:
            return False
        self.hanging, self.hanging_count = hanging, int(np.count_nonzero(hanging))
        for changed, what in ((new, "frozen"), (back, "back")):
            if changed.any():
                self._add_events((f"rows:{ranges(np.flatnonzero(changed))}:{what}",))
        self.electrodes.leave_out(hanging)
        return self._follow_missing()

    @property
    def lacks_rows(self) -> bool:
        """Whether rows are missing, which a gate needs more than a network does."""
        return self.electrodes.lacks_rows

    def exclude(self, electrodes: tuple[int, ...]) -> None:
        """Leave these electrodes out by hand from the next frame on; may be called from another thread.

        Raises:
            ValueError: One does not exist, or there are too many.
        """
        self.electrodes.check(electrodes)
        with self._lock:
            self._wanted = electrodes

    def prepare(self, change: npt.NDArray[np.float32]) -> None:
        """Keep (104,) dV as measured, and put it right, in place, as far as a gate needs it."""
        self._raw[self._waiting] = change
        alters = self.electrodes.alters
        if alters:
            self.electrodes.rearrange(change)
        if self.drift.active:
            self.drift.correct(change)
        if alters and self.gate_without_rows is not None:
            self.gate_without_rows.fill(change)

    def complete(self, change: npt.NDArray[np.float32], predicted: npt.NDArray[np.float32] = UNPREDICTED) -> None:
        """Fill in, in place, what a solver needs, behind :meth:`prepare`.

        Args:
            change: (104,) dV.
            predicted: (104,) log(V_pred / V0) of the cloud in use; zeros without one.
        """
        if self.electrodes.alters:
            self.electrodes.imputation.fill(change, predicted)

    def doubts(self, change: npt.NDArray[np.float32]) -> tuple[bool, bool]:
        """Return whether a touched frame may owe its touch to a failure that is over, and whether to withhold it.

        Args:
            change: (104,) dV, completed.
        """
        electrodes, before = self.electrodes, self._doubtful
        self._doubtful = electrodes.is_doubtful(self._raw[self._waiting], change)
        many = electrodes.rearranged is not None or len(electrodes.findings) > 1
        return self._doubtful, self._doubtful and (many or not before)  # one electrode's rows are filled in well

    def put_aside(self, counts: npt.NDArray[np.int32] | None = None, *, touched: bool) -> bool:
        """Queue the frame corrected last for examination, and return whether that is due now.

        Args:
            counts: Of the frame; (208,) are checked for reciprocity at once.
            touched: The gate's decision.
        """
        if counts is not None and len(counts) == N_FULL_ROWS:
            self.reciprocity.add(counts, frozenset(finding.electrode for finding in self.electrodes.findings))
            self._count_reciprocal()
        self._waiting += 1
        self._touched += touched
        return self._waiting == MAX_BATCH

    @property
    def due(self) -> bool:
        """Whether enough frames wait, or the gate's threshold is to be set, or electrodes are to be excluded."""
        calibrating = self.gate_without_rows is not None and self.gate_without_rows.due
        return self._waiting >= BATCH_FRAMES or self._wanted is not None or calibrating

    def examine(self, predicted: npt.NDArray[np.float32]) -> bool:
        """Look at the frames that wait, and return whether other rows are missing from now on.

        Args:
            predicted: (104,) log(V_pred / V0) of the cloud in use.
        """
        raw, self._waiting = self._raw[: self._waiting], 0
        electrodes, before = self.electrodes, self.electrodes.texts
        with self._lock:
            wanted, self._wanted = self._wanted, None
        if wanted is not None:
            electrodes.exclude(wanted)
        if len(raw):
            self._weigh(raw, predicted)
        self._hold_reciprocal()
        if electrodes.texts != before:
            self._add_events(tuple(f"electrode:{text}" for text in electrodes.texts if text not in before))
            self._add_events(
                tuple(f"electrode:{text.split(':')[0]}:back" for text in before if text not in electrodes.texts)
            )
        if electrodes.unclear and not self._unclear:
            self._add_events(("electrodes:unclear",))
        self._unclear = electrodes.unclear
        if electrodes.missing is self._rows_before and self.gate_without_rows is not None:
            self.gate_without_rows.step()
        return self._follow_missing()

    def _follow_missing(self) -> bool:
        """Let drift and gate do without the rows that are missing now, and return whether these are others."""
        missing = self.electrodes.missing
        if missing is self._rows_before:
            return False
        self._rows_before = missing
        self.drift.leave_out(missing)
        if self.gate_without_rows is not None:
            self.gate_without_rows.leave_out(missing)
        return True

    def _weigh(self, raw: npt.NDArray[np.float32], predicted: npt.NDArray[np.float32]) -> None:
        change = raw
        if self.electrodes.alters:
            change = raw.copy()
            for row in change:
                self.electrodes.correct(row, predicted)
        self.electrodes.update(raw, change)
        self._follow(change, predicted)

    def _count_reciprocal(self) -> None:
        """Count the frames in a row in which each electrode that was given up reads both ways alike."""
        for finding in self.electrodes.findings:
            if finding.state == NOT_RECIPROCAL:
                well = self.reciprocity.gaps[finding.electrode] < LARGEST_GAP / 2.0
                before = self._reciprocal_again.get(finding.electrode, 0)
                self._reciprocal_again[finding.electrode] = before + 1 if well else 0

    def _hold_reciprocal(self) -> None:
        """Give up the electrode that is not reciprocal, and use again one that is."""
        for electrode, frames in tuple(self._reciprocal_again.items()):
            if frames >= HEALTHY:
                del self._reciprocal_again[electrode]
                self.electrodes.trust(electrode)
        suspect = self.reciprocity.suspect
        if suspect is not None and self.electrodes.give_up(suspect):
            self._reciprocal_again[suspect] = 0

    def _follow(self, change: npt.NDArray[np.float32], predicted: npt.NDArray[np.float32]) -> None:
        """Show (n, 104) frames, failed rows filled in, to drift once they are enough."""
        end = self._following + len(change)
        self._followed[self._following : end] = change
        self._following = end
        if end + MAX_BATCH <= DRIFT_TOGETHER:
            return
        touched, self._following, self._touched = 2 * self._touched > end, 0, 0
        self._add_events(self.drift.update(self._followed[:end], predicted, touched=touched))

    def projection(self, matrix: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """Return the bundle's projection without the rows that are missing."""
        return without_rows(matrix, self._consistency.projection_inverse, self.electrodes.missing)

    def take_events(self) -> tuple[str, ...]:
        """Return what happened since the last call."""
        events, self._events = self._events, ()
        return events

    def _add_events(self, events: tuple[str, ...]) -> None:
        self._events += tuple(event for event in events if event not in self._events)


def health_of(bundle: Bundle, *, exclude: tuple[int, ...] = (), compensate_drift: bool | None = None) -> Health | None:
    """Return the monitor of electrodes and drift, or None for a bundle that cannot.

    Args:
        bundle: The solvers.
        exclude: Electrodes left out by hand.
        compensate_drift: Whether drift is taken out of the frames; None wherever the bundle can.

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
    return Health(Consistency.of(arrays), exclude=exclude, compensate_drift=compensate_drift is not False)
