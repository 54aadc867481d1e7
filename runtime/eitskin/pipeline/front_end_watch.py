"""Holds frames against what a living front end can read (:mod:`eitskin.reference.front_end`), in counts.

A frame near its reference is not looked at: whatever is stuck is far from it. So this costs a stream at rest nothing,
and a touched or bent one a few microseconds a frame.
"""

import numpy as np
import numpy.typing as npt

from eitskin.pipeline.idle import IdleGate
from eitskin.pipeline.intake import Intake
from eitskin.reference.captured import Reference
from eitskin.reference.front_end import patience, stuck
from eitskin.reference.normaliser import Normaliser
from eitskin_proto.sensor.table import N_ROWS, RECIPROCAL_IN_FULL, ROW_IN_FULL
from eitskin_proto.wire.frames import full_scale


class FrontEndWatch:
    """Judges the frame in hand.

    Args:
        sample_bytes: Of the device's samples.
        intake: Has the frame's counts; is told how many repetitions are chance.
        idle_gate: Has the rows of a scan of a few drives.
    """

    __slots__ = ("_idle_gate", "_intake", "_limit", "_reference")

    def __init__(self, sample_bytes: int, intake: Intake, idle_gate: IdleGate | None) -> None:
        self._limit = full_scale(sample_bytes)
        self._intake, self._idle_gate = intake, idle_gate
        self._reference: npt.NDArray[np.float64] | None = None

    def use(self, reference: Reference, step_V: float) -> None:
        """Judge by another reference from the next frame on.

        Args:
            reference: The reference.
            step_V: Of one count.
        """
        self._reference = reference.voltages_V / step_V
        self._reference[reference.weak] = 0.0
        spread = reference.spread_V / step_V
        idle = None if self._idle_gate is None else patience(spread[self._idle_gate.rows])
        self._intake.most_repeats = (patience(spread), idle)

    def look(self, normaliser: Normaliser) -> str:
        """Return what no sheet reads in the rows of a whole frame, or "".

        Args:
            normaliser: Has the frame.
        """
        cut_off = self._intake.saturation
        if cut_off and len(self._intake.counts) != N_ROWS:
            bits = np.array([cut_off >> row & 1 for row in range(len(self._intake.counts))], dtype=bool)
            both = bits[ROW_IN_FULL] | bits[RECIPROCAL_IN_FULL]
            cut_off = int.from_bytes(np.packbits(both, bitorder="little").tobytes(), "little")
        return stuck(normaliser.counts, self._reference, cut_off, self._limit)

    def look_idle(self) -> str:
        """Return the same of a frame of a few drives."""
        assert self._idle_gate is not None
        reference = None if self._reference is None else self._reference[self._idle_gate.rows]
        return stuck(self._intake.counts, reference, self._intake.saturation, self._limit)
