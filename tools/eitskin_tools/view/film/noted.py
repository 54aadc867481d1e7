"""What was published of a recorded frame, as a subscriber would have got it; unknown where nobody noted it."""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin.messaging.frame import COUNTS, MAX_TEXT, MAX_TEXTS, STAGES, Frame
from eitskin_tools.recording.reinfer.rerun import Computed
from eitskin_tools.recording.script import Step
from eitskin_tools.recording.told import Told

LONGEST: Final = 10**300
"""Of a number: a whole one may be larger than any that a page understands."""

LARGEST: Final = 1 << 53
"""Of a count that a page understands."""


def blank(told: Told, nothing: npt.NDArray[np.float32]) -> Frame:
    """Return a frame of which only that is known which all of a recording have.

    Args:
        told: The recording.
        nothing: The map of an untouched sheet.
    """
    return Frame(
        map=nothing, touched=False, sequence=0, number=0, device_us=0, host_ns=dict.fromkeys(STAGES, 0), received_ns=0,
        age_us=0, solver="none", skipped=(), events=(), electrodes=(), drift_percent=None, drift_sd_percent=None,
        drift_uneven_percent=None, gate_logit=0.0, cloud=0, weak_rows=0, map_sequence=0, regions=(),
        counts=dict.fromkeys(COUNTS, 0), configuration=told.told("configuration"), bundle=told.told("bundle"),
        serial_number=told.told("serial"), run=told.told("run"), same_host=True,
    )  # fmt: skip


def published(step: Step, note: Mapping[str, Any], found: Computed, first_ns: int) -> dict[str, Any]:
    """Return the fields of a frame.

    Args:
        step: As it was measured.
        note: What was noted of it; empty where nothing was.
        found: As it was computed now.
        first_ns: Wall clock of the recording's first frame, from which time is counted.
    """
    frame = step.frame
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
    return value if type(value) is int and 0 <= value <= LARGEST else 0


def number(value: Any) -> float | None:
    """Return a finite number; None for what is none."""
    return float(value) if isinstance(value, int | float) and abs(value) <= LONGEST else None


def texts(value: Any) -> tuple[str, ...]:
    """Return short texts; those that are none are left out."""
    found = value if isinstance(value, list) else []
    return tuple(text[:MAX_TEXT] for text in found[:MAX_TEXTS] if isinstance(text, str))
