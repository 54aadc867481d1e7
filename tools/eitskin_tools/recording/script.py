"""A recording as what happened to a runtime, frame by frame: which cloud, reference and conditions each one met.

The file is gone through once to learn what there is; then the frames are read again, a chunk at a time, so that hours
of them take no more memory than seconds. Surfaces are kept, some 20 kB each: ten a second for an hour take 700 MB.
"""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from eitskin.errors import FrameError
from eitskin.messaging.streams.measured import CloudInUse, Conditions, WireFrame
from eitskin_tools.recording.codec import unpack_json
from eitskin_tools.recording.layout import CLOUD, CONDITIONS, FRAME, STATE, WIRE, RecordingError
from eitskin_tools.recording.reader import Recording
from eitskin_tools.recording.told import Told


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """One frame of the wire, and what holds from it on; None where nothing changed."""

    frame: WireFrame
    log_ns: int
    """When it was read, on the wall clock."""
    conditions: Conditions | None = None
    cloud: CloudInUse | None = None
    reference: bytes | None = None
    known: bool = True
    """Whether the recording has all that the frame met: it may lack that of the first ones, if something changed just
    then, and of those behind a damaged chunk."""


class Script(Told):
    """What a recording tells of a stream.

    Args:
        path: Of the recording.

    Raises:
        RecordingError: It cannot be used, or holds no frame.
        MismatchError: It is of another protocol.
        OSError: It cannot be read.
    """

    def __init__(self, path: str | Path) -> None:
        super().__init__(Recording(path))
        self.states: list[dict[str, Any]] = []
        """All that was said of the skin, in order."""
        self.frames = 0
        """Of the wire."""
        self.notes = 0
        """Published frames whose digests are there."""
        self.first_ns = self.last_ns = 0
        """``log_ns`` of the first and the last frame of the wire."""
        self.clouds: dict[int, CloudInUse] = {}
        """By revision."""
        self.conditions: dict[int, Conditions] = {}
        """By revision."""
        self.malformed = 0
        """Messages that make no sense."""
        self._look()
        self.references = {hashlib.sha256(data).hexdigest(): data for data in self.recording.attached.values()}
        """Files as ``eitskin reference`` writes them, by SHA-256."""
        self.ending = self._ending()
        """What is wrong with the file's end or middle, as a clause; "" if nothing is."""
        if not self.frames:
            raise RecordingError(f"{path} holds no frame of the wire{self.ending}")

    def _ending(self) -> str:
        found = "; it was cut off, what is there ends before its time" if self.recording.cut else ""
        if self.recording.damaged:
            found += f"; {self.recording.damaged} damaged chunks are left out"
        return found + (f"; {self.malformed} messages make no sense" if self.malformed else "")

    @property
    def seconds(self) -> float:
        """From the first frame to the last."""
        return (self.last_ns - self.first_ns) * 1e-9

    def reference(self) -> bytes:
        """Return what the first frame is held against of which that is known, as in :class:`Told`."""
        for step in self.steps():
            if step.reference is not None:
                return step.reference
        raise RecordingError(f"{self.path} lacks its reference{self.ending}; record a runtime that has one")

    def _look(self) -> None:
        """Go through the file once."""
        topics = {WIRE.topic, CLOUD.topic, CONDITIONS.topic, STATE.topic, FRAME.topic}
        for entry in self.recording.entries(topics):
            try:
                if entry.topic == WIRE.topic:
                    self.first_ns = self.first_ns or entry.log_ns
                    self.last_ns = entry.log_ns
                    self.frames += 1
                elif entry.topic == CLOUD.topic:
                    cloud = CloudInUse.of(entry.data)
                    self.clouds[cloud.revision] = cloud
                elif entry.topic == CONDITIONS.topic:
                    found = Conditions.of(entry.data)
                    self.conditions[found.revision] = found
                elif entry.topic == STATE.topic:
                    self.states.append(unpack_json(entry.data))
                else:
                    self.notes += 1
            except (RecordingError, FrameError):
                self.malformed += 1

    def steps(self, from_s: float | None = None, to_s: float | None = None) -> Iterator[Step]:
        """Yield the frames of the wire, and what changed before each.

        Args:
            from_s: Begin so long after the first frame, with everything that held then.
            to_s: End so long after the first frame.

        Raises:
            RecordingError: No frame lies between the two.
        """
        begin_ns = self.first_ns + int((from_s or 0.0) * 1e9)
        end_ns = None if to_s is None else self.first_ns + int(to_s * 1e9)
        before: Conditions | None = None
        count = 0
        for entry in self.recording.entries({WIRE.topic}, begin_ns, end_ns):
            if entry.log_ns < begin_ns or (end_ns is not None and entry.log_ns > end_ns):
                continue
            try:
                frame = WireFrame.of(entry.data, n=entry.sequence)
            except FrameError:
                continue
            count += 1
            now = self.conditions.get(frame.conditions)
            step = self._step(frame, entry.log_ns, now, before)
            yield step
            before = now if step.known else before
        if not count:
            raise RecordingError(
                f"{self.path} has no frame from {from_s or 0:g} s to {self.seconds if to_s is None else to_s:g} s; it "
                f"lasts {self.seconds:.1f} s"
            )

    def _step(self, frame: WireFrame, log_ns: int, now: Conditions | None, before: Conditions | None) -> Step:
        if now is None:
            return Step(frame, log_ns, known=False)
        if now is before:
            return Step(frame, log_ns)
        cloud, reference = self.clouds.get(now.cloud), self.references.get(now.reference)
        return step_of(frame, log_ns, now, before, cloud, reference)


def step_of(
    frame: WireFrame,
    log_ns: int,
    now: Conditions,
    before: Conditions | None,
    cloud: CloudInUse | None,
    reference: bytes | None,
) -> Step:
    """Return a frame with what changed before it; with nothing where the recording lacks some of what it met.

    Args:
        frame: It.
        log_ns: When it was read, on the wall clock.
        now: What held.
        before: What held when everything was known last; None at the beginning.
        cloud: That of ``now``; None if it is not there.
        reference: That of ``now``; None if it is not there.
    """
    new_cloud = before is None or before.cloud != now.cloud
    new_reference = before is None or before.reference != now.reference
    if (new_cloud and cloud is None) or (new_reference and reference is None):
        return Step(frame, log_ns, known=False)
    return Step(frame, log_ns, now, cloud if new_cloud else None, reference if new_reference else None)
