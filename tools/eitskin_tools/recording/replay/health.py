"""Electrodes and drift of a played recording: as they were found then, not judged anew."""

import math
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin.health.explanation import Finding
from eitskin.health.imputation import Consistency
from eitskin.health.monitor import Health
from eitskin.messaging.streams.measured import Conditions
from eitskin_tools.recording.codec import unpack_json
from eitskin_tools.recording.layout import FRAME, RecordingError
from eitskin_tools.recording.script import Script, Step

Distance = tuple[float, float, float]
"""Of a reference in percent: alike, its standard deviation, uneven; not a number while unknown."""

UNKNOWN: Final = (math.nan, math.nan, math.nan)

LARGEST: Final = 10**6
"""Percent; beyond it, and where it is no number, a distance is unknown."""


@dataclass(frozen=True, slots=True)
class Then:
    """What is noted of a frame."""

    events: tuple[str, ...]
    """At it: all of them where what was published was recorded, else what the states told."""
    skipped: tuple[str, ...]
    """What was left out for it; empty where what was published was not recorded."""
    distance: Distance
    """How far the sheet was from its reference."""

    @property
    def of_health(self) -> tuple[str, ...]:
        """Events of electrodes and drift."""
        return tuple(text for text in self.events if text.startswith(OURS))


OURS: Final = ("electrode", "drift")
"""What events of electrodes and drift begin with."""


class HealthThen(Health):
    """Takes from frames what was taken from them then; looks at none of them.

    Electrodes may still be excluded by hand, by a program that asks for it: those take the place of the recorded ones.

    Args:
        consistency: Of the bundle.
        exclude: Electrodes left out by hand.
    """

    def __init__(self, consistency: Consistency, exclude: tuple[int, ...]) -> None:
        super().__init__(consistency, exclude=exclude)
        self.by_hand: tuple[int, ...] | None = None
        """What a program asked for; None while none did."""

    def use(self, *arguments: Any, **keywords: Any) -> None:
        """Hold frames against another reference from now on, as the one before."""
        super().use(*arguments, **keywords)
        if self.gate_without_rows is not None:
            self.gate_without_rows.finish()  # nothing is done while the line rests

    def put_aside(self, counts: npt.NDArray[np.int32] | None = None, *, touched: bool) -> bool:
        """Keep nothing of the frame, and return whether somebody wants electrodes left out."""
        return self.due

    @property
    def due(self) -> bool:
        """Whether somebody wants electrodes left out."""
        return self._wanted is not None

    def look(self, predicted: npt.NDArray[np.float32]) -> bool:
        """Do what somebody wants of electrodes, and return whether other rows are missing from now on."""
        if (wanted := self._wanted) is not None:
            self.by_hand = tuple(sorted(set(wanted)))
        changed = super().look(predicted)
        if changed and self.gate_without_rows is not None:
            self.gate_without_rows.finish()
        return changed

    def go_on_with(self, conditions: Conditions) -> bool:
        """Let hold from the next frame on what held then, and return whether other rows are missing."""
        self.drift.go_on_with(conditions.drift)
        findings = tuple(Finding(*finding) for finding in conditions.electrodes)
        if (ours := self.by_hand) is not None:
            then = (one for one in findings if one.state != "excluded" and one.electrode not in ours)
            both = (*then, *(Finding(electrode, "excluded") for electrode in ours))
            findings = tuple(sorted(both, key=lambda one: one.electrode))
        if findings == self.electrodes.findings:
            return False
        self.electrodes.go_on_with(findings)
        self._rows_before = self.electrodes.missing
        if self.gate_without_rows is not None:
            self.gate_without_rows.leave_out(self.electrodes.missing)
            if ours is not None:
                self.gate_without_rows.finish()  # the recorded threshold is that of other rows
        return True

    def tell(self, events: tuple[str, ...], distance: Distance) -> None:
        """Say this with the next frame."""
        self._tell(events)
        self.drift.distance = distance


class Noted:
    """What a recording says of drift, and of what happened and was left out, frame by frame in their order.

    By what was published of each frame, exactly; where that was not recorded, by the states, of which one came a
    second, rounded as they are.

    Args:
        script: The recording.
        from_s: Begin so long after its first frame.
    """

    def __init__(self, script: Script, from_s: float | None) -> None:
        begin_ns = script.first_ns + int((from_s or 0.0) * 1e9)
        self._notes = _notes(script, begin_ns)
        self._note = next(self._notes, None)
        offset_ns = script.recording.wall_minus_host_ns
        made = ((state.get("made_ns"), state) for state in script.states)
        self._states = [(at + offset_ns, _drift_of(state)) for at, state in made if isinstance(at, int)]
        self._events: dict[int, tuple[str, ...]] = {}
        for state in script.states:
            events = state.get("events")
            for event in events if isinstance(events, list) else ():
                match event:
                    case [int(sequence), str(text)]:
                        self._events[sequence] = (*self._events.get(sequence, ()), text)

    def of(self, step: Step) -> Then:
        """Return what is noted of a frame."""
        frame, skipped = step.frame, tuple[str, ...]()
        events = self._events.get(-1 if frame.seq is None else frame.seq, ())
        distance = self._distance_at(step.log_ns)
        if frame.frame is not None:
            while self._note is not None and self._note["number"] < frame.frame:
                self._note = next(self._notes, None)
            if (note := self._note) is not None and note["number"] == frame.frame:
                events, skipped = _texts(note.get("events")), _texts(note.get("skipped"))
                distance = _numbers(note.get(name) for name in ("drift", "drift_sd", "drift_uneven"))
        return Then(events, skipped, distance)

    def _distance_at(self, log_ns: int) -> Distance:
        index = bisect_right(self._states, log_ns, key=lambda one: one[0])
        return self._states[max(index - 1, 0)][1] if self._states else UNKNOWN


def _notes(script: Script, begin_ns: int) -> Iterator[dict[str, Any]]:
    for entry in script.recording.entries({FRAME.topic}, begin_ns):
        try:
            note = unpack_json(entry.data)
        except RecordingError:
            continue
        if isinstance(note.get("number"), int):
            yield note


def _texts(values: Any) -> tuple[str, ...]:
    return tuple(text for text in values if isinstance(text, str)) if isinstance(values, list | tuple) else ()


def _drift_of(state: dict[str, Any]) -> Distance:
    status = state.get("status")
    drift = status.get("drift") if isinstance(status, dict) else None
    if not isinstance(drift, dict):
        return UNKNOWN
    return _numbers(drift.get(name) for name in ("percent", "sd_percent", "uneven_percent"))


def _numbers(values: Iterator[Any]) -> Distance:
    one, two, three = (
        float(value) if isinstance(value, int | float) and abs(value) <= LARGEST else math.nan for value in values
    )
    return one, two, three
