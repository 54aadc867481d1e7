"""A recording as what happened to a runtime, frame by frame: which cloud, reference and conditions each one met.

The file is gone through once to learn what there is; then the frames are read again, a chunk at a time, so that hours
of them take no more memory than seconds. Surfaces are kept, some 20 kB each: ten a second for an hour take 700 MB.
"""

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from eitskin.errors import FrameError
from eitskin.messaging.streams.measured import CloudInUse, Conditions, WireFrame
from eitskin.model.bundle import Bundle, default_path, load_bundle
from eitskin.reference.captured import Reference, parsed
from eitskin_proto.errors import MismatchError, SkinError
from eitskin_proto.files.plain import stated
from eitskin_proto.sensor.ids import PROTOCOL_ID
from eitskin_proto.skin.made_for import check_made_for
from eitskin_proto.skin.skin import Skin
from eitskin_proto.skin.touch_kind import TouchKind
from eitskin_proto.wire.messages import Hello
from eitskin_tools.recording.codec import unpack_json
from eitskin_tools.recording.layout import CLOUD, CONDITIONS, STATE, WIRE, RecordingError
from eitskin_tools.recording.reader import Recording


class RecordedHead(ABC):
    """Head and device of a recording.

    Args:
        recording: It.

    Raises:
        RecordingError: The device's HELLO cannot be read.
        MismatchError: It is of another protocol.
    """

    def __init__(self, recording: Recording) -> None:
        self.recording = recording
        self.path = recording.path
        self.hello = self._hello()

    def head_text(self, name: str) -> str:
        """Return a text of the head: ``bundle``, ``configuration``, ``serial``, ..."""
        return self.recording.head.get(name, "")

    @abstractmethod
    def reference(self) -> bytes:
        """Return what the first frame is held against of which that is known, as ``eitskin reference`` writes it.

        Raises:
            RecordingError: There is none.
        """

    def _hello(self) -> Hello:
        head = self.recording.head
        protocol = head.get("protocol_id", PROTOCOL_ID)
        hint = "install the release that made the recording ('eitskin --version' names a release's ids)"
        if protocol != PROTOCOL_ID:
            raise MismatchError(f"{self.path}: protocol_id", found=stated(protocol), expected=PROTOCOL_ID, hint=hint)
        try:
            found = Hello.unpack(bytes.fromhex(head.get("hello", "")))
            found.check()
        except MismatchError:
            raise
        except (ValueError, IndexError, SkinError) as error:
            raise RecordingError(f"{self.path}: the device's HELLO cannot be read: {error}") from error
        return found


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


class Script(RecordedHead):
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
        """Return what the first frame is held against of which that is known, as in :class:`RecordedHead`."""
        for step in self.steps():
            if step.reference is not None:
                return step.reference
        raise RecordingError(f"{self.path} lacks its reference{self.ending}; record a runtime that has one")

    def _look(self) -> None:
        """Go through the file once."""
        for entry in self.recording.entries({WIRE.topic, CLOUD.topic, CONDITIONS.topic, STATE.topic}):
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
                else:
                    self.states.append(unpack_json(entry.data))
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
            step = step_of(frame, entry.log_ns, now, before, self.clouds.get, self.references.get)
            yield step
            before = now if step.known else before
        if not count:
            raise RecordingError(
                f"{self.path} has no frame from {from_s or 0:g} s to {self.seconds if to_s is None else to_s:g} s; it "
                f"lasts {self.seconds:.1f} s"
            )


def step_of(
    frame: WireFrame,
    log_ns: int,
    now: Conditions | None,
    before: Conditions | None,
    cloud_of: Callable[[int], CloudInUse | None],
    reference_by: Callable[[str], bytes | None],
) -> Step:
    """Return a frame with what changed before it; with nothing where the recording lacks some of what it met.

    Args:
        frame: It.
        log_ns: When it was read, on the wall clock.
        now: What held; None if it is not there.
        before: What held when everything was known last; None at the beginning.
        cloud_of: Returns the cloud of a revision; None if it is not there.
        reference_by: Returns the reference of a SHA-256; None if it is not there.
    """
    if now is None:
        return Step(frame, log_ns, known=False)
    if now is before:
        return Step(frame, log_ns)
    new_cloud = before is None or before.cloud != now.cloud
    new_reference = before is None or before.reference != now.reference
    cloud = cloud_of(now.cloud) if new_cloud else None
    reference = reference_by(now.reference) if new_reference else None
    if (new_cloud and cloud is None) or (new_reference and reference is None):
        return Step(frame, log_ns, known=False)
    return Step(frame, log_ns, now, cloud, reference)


def bundle_of(script: RecordedHead, named: str | Path | None = None) -> Bundle:
    """Return the bundle that a recording was made with.

    Args:
        script: The recording.
        named: A file, which may be another bundle of the same skin; None looks among those that are shipped.

    Raises:
        RecordingError: None that is shipped is the one that was running.
        MismatchError: The bundle is of another skin.
        BundleError: It cannot be read.
    """
    if named is not None:
        return for_skin(load_bundle(named), script)
    wanted = script.head_text("bundle")
    kinds: tuple[TouchKind, ...] = ("raise", "lower")
    paths = [default_path(labels, touches) for labels in ("area", "units") for touches in kinds]
    for path in paths:
        if path.exists() and (found := load_bundle(path, lazily=True)).id == wanted:
            return found
    raise RecordingError(
        f"{script.path} was made with bundle {wanted[:16]}, none of the shipped ones; name it with --bundle FILE"
    )


def for_skin(bundle: Bundle, script: RecordedHead) -> Bundle:
    """Return a bundle, or refuse it.

    Raises:
        MismatchError: It is of another skin than the recording.
    """
    own, grid_id = bundle.skin, script.head_text("grid_id")
    hint = "name a bundle of the skin that was recorded"
    if grid_id and grid_id != own.grid_id:
        raise MismatchError(f"{script.path}: grid_id", found=grid_id, expected=own.grid_id, hint=hint)
    reference = reference_of(script, script.reference())
    ids = {"grid_id": reference.grid_id, "skin_digest": reference.skin_digest}
    check_made_for(str(script.path), own, **ids, hint=hint)
    return bundle


def reference_of(script: RecordedHead, content: bytes, skin: Skin | None = None) -> Reference:
    """Return a recorded reference.

    Raises:
        BadReference: It cannot be used.
        MismatchError: It is of another device or configuration than the frames, or of another skin.
    """
    found = parsed(content, f"of {script.path}", "record anew", skin)
    found.check(script.hello)
    return found
