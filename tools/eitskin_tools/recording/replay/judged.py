"""What a played recording's frames were judged by what lay before them: taken from the recording, not judged anew.

The gate holds a frame against the untouched frames before it, one untouched frame in 50 is looked at all the same, and
a map is kept while only noise changes. A part of a recording, and one that began in mid-stream, lacks those frames
before. So each frame of the wire says itself whether it was touched, and which frame's map it had. The judges go on
beside, and judge whatever the recording does not say.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from eitskin.messaging.streams.measured import WireFrame
from eitskin.model.changes import Array, Changes
from eitskin.model.matched_filters import Filters
from eitskin.pipeline.frame_pipeline import Pipeline
from eitskin.pipeline.gate_audit import GateAudit, Rows, audit_pixels
from eitskin.pipeline.stillness import Stillness

OVERRULED = "gate_overruled"
"""The event of a frame whose map showed a touch that the gate did not see."""


@dataclass(slots=True)
class Said:
    """What was said then of the frame to come; None where it is not known."""

    touched: bool | None = None
    """By the gate."""
    looked: bool | None = None
    """Its map was computed although the gate called it untouched."""
    still: bool | None = None
    """It had the map of an earlier frame."""


class ChangesThen(Changes):
    """The gate's memory; what it says is what was said."""

    __slots__ = ("_said",)

    def __init__(self, filters: Filters, width: int, said: Said) -> None:
        self._said = said
        super().__init__(filters, width)

    def step(self, response: Array, touched: bool) -> bool:
        """Return whether a frame was touched."""
        found = super().step(response, touched)
        return found if self._said.touched is None else self._said.touched


class AuditThen(GateAudit):
    """Looks at those untouched frames that were looked at."""

    __slots__ = ("_said",)

    def __init__(self, pixels: int | None, n_pixels: int, said: Said) -> None:
        self._said = said
        super().__init__(pixels, n_pixels)

    def looks(self, rows: Rows | None) -> bool:
        """Return whether an untouched frame was inferred all the same."""
        found = super().looks(rows)
        return found if self._said.looked is None else self._said.looked


class StillnessThen(Stillness):
    """Calls those frames still whose map was kept."""

    __slots__ = ("_said",)

    def __init__(self, said: Said) -> None:
        self._said = said
        super().__init__()

    def still(self, change: npt.NDArray[np.float32]) -> bool:
        """Return whether a frame had an earlier one's map."""
        found = super().still(change)
        return found if self._said.still is None else self._said.still


class JudgedThen:
    """Has a pipeline's judges say what they said; before its reference is used.

    Args:
        pipeline: Of the bundle that was running.
    """

    def __init__(self, pipeline: Pipeline) -> None:
        self._said = said = Said()
        gate, pixels = pipeline.gate, pipeline.skin.grid.n_pixels
        if gate is not None and gate.changes is not None and gate.filters is not None:
            gate.changes = ChangesThen(gate.filters, gate.response.size, said)
        pipeline.audit = AuditThen(audit_pixels(pipeline.bundle.gate_arrays(), pixels), pixels, said)
        if pipeline.maps.keeps_unchanged:
            pipeline.maps.stillness = StillnessThen(said)

    def go_on_with(self, frame: WireFrame, events: tuple[str, ...], skipped: tuple[str, ...]) -> None:
        """Take what was said of the frame to come.

        Args:
            frame: It.
            events: At it, as far as they are known.
            skipped: What was left out for it, as far as that is known.
        """
        said = self._said
        if frame.withheld or frame.seq is None:
            self.judge()
            return
        overruled = OVERRULED in events
        said.touched = frame.touched and not overruled
        said.looked = overruled or "map:untouched" in skipped
        said.still = None if frame.map_seq is None or frame.solver == "none" else frame.map_seq != frame.seq

    def judge(self) -> None:
        """Let the frame to come be judged anew: what was said is of something else."""
        self._said.touched = self._said.looked = self._said.still = None
