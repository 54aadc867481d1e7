"""The frames of a recording as a subscriber gets them: with maps and touches, computed from the measurements.

Maps come from the runtime's own pipeline, so a recording without maps shows them too, also by another bundle. Where
only noise had changed, a published frame has the map of an earlier one. If that frame is before the part being read,
the frame's own map is computed.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin.frame_record import STAGES
from eitskin.messaging.frame import COUNTS, MAX_TEXT, MAX_TEXTS, Frame
from eitskin.model.bundle import Bundle
from eitskin.model.engine import default_solver
from eitskin.model.taught import TaughtFinder
from eitskin.touches.touch import LAYOUT, unpack_touches
from eitskin.touches.watch import TouchWatch
from eitskin_tools.recording.reinfer import NO_SOLVER, ComputedFrame, Rerun
from eitskin_tools.recording.script import Script, Step


class RecordedFrames:
    """Computes the frames of any part of a recording.

    Args:
        script: The recording.
        bundle: Computes the maps.

    Raises:
        BundleError: The bundle cannot be used.
    """

    def __init__(self, script: Script, bundle: Bundle) -> None:
        self._script, self._grid, self._touch_kind = script, bundle.skin.grid, bundle.touch_kind
        self._rerun = Rerun(script, bundle)
        self.shape = self._grid.shape
        """(rows, columns) of its maps."""
        self._nothing = np.zeros(self._grid.shape, dtype=np.float32)
        self._solver = default_solver(bundle)
        self._blank = blank(script, self._nothing)

    def watch(self) -> TouchWatch:
        """Return what numbers the touches of parts that follow each other."""
        field = self._rerun.field
        finder = None if field is None else TaughtFinder(field, self._grid)
        return TouchWatch(self._grid, finder, self._touch_kind)

    def part(self, from_s: float | None, to_s: float | None, watch: TouchWatch) -> Iterator[tuple[Step, Frame | None]]:
        """Yield each frame of the wire, and as a subscriber gets it; None for a frame that cannot be computed.

        Args:
            from_s: Begin so long after the first frame.
            to_s: End so long after it.
            watch: Numbers the touches; it may have seen the part before.

        Raises:
            SkinError: Reference or cloud cannot be used with the bundle.
            OSError: The file cannot be read any more.
        """
        cloud, kept, shown = 0, self._nothing, -1
        for step in map(self._with_map, self._script.part(from_s, to_s)):
            frame = step.frame
            cloud = cloud if step.cloud is None else step.cloud.revision
            stands = self._rerun.as_recorded and frame.map_seq == shown
            found = self._rerun.compute(step, every=not stands)
            if found is None or frame.seq is None:
                yield step, None
                continue
            has_map = found.touched and found.solver != NO_SOLVER
            if has_map and not stands:  # it stays while frames go out without one: a later one may have it
                kept, shown = found.map, frame.seq if frame.map_seq is None else frame.map_seq
            values = kept if has_map else self._nothing
            flat = values.ravel().astype(float) if has_map else None
            listed = watch.update(flat, shown, self._rerun.surface, frame.device_us or 0, frame.fused)
            touches = unpack_touches(listed[0], LAYOUT.size, *listed[1:])
            told = published(step, found, self._script.first_ns)
            yield step, replace(self._blank, **told, map=values, cloud=cloud, touch_list=touches)

    def _with_map(self, step: Step) -> Step:
        """Return a frame as if its map had been requested, which a recorder alone does not do."""
        frame = step.frame
        if not frame.touched or frame.solver != NO_SOLVER:
            return step
        return replace(step, frame=replace(frame, solver=self._solver, map_seq=frame.seq))


MAX_NUMBER: Final = 10**300
"""Of a number: a whole one may be larger than any that a page understands."""

MAX_COUNT: Final = 1 << 53
"""Of a count that a page understands."""


def blank(told: Script, nothing: npt.NDArray[np.float32]) -> Frame:
    """Return a frame with only the values common to all frames of a recording.

    Args:
        told: The recording.
        nothing: The map of an untouched sheet.
    """
    return Frame(
        map=nothing, touched=False, sequence=0, number=0, device_us=0, host_ns=dict.fromkeys(STAGES, 0), received_ns=0,
        age_us=0, solver="none", skipped=(), events=(), electrodes=(), drift_percent=None, drift_sd_percent=None,
        drift_uneven_percent=None, gate_logit=0.0, cloud=0, weak_rows=0, map_sequence=0, regions=(),
        counts=dict.fromkeys(COUNTS, 0), configuration=told.head_text("configuration"), bundle=told.head_text("bundle"),
        serial_number=told.head_text("serial"), run=told.head_text("run"), same_host=True,
    )  # fmt: skip


def published(step: Step, found: ComputedFrame, first_ns: int) -> dict[str, Any]:
    """Return the fields of a frame.

    Args:
        step: As it was measured.
        found: As it was computed now.
        first_ns: Wall clock of the recording's first frame, from which time is counted.
    """
    frame, note = step.frame, step.note
    stamps = note.get("host_ns")
    stamps = stamps if isinstance(stamps, dict) else {}
    counts = note.get("counts")
    counts = counts if isinstance(counts, dict) else {}
    return {
        "touched": found.touched,
        "solver": found.solver,
        "sequence": frame.seq or 0,
        "number": frame.n if frame.frame is None else frame.frame,
        "device_us": frame.device_us or 0,
        "received_ns": step.log_ns - first_ns,
        "host_ns": {stage: count(stamps.get(stage)) or frame.read_ns for stage in STAGES},
        "age_us": count(note.get("age_us")),
        "skipped": texts(note.get("skipped")),
        "events": texts(note.get("events")),
        "electrodes": texts(note.get("electrodes")),
        "drift_percent": number(note.get("drift")),
        "drift_sd_percent": number(note.get("drift_sd")),
        "drift_uneven_percent": number(note.get("drift_uneven")),
        "counts": {name: count(counts.get(name)) for name in COUNTS},
    }


def count(value: Any) -> int:
    """Return a count; 0 for what is none."""
    return value if type(value) is int and 0 <= value <= MAX_COUNT else 0


def number(value: Any) -> float | None:
    """Return a finite number; None for what is none."""
    return float(value) if isinstance(value, int | float) and abs(value) <= MAX_NUMBER else None


def texts(value: Any) -> tuple[str, ...]:
    """Return short texts; those that are none are left out."""
    found = value if isinstance(value, list) else []
    return tuple(text[:MAX_TEXT] for text in found[:MAX_TEXTS] if isinstance(text, str))
