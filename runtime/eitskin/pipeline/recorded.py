"""The recorded decisions about frames, so that the pipeline repeats them when it computes the frames again.

The pipeline's decisions depend on earlier frames: the gate compares a frame with untouched ones, one untouched frame in
50 is inferred, a map is kept while only noise changes, and electrodes and drift are estimated over many frames. A part
of a recording lacks those frames. So each decision can be given to the pipeline (:class:`FrameDecisions`), and
electrodes and drift are taken from the recorded conditions (:class:`RecordedHealth`).
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from eitskin.health.explanation import Finding
from eitskin.health.imputation import Consistency
from eitskin.health.monitor import Health
from eitskin_proto.sensor.row_gaussian import rows_of
from eitskin_proto.sensor.table import N_ROWS

Distance = tuple[float, float, float]
"""Of a reference in percent: alike in all rows, its standard deviation, uneven; not a number while unknown."""


@dataclass(slots=True)
class FrameDecisions:
    """The recorded decisions about the next frame; None where the pipeline decides."""

    touched: bool | None = None
    """The gate calls it touched."""
    inferred_untouched: bool | None = None
    """Its map is computed although the gate calls it untouched."""
    keeps_map: bool | None = None
    """It has the map of an earlier frame."""
    fused: int = 1
    """Frames that its map rests on, where ``keeps_map`` says whose it is."""
    solver: str | None = None
    """Name of the engine that computes its map."""

    def clear(self) -> None:
        """Let the pipeline decide everything of the frame to come."""
        self.touched = self.inferred_untouched = self.keeps_map = self.solver = None
        self.fused = 1


class RecordedHealth(Health):
    """Takes electrodes and drift from recorded conditions, without examining frames.

    A program may still exclude electrodes: these replace the recorded ones.

    Args:
        consistency: Of the bundle.
        exclude: Electrodes left out by hand.
    """

    def __init__(self, consistency: Consistency, exclude: tuple[int, ...] = ()) -> None:
        super().__init__(consistency, exclude=exclude)
        self.by_hand: tuple[int, ...] | None = None
        """Electrodes that a program asked to exclude; None while none did."""

    def use_reference(self, *arguments: Any, **keywords: Any) -> None:
        """Hold frames against another reference from now on."""
        super().use_reference(*arguments, **keywords)
        if self.gate_without_rows is not None:
            self.gate_without_rows.finish()  # nothing is done while the line rests

    def put_aside(self, counts: npt.NDArray[np.int32] | None = None, *, touched: bool) -> bool:
        """Keep nothing of the frame, and return whether a program wants electrodes excluded."""
        return self.due

    @property
    def due(self) -> bool:
        """Whether a program wants electrodes excluded."""
        return self._wanted is not None

    def examine(self, predicted: npt.NDArray[np.float32]) -> bool:
        """Exclude the electrodes that a program named, and return whether other rows are missing from now on."""
        if (wanted := self._wanted) is not None:
            self.by_hand = tuple(sorted(set(wanted)))
        changed = super().examine(predicted)
        if changed and self.gate_without_rows is not None:
            self.gate_without_rows.finish()
        return changed

    def use_recorded(
        self,
        drift: npt.NDArray[np.float32] | None,
        electrodes: Iterable[tuple[int, str, int | None]],
        missing_rows: Iterable[int] = (),
    ) -> bool:
        """Use recorded conditions from the next frame on, and return whether other rows are missing.

        Args:
            drift: (104,) factors on 1 + dV; None for none.
            electrodes: Number, state and partner of each that has failed or is excluded.
            missing_rows: Numbers of the rows that were filled in.
        """
        self.drift.set_factors(drift)
        findings = tuple(Finding(*finding) for finding in electrodes)
        frozen = np.isin(np.arange(N_ROWS), list(missing_rows))
        frozen &= ~rows_of(tuple(one.electrode for one in findings if one.remedy == "imputed"))
        if (by_hand := self.by_hand) is not None:
            recorded = (one for one in findings if one.state != "excluded" and one.electrode not in by_hand)
            both = (*recorded, *(Finding(electrode, "excluded") for electrode in by_hand))
            findings = tuple(sorted(both, key=lambda one: one.electrode))
        if findings == self.electrodes.findings and np.array_equal(frozen, self.hanging):
            return False
        self.hanging = frozen
        self.electrodes.leave_out(frozen, findings)
        self._rows_before = self.electrodes.missing
        if self.gate_without_rows is not None:
            self.gate_without_rows.leave_out(self.electrodes.missing)
            if by_hand is not None:
                self.gate_without_rows.finish()  # the recorded threshold is that of other rows
        return True

    def report(self, events: tuple[str, ...], distance: Distance) -> None:
        """Put recorded events and drift into the next frame."""
        self._add_events(events)
        self.drift.distance = distance
