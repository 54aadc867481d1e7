"""A recording, computed once more from its first frame to its last."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from eitskin.model.bundle import Bundle
from eitskin_tools.recording.codec import unpack_json
from eitskin_tools.recording.layout import FRAME, RecordingError
from eitskin_tools.recording.reinfer.rerun import Computed, Rerun
from eitskin_tools.recording.reinfer.tally import Agreement, Equality
from eitskin_tools.recording.reinfer.verdicts import Judged, Verdicts
from eitskin_tools.recording.script import Script, Step

Progress = Callable[[int, int], None]


class Solving(Protocol):
    """What makes a map of each frame."""

    def compute(self, step: Step) -> Computed | None:
        """Return what becomes of a frame; None if it cannot be told."""


@dataclass(frozen=True, slots=True)
class Span:
    """Of a recording, in seconds since its first frame; None for all."""

    from_s: float | None = None
    to_s: float | None = None


@dataclass(slots=True)
class Maps:
    """Maps that are kept, for a file or a picture."""

    sequence: list[int]
    touched: list[bool]
    solver: list[str]
    maps: list[npt.NDArray[np.float32]]
    log_ns: list[int]
    judged: list[Judged | None]
    most: int

    @classmethod
    def empty(cls, most: int) -> "Maps":
        """Return room for so many."""
        return cls([], [], [], [], [], [], most)

    def add(self, step: Step, found: Computed) -> None:
        """Keep a copy of a frame's map.

        Raises:
            RecordingError: There are more than fit into memory.
        """
        if len(self.maps) >= self.most:
            raise RecordingError(f"more than {self.most} maps to keep: choose a part with --from and --to, or --every")
        self.sequence.append(step.frame.seq or 0)
        self.touched.append(found.touched)
        self.solver.append(found.solver)
        self.maps.append(found.map.copy())
        self.log_ns.append(step.log_ns)
        self.judged.append(found.judged)


@dataclass(frozen=True, slots=True, eq=False)
class Reinferred:
    """What came of it."""

    frames: int
    """Computed."""
    elapsed_s: float
    cpu_s: float
    recorded_s: float
    withheld: int
    equality: Equality | None
    """Against what was published; None with another bundle or solver."""
    agreement: Agreement | None
    """With what was running, of another bundle or solver."""
    maps: Maps | None
    others: Maps | None
    """Of what was running, beside ``maps``."""
    verdicts: Verdicts | None = None
    """Of a solver that asks physics."""

    def fields(self) -> dict[str, Any]:
        """Return plain values for ``--json``."""
        rate = self.frames / self.elapsed_s if self.elapsed_s > 0 else 0.0
        found: dict[str, Any] = {
            "frames": self.frames,
            "withheld": self.withheld,
            "elapsed_s": round(self.elapsed_s, 3),
            "cpu_s": round(self.cpu_s, 3),
            "recorded_s": round(self.recorded_s, 3),
            "frames_per_s": round(rate, 1),
            "frames_per_cpu_s": round(self.frames / self.cpu_s, 1) if self.cpu_s > 0 else None,
            "times_real_time": round(self.recorded_s / self.elapsed_s, 2) if self.elapsed_s > 0 else None,
        }
        if self.equality is not None:
            found |= self.equality.fields()
        if self.agreement is not None:
            found["against_recorded"] = self.agreement.fields()
        if self.verdicts is not None:
            found["verified"] = self.verdicts.fields()
        return found


def digests(script: Script) -> dict[int, str]:
    """Return the digest of each published map, by the number of the published frame."""
    found = {}
    for entry in script.recording.entries({FRAME.topic}):
        try:
            note = unpack_json(entry.data)
            found[int(note["number"])] = str(note["digest"])
        except (RecordingError, KeyError, TypeError, ValueError, OverflowError):
            continue
    return found


def reinfer(
    script: Script,
    bundle: Bundle,
    solver: Solving | None = None,
    *,
    span: Span = Span(),
    every: int = 1,
    keep: int = 0,
    progress: Progress | None = None,
) -> Reinferred:
    """Compute a recording once more.

    Args:
        script: The recording.
        bundle: The one that was running, for what is compared with it.
        solver: Another way to a map, held against the bundle's; None for the bundle itself, held against what was
            published.
        span: Which part.
        every: Of the frames one in so many goes to ``solver``, or into what is kept.
        keep: How many maps may be kept; 0 for none.
        progress: Called with the frames done and all frames.

    Raises:
        SkinError: The recording, its reference or its clouds cannot be used with the bundle.
    """
    rerun = Rerun(script, bundle)
    published = digests(script) if solver is None and rerun.as_recorded else {}
    equality = Equality() if published else None
    agreement = None if solver is None else Agreement(bundle.skin.grid.pixel_mm)
    maps, others = (Maps.empty(keep) if keep else None), (Maps.empty(keep) if keep and solver is not None else None)
    count = withheld = 0
    before: Step | None = None
    first_ns = last_ns = 0
    start_s, start_cpu_s = time.perf_counter(), time.process_time()
    for step in script.steps(span.from_s, span.to_s):
        first_ns, last_ns = first_ns or step.log_ns, step.log_ns
        found = rerun.compute(step, every=keep > 0 or solver is not None)
        before = _together(before, step)
        other = None
        if solver is not None and count % every == 0:
            other, before = solver.compute(before), None
        count += 1
        withheld += bool(step.frame.withheld)
        if progress is not None and count % 200 == 0:
            progress(count, script.frames)
        if equality is not None:
            _hold(equality, step, found, published)
        if agreement is not None and found is not None and other is not None:
            agreement.add(found, other)
        shown = found if solver is None else other
        if maps is not None and shown is not None and (count - 1) % every == 0:
            maps.add(step, shown)
            if others is not None and found is not None:
                others.add(step, found)
    elapsed_s, cpu_s = time.perf_counter() - start_s, time.process_time() - start_cpu_s
    recorded_s, verdicts = (last_ns - first_ns) * 1e-9, getattr(solver, "verdicts", None)
    return Reinferred(count, elapsed_s, cpu_s, recorded_s, withheld, equality, agreement, maps, others, verdicts)


def _together(before: Step | None, step: Step) -> Step:
    """Return a frame with all that changed at those before it, which were left out."""
    if before is None:
        return step
    return Step(
        step.frame,
        step.log_ns,
        step.conditions or before.conditions,
        step.cloud or before.cloud,
        step.reference or before.reference,
    )


def _hold(equality: Equality, step: Step, found: Computed | None, published: dict[int, str]) -> None:
    """Hold one frame against what was published of it."""
    frame = step.frame
    if found is not None and frame.seq is not None and frame.map_seq == frame.seq:
        equality.computed(frame.seq, found)
    if frame.frame is not None and frame.frame in published:
        equality.published_as(frame, published[frame.frame], found)
