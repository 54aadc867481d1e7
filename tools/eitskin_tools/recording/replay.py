"""Plays a recording: the ordinary runtime reads it from a line that answers as the device did.

:class:`Player` uses the bundle, the reference and the solver of the recording unless others are named. A cloud takes
effect before the frame that met it first, and so does a reference that was captured anew. Excluded and failed
electrodes, drift and the gate's threshold are those of the recording, and so are the decisions about each frame
(:mod:`eitskin.pipeline.recorded`). With another bundle the runtime determines all of this itself.

:class:`RecordedLine` answers the handshake with the recorded HELLO, acknowledges requests, and after START sends the
frames at their pace, or each as soon as the one before is done. A change before a frame, such as a new cloud, takes
place in the reader's thread after the previous frame. Sequence numbers and the device's clock go on when the recording
is played again and again.
"""

import math
import struct
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from queue import Empty, SimpleQueue
from time import perf_counter_ns
from typing import Final

from eitskin.errors import BundleError, HandshakeError
from eitskin.health.imputation import Consistency
from eitskin.messaging.streams.measured import Conditions
from eitskin.model.bundle import Bundle
from eitskin.model.engine import solvers
from eitskin.pipeline.idle import IdleGate
from eitskin.pipeline.recorded import RecordedHealth
from eitskin.reference.captured import Reference
from eitskin.skin import Skin
from eitskin_proto.errors import SkinError
from eitskin_proto.wire.codes import Code, MessageType
from eitskin_proto.wire.framing import Deframer, encode
from eitskin_proto.wire.messages import Ack, Hello, Time
from eitskin_proto.wire.volts import LARGEST_VOLTS
from eitskin_tools.recording.frames import number, texts
from eitskin_tools.recording.layout import RecordingError
from eitskin_tools.recording.script import Script, Step, bundle_of, reference_of

_SEQUENCE: Final = struct.Struct("<II")
_AT: Final = 8
"""Where sequence and device_us stand in a frame's payload."""

MIN_GAP_US: Final = 1000
"""Between the last frame of one round and the first of the next, where one frame is all that there is."""


class RecordedLine:
    """A :class:`eitskin.acquisition.transport.Transport` that plays steps.

    Args:
        name: Its name for people.
        hello: Of the device.
        steps: Returns the steps of one round.
        paced: Send each frame at its time; else as soon as the previous one is done.
        loop: Begin again at the end.
        speed: How many times faster than they came.
    """

    line_bytes_per_s = 0
    largest_payload = LARGEST_VOLTS

    def __init__(
        self,
        name: str,
        hello: Hello,
        steps: Callable[[], Iterator[Step]],
        *,
        paced: bool = True,
        loop: bool = False,
        speed: float = 1.0,
    ) -> None:
        self.name = name
        self.before: Callable[[Step], None] = lambda _: None
        """Does what belongs before a frame."""
        self.ended: Callable[[], None] = lambda: None
        """Called once, behind the last frame."""
        self.sent = 0
        """Frames so far."""
        self.rounds = 0
        """Ends of the recording that were met so far."""
        self._hello, self._make, self._paced, self._loop, self._speed = hello, steps, paced, loop, speed
        self._steps = steps()
        self._deframer = Deframer()
        self._answers: deque[bytes] = deque()
        self._wakes: SimpleQueue[None] = SimpleQueue()  # a signal handler may put into it amid a wait, as into no Event
        self._cancelled = False
        self._streaming = self._over = False
        self._next: Step | None = None
        self._start_ns = self._first_log_ns = self._last_log_ns = 0
        self._first: tuple[int, int] | None = None
        self._last = self._ahead = 0, 0

    def read(self, timeout_s: float | None = None) -> bytes:
        """Return answers, or one frame whose time has come; nothing after the timeout or ``cancel``."""
        if self._answers:
            found = b"".join(self._answers)
            self._answers.clear()
            return found
        deadline_ns = None if timeout_s is None else perf_counter_ns() + int(timeout_s * 1e9)
        step = self._upcoming() if self._streaming and timeout_s != 0.0 else None
        while True:
            now_ns = perf_counter_ns()
            due_ns = None if step is None else self._due_ns(step, now_ns)
            if step is not None and due_ns is not None and now_ns >= due_ns:
                self._next, self._last_log_ns = None, step.log_ns
                self.sent += 1
                return encode(self._renumbered(step.frame.payload), LARGEST_VOLTS)
            if self._cancelled:
                self._cancelled = False
                return b""
            moments = [moment for moment in (deadline_ns, due_ns) if moment is not None]
            wait_ns = min(moments) - now_ns if moments else None
            if deadline_ns is not None and now_ns >= deadline_ns:
                return b""
            with suppress(Empty):
                self._wakes.get(timeout=None if wait_ns is None else max(wait_ns, 0) * 1e-9)

    @property
    def pause_s(self) -> float:
        """How long after the last frame the next one is due: a gap of the recording is no silence of the device."""
        step = self._next
        if step is None or not self._paced or not self._last_log_ns:
            return 0.0
        return max(step.log_ns - self._last_log_ns, 0) * 1e-9 / self._speed

    def _upcoming(self) -> Step | None:
        """Return the step to come, everything done that belongs before it; None at the end."""
        if self._next is None and not self._over:
            self._next = next(self._steps, None)
            if self._next is None:
                self._next = self._next_round()
            if self._next is not None:
                self.before(self._next)
        return self._next

    def _next_round(self) -> Step | None:
        self.rounds += 1
        if self._loop and self._first is not None:
            first, last = self._first, self._last
            gap_us = max((last[1] - first[1]) // max(last[0] - first[0], 1), MIN_GAP_US)
            self._ahead = self._ahead[0] + last[0] + 1 - first[0], self._ahead[1] + last[1] + gap_us - first[1]
            self._start_ns = 0
            self._steps = self._make()
            self._first = None
            if (found := next(self._steps, None)) is not None:
                return found
        self._over = True
        self.ended()
        return None

    def _due_ns(self, step: Step, now_ns: int) -> int:
        if not self._paced:
            return now_ns
        if not self._start_ns:
            self._start_ns, self._first_log_ns = now_ns, step.log_ns
        return self._start_ns + int((step.log_ns - self._first_log_ns) / self._speed)

    def _renumbered(self, payload: bytes) -> bytes:
        """Return a frame that goes on where the round before ended."""
        if len(payload) < _AT + _SEQUENCE.size:
            return payload
        found = _SEQUENCE.unpack_from(payload, _AT)
        self._first = self._first or found
        self._last = found
        if self._ahead == (0, 0):
            return payload
        whole = bytearray(payload)
        _SEQUENCE.pack_into(whole, _AT, *((a + b) & 0xFFFFFFFF for a, b in zip(found, self._ahead, strict=True)))
        return bytes(whole)

    def write(self, data: bytes) -> None:
        """Take requests; their answers come with the next ``read``."""
        for payload in self._deframer.feed(data):
            if answer := self._answer(payload):
                self._answers.append(encode(answer, LARGEST_VOLTS))
        self._wakes.put(None)

    def _answer(self, payload: bytes) -> bytes:
        kind, tag = payload[0], payload[1] if len(payload) > 1 else 0
        if kind == MessageType.HELLO_REQUEST:
            return replace(self._hello, tag=tag).pack()
        if kind == MessageType.TIME_REQUEST:
            return Time(self._device_us(), tag).pack()
        if kind == MessageType.START:
            self._streaming = True
        elif kind == MessageType.STOP:
            self._streaming = False
        elif kind != MessageType.SET_MODE:  # which idle frames were recorded, their own mode says
            return Ack(kind, Code.UNKNOWN_TYPE, len(payload), tag).pack()
        return Ack(kind, Code.OK, 0, tag).pack()

    def _device_us(self) -> int:
        """Return the device's clock: that of the frame to come, less what is left until it is sent."""
        if self._next is None and not self._over:
            self._next = next(self._steps, None)
            if self._next is not None:
                self.before(self._next)
        if self._next is None or len(self._next.frame.payload) < _AT + _SEQUENCE.size:
            return 0
        step, now_ns = self._next, perf_counter_ns()
        left_us = int(max(self._due_ns(step, now_ns) - now_ns, 0) * self._speed) // 1000 if self._start_ns else 0
        return int(_SEQUENCE.unpack_from(step.frame.payload, _AT)[1] + self._ahead[1] - left_us) & 0xFFFFFFFF

    def cancel(self) -> None:
        """Make the ``read`` that waits now, or else the next one, return at once; safe in a signal handler."""
        self._cancelled = True
        self._wakes.put(None)

    def report(self) -> list[str]:
        """Return how it is played, a line for people."""
        how = f"at {self._speed:g} times its pace" if self._paced else "as fast as possible"
        return [f"{self.name}: played {how}{', again and again' if self._loop else ''}"]

    def close(self) -> None:
        """End it; closing twice is fine."""
        self._over = True
        self._wakes.put(None)


HEALTH_EVENTS: Final = ("electrode", "drift")
"""What events of electrodes and drift begin with."""

GATE_OVERRULED: Final = "gate_overruled"
"""The event of a frame whose map showed a touch that the gate did not see."""

NEVER_S = 1e8
"""The recording determines when the device idles; requests have no effect."""


@dataclass(frozen=True, slots=True)
class ReplayOptions:
    """How a recording is played."""

    paced: bool = True
    """At the pace at which it came, not as fast as it can be computed."""
    loop: bool = False
    from_s: float | None = None
    to_s: float | None = None
    speed: float = 1.0


class Player:
    """An open skin that plays a recording; leave it with ``close`` or as a context manager.

    Args:
        script: The recording.
        manner: How.
        bundle: A file; None for the bundle that was running, if it is a shipped one.
        solver: The most accurate solver to use; None for the one that was.
        tell: Takes a line on what could not be done.

    Raises:
        SkinError: Bundle, reference or recording cannot be used, with what to do.
        ValueError: The bundle has no such solver.
    """

    def __init__(
        self,
        script: Script,
        manner: ReplayOptions = ReplayOptions(),
        *,
        bundle: str | Path | None = None,
        solver: str | None = None,
        tell: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._script, self._warn = script, tell
        loaded = bundle_of(script, bundle)
        if solver is None:
            then = script.head_text("solvers").split()
            solver = then[0] if then and then[0] in solvers(loaded) else None
        first, left_out = _first_known(script, manner)
        if left_out:
            tell(f"the recording does not say what its first {left_out} frames met: they are left out")
        assert first.conditions is not None
        assert first.reference is not None
        began, reference = first.conditions, reference_of(script, first.reference, loaded.skin)

        def steps() -> Iterator[Step]:
            return islice(script.steps(manner.from_s, manner.to_s), left_out, None)

        self._same = loaded.id == script.head_text("bundle")
        arrays = loaded.consistency_arrays() if self._same else None
        exclude = tuple(one for one, state, _ in began.electrodes if state == "excluded")
        self._health = None if arrays is None else RecordedHealth(Consistency.of(arrays), exclude)

        self.line = RecordedLine(
            str(script.path), script.hello, steps, paced=manner.paced, loop=manner.loop, speed=manner.speed
        )
        self.skin = Skin(
            self.line,
            bundle=loaded,
            reference=reference,
            solver=solver,
            skip_unchanged=began.skip_unchanged,
            exclude=exclude,
            idle_after_s=NEVER_S if _has_idle_gate(loaded, script.hello) else None,
        )
        self._reference, self._rounds = began.reference, 0
        if self._health is not None:
            self.skin.pipeline.health = self._health
        self._use_reference(reference)
        self.line.before = self._before
        self.line.ended = self.skin.stop

    def _before(self, step: Step) -> None:
        """Let hold what holds from a frame on."""
        if self.line.rounds != self._rounds:
            self._rounds = self.line.rounds
            self.skin.pipeline.forget_frames()
        self._decide(step)
        if step.conditions is None:
            return
        self.skin.loop.source.deferred.do()  # streams tell of the frame before, by what held for it
        if step.reference is not None and step.conditions.reference != self._reference:
            self._reference = step.conditions.reference
            try:
                self._use_reference(reference_of(self._script, step.reference, self.skin.bundle.skin))
            except SkinError as error:
                self._warn(f"a reference of the recording is left out: {error}")
        self._use_conditions(step.conditions)
        if step.cloud is not None and not (step.cloud.why == "start" and self.skin.pipeline.record.cloud == 0):
            one = step.cloud
            is_flat = one.why in ("start", "flat")
            surface = (None,) * 3 if is_flat else (one.cloud, one.predicted, one.predicted_flat)
            try:
                self.skin.use_cloud(*surface, is_fitted=one.why == "fitted")
            except (SkinError, ValueError) as error:
                self._warn(f"cloud {step.cloud.revision} of the recording is left out: {error}")

    def _use_reference(self, reference: Reference) -> None:
        """Hold frames against a recorded reference."""
        self.skin.loop.use_reference(reference)
        self._held_against = self.skin.loop.reference

    def _decide(self, step: Step) -> None:
        """Give the pipeline what was decided of a frame, as far as it still holds."""
        if not self._same:
            return
        frame, note = step.frame, step.note
        events = texts(note.get("events"))
        if self._health is not None:
            told = tuple(text for text in events if text.startswith(HEALTH_EVENTS))
            distances = (number(note.get(name)) for name in ("drift", "drift_sd", "drift_uneven"))
            drift, sd, uneven = (math.nan if value is None else value for value in distances)
            self._health.report(told, (drift, sd, uneven))
        decided = self.skin.pipeline.decisions
        by_hand = self._health is not None and self._health.by_hand is not None
        if by_hand or self.skin.loop.reference is not self._held_against or frame.withheld or frame.seq is None:
            decided.clear()
            return
        overruled = GATE_OVERRULED in events
        decided.touched = frame.touched and not overruled
        decided.inferred_untouched = overruled or "map:untouched" in texts(note.get("skipped"))
        decided.keeps_map = None if frame.map_seq is None or frame.solver == "none" else frame.map_seq != frame.seq
        decided.fused = frame.fused

    def _use_conditions(self, conditions: Conditions) -> None:
        pipeline = self.skin.pipeline
        if conditions.volts_per_count != pipeline.normaliser.volts_per_count:
            pipeline.normaliser.use_scale(conditions.volts_per_count)
        if self._health is None:
            return
        if self._health.use_recorded(conditions.drift, conditions.electrodes, conditions.missing_rows):
            pipeline.leave_out_missing()
        threshold = conditions.gate_threshold
        if pipeline.gate is not None and threshold is not None and self._health.by_hand is None:
            pipeline.gate.threshold = threshold

    def close(self) -> None:
        """Close the skin; closing twice is fine."""
        self.skin.close()

    def __enter__(self) -> "Player":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _first_known(script: Script, manner: ReplayOptions) -> tuple[Step, int]:
    """Return the first frame of which the recording says all that it met, and how many of the part lie before it.

    Raises:
        RecordingError: There is none.
    """
    for before, step in enumerate(script.steps(manner.from_s, manner.to_s)):
        if step.known:
            return step, before
    script.reference()  # says that there is none at all
    raise RecordingError(
        f"{script.path} lacks the state of the runtime for this part; choose another with --from and --to"
    )


def _has_idle_gate(bundle: Bundle, hello: Hello) -> bool:
    try:
        IdleGate(bundle.gate_arrays(), hello)
    except (BundleError, HandshakeError):
        return False
    return True
