"""Idle acquisition: while nothing touches the sheet the device scans a few drives only, and a gate of its own watches.

A scan of few drives takes less time and less current. The device's configuration sets these drives. ``eitskin export``
computed which drives reveal most about a touch; both must agree. ::

            untouched for after_s: SET_MODE(1)
    ACTIVE ------------------------------------> IDLE      frames of a few rows, judged by the idle gate
       ^                                           |
       +-------------------------------------------+
            its gate trips: SET_MODE(0)                    the first whole frame comes one scan later

An idle frame is published as untouched, or as touched without a map. The frames show the device's mode; a lost request
is repeated.
"""

from collections.abc import Mapping
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin.errors import BundleError, HandshakeError
from eitskin.model.gate import EXTRAS, FIELDS, Gate
from eitskin.reference.normaliser import LARGE_CHANGE, LARGEST_CHANGE, Normaliser
from eitskin_proto.sensor.table import N_ROWS
from eitskin_proto.wire.codes import Mode
from eitskin_proto.wire.messages import Hello
from eitskin_proto.wire.scan_rows import drives_to_list, table_rows

PREFIX: Final = "idle_"
"""Prefix of the idle gate's arrays in gate.npz."""

RETRY_NS: Final = 400_000_000
"""Time after which a change of mode is requested again."""


class IdleGate:
    """Judges frames of a few drives.

    Args:
        arrays: Of gate.npz: ``idle_drives``, and the gate's own with the prefix ``idle_``.
        hello: Of the device.

    Raises:
        BundleError: The bundle has no idle gate.
        HandshakeError: The device has no idle mode, or scans other drives in it.
    """

    __slots__ = ("_counts", "_exact", "_offset", "_scale", "drives", "far", "gate", "rows")

    def __init__(self, arrays: Mapping[str, npt.NDArray[np.generic]] | None, hello: Hello) -> None:
        if arrays is None or f"{PREFIX}drives" not in arrays:
            raise BundleError(
                "this bundle has no idle gate; make it again with 'eitskin export', or do without --idle-after"
            )
        self.drives = int(np.asarray(arrays[f"{PREFIX}drives"]).reshape(-1)[0])
        """16 bits, bit k for drive k."""
        if hello.rows != N_ROWS or hello.idle_drives != self.drives:
            found = drives_to_list(hello.idle_drives) if hello.rows == N_ROWS else f"{hello.rows} rows a scan"
            raise HandshakeError(
                f"the bundle's idle gate needs scans of the drives {drives_to_list(self.drives)}; configuration "
                f"{hello.configuration_name} has {found or 'no idle mode'}; flash one with these [idle] drives with "
                "'eitskin flash', or do without --idle-after"
            )
        self.rows = table_rows(False, self.drives)
        """Of the 104."""
        count = len(self.rows)
        self.far = False
        """The last frame is so far from the reference that its rows may be no sheet's."""
        own = {name: arrays[PREFIX + name] for name in (*FIELDS, *EXTRAS) if PREFIX + name in arrays}
        self.gate = Gate(own, count)
        self._scale = np.zeros(count)
        self._offset = np.zeros(count)
        self._exact = np.zeros(count)
        self._counts: npt.NDArray[np.number] = self._exact

    def reset(self) -> None:
        """Judge the next frame by itself."""
        self.gate.reset()

    def load(self, counts: npt.NDArray[np.int32]) -> None:
        """Take a frame.

        Args:
            counts: (rows,) of the idle drives; read again until the next ``load``.
        """
        self._counts = counts

    def touched(self, normaliser: Normaliser) -> bool | None:
        """Return whether the sheet is touched, or None if the frame is not plausible.

        Args:
            normaliser: Has the reference.
        """
        normaliser.rows_into(self.rows, self._scale, self._offset)
        np.multiply(self._counts, self._scale, out=self._exact)
        np.subtract(self._exact, self._offset, out=self._exact)
        square = float(self._exact.dot(self._exact))
        if not square <= LARGEST_CHANGE * LARGEST_CHANGE:
            return None
        self.far = square > LARGE_CHANGE
        self.gate.change[:] = self._exact
        return self.gate.touched()


class IdleMode:
    """Decides when to ask the device for which mode.

    Args:
        after_s: How long the sheet must have been untouched.
    """

    __slots__ = ("_after_ns", "_asked_ns", "_touched_ns", "switches")

    def __init__(self, after_s: float) -> None:
        if not after_s > 0:
            raise ValueError(f"idle_after_s is {after_s}, expected more than 0")
        self._after_ns = int(after_s * 1e9)
        self._touched_ns = -1
        self._asked_ns = -RETRY_NS
        self.switches = 0
        """Number of requests for another mode."""

    def step(self, now_ns: int, *, touched: bool, idle: bool) -> Mode | None:
        """Return the mode to ask for now, if any.

        Args:
            now_ns: Of this frame, on ``perf_counter_ns``.
            touched: It was touched, or the whole scan is needed for something else.
            idle: It is a frame of the idle mode.
        """
        if touched or self._touched_ns < 0:
            self._touched_ns = now_ns
        wanted = Mode.IDLE if now_ns - self._touched_ns >= self._after_ns else Mode.ACTIVE
        if (wanted == Mode.IDLE) == idle:
            self._asked_ns = now_ns - RETRY_NS  # what was asked for has come about
            return None
        if now_ns - self._asked_ns < RETRY_NS:
            return None
        self._asked_ns = now_ns
        self.switches += 1
        return wanted
