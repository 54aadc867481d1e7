"""A recording as a sequence of events: each frame with its cloud, reference and conditions.

:class:`SeekableRecording` returns any part: its frames, the published frames, and the state at its beginning, without
reading earlier parts. It keeps the clouds and conditions that were read last, so its memory does not grow with the
file. :class:`Script` has read the whole file once, and knows its faults.
"""

import hashlib
from bisect import bisect_right
from collections import OrderedDict
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

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
from eitskin_proto.wire.volts import unpack_hello
from eitskin_tools.recording.codec import unpack_json
from eitskin_tools.recording.layout import CLOUD, CONDITIONS, FRAME, STATE, WIRE, RecordingError
from eitskin_tools.recording.reader import LATEST_NS, Entry, Recording

MAX_CACHED: Final = 256
"""Clouds, and conditions, that are kept: some megabytes."""

MAX_DISTANCE: Final = 16
"""Chunks before a frame's, and behind it, that are searched for what held; the one before has it, unless it is
damaged."""


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


@dataclass(frozen=True, slots=True)
class Span:
    """Some of a recording."""

    steps: tuple[Step, ...]
    """The frames of the wire; the first of which it is known has all that held then."""
    notes: dict[int, dict[str, Any]]
    """What was published, by the number of the published frame; as far as it was recorded."""


class SeekableRecording:
    """A recording of which parts are read.

    Args:
        path: Of the file.

    Raises:
        RecordingError: It cannot be used, or holds no frame.
        MismatchError: It is of another protocol.
        OSError: It cannot be read.
    """

    def __init__(self, path: str | Path) -> None:
        self.recording = Recording(path)
        self.path = self.recording.path
        self.hello = self._hello()
        self._references = {hashlib.sha256(data).hexdigest(): data for data in self.recording.attached.values()}
        self._clouds = _ByRevision(CLOUD.topic, CloudInUse.of)
        self._conditions = _ByRevision(CONDITIONS.topic, Conditions.of)
        first, last = self._end(1), self._end(-1)
        if first is None or last is None:
            raise RecordingError(f"{path} holds no frame from the device{self.ending}")
        self.first_ns, self.last_ns = first, last
        """Wall clock of the first and the last frame."""

    def _hello(self) -> Hello:
        head = self.recording.head
        protocol = head.get("protocol_id", PROTOCOL_ID)
        hint = "install the release that made the recording ('eitskin --version' names a release's ids)"
        if protocol != PROTOCOL_ID:
            raise MismatchError(f"{self.path}: protocol_id", found=stated(protocol), expected=PROTOCOL_ID, hint=hint)
        try:
            found = unpack_hello(bytes.fromhex(head.get("hello", "")))
            found.check()
        except MismatchError:
            raise
        except (ValueError, IndexError, SkinError) as error:
            raise RecordingError(f"{self.path}: the device's HELLO cannot be read: {error}") from error
        return found

    def _end(self, way: int) -> int | None:
        for number in self.recording.having(WIRE.topic)[::way]:
            if found := [entry.log_ns for entry in self.recording.read(number) if entry.topic == WIRE.topic]:
                return found[0] if way > 0 else found[-1]
        return None

    def head_text(self, name: str) -> str:
        """Return a text of the head: ``bundle``, ``configuration``, ``serial``, ..."""
        return self.recording.head.get(name, "")

    @property
    def ending(self) -> str:
        """What is wrong with the file's end or middle, as a clause; "" if nothing is known to be."""
        found = "; it was cut off and ends early" if self.recording.cut else ""
        damaged = self.recording.damaged
        return found + (f"; {damaged} damaged chunks are left out" if damaged else "")

    @property
    def seconds(self) -> float:
        """From the first frame to the last."""
        return max(self.last_ns - self.first_ns, 0) * 1e-9

    def reference(self) -> bytes:
        """Return the reference of the first frame whose reference is known, as ``eitskin reference`` writes it.

        Raises:
            RecordingError: There is none.
        """
        for step in self.steps():
            if step.reference is not None:
                return step.reference
        raise RecordingError(f"{self.path} has no reference{self.ending}; record a runtime that has one")

    def steps(self, from_s: float | None = None, to_s: float | None = None) -> Iterator[Step]:
        """Yield the frames of the wire, and what changed before each.

        Args:
            from_s: Begin so long after the first frame, with everything that held then.
            to_s: End so long after the first frame.

        Raises:
            RecordingError: There is no frame between the two.
            OSError: The file cannot be read any more.
        """
        begin_ns = self.first_ns + int((from_s or 0.0) * 1e9)
        end_ns = LATEST_NS if to_s is None else self.first_ns + int(to_s * 1e9)
        count = 0
        for step in self._steps(begin_ns, end_ns):
            count += 1
            yield step
        if not count:
            raise RecordingError(
                f"{self.path} has no frame from {from_s or 0:g} s to {self.seconds if to_s is None else to_s:g} s; it "
                f"lasts {self.seconds:.1f} s"
            )

    def span(self, from_s: float, to_s: float) -> Span:
        """Return a part.

        Args:
            from_s: Its beginning, after the first frame.
            to_s: Its end, which belongs to the next part.

        Raises:
            OSError: The file cannot be read any more.
        """
        begin_ns, end_ns = self.first_ns + round(from_s * 1e9), self.first_ns + round(to_s * 1e9)
        notes: dict[int, dict[str, Any]] = {}
        return Span(tuple(self._steps(begin_ns, end_ns - 1, notes)), notes)

    def _steps(self, begin_ns: int, end_ns: int, notes: dict[int, dict[str, Any]] | None = None) -> Iterator[Step]:
        """Yield the frames of a span of the wall clock, and put what was published of them into ``notes``."""
        before: Conditions | None = None
        for number in self.recording.between(begin_ns, end_ns):
            for entry in self._read(number):
                if not begin_ns <= entry.log_ns <= end_ns:
                    continue
                if entry.topic == FRAME.topic and notes is not None:
                    _add_note(notes, entry.data)
                elif entry.topic == WIRE.topic:
                    try:
                        frame = WireFrame.of(entry.data, n=entry.sequence)
                    except FrameError:
                        continue
                    now = self._lookup(self._conditions, frame.conditions, number)
                    step = self._step(frame, entry.log_ns, now, before, number)
                    yield step
                    before = now if step.known else before

    def _step(
        self, frame: WireFrame, log_ns: int, now: Conditions | None, before: Conditions | None, number: int
    ) -> Step:
        """Return a frame with what changed before it; with nothing where the recording lacks some of what it met.

        Args:
            frame: It.
            log_ns: When it was read, on the wall clock.
            now: What held; None if it is not there.
            before: What held when everything was known last; None at the beginning.
            number: Of its chunk.
        """
        if now is None:
            return Step(frame, log_ns, known=False)
        if now is before:
            return Step(frame, log_ns)
        new_cloud = before is None or before.cloud != now.cloud
        new_reference = before is None or before.reference != now.reference
        cloud = self._lookup(self._clouds, now.cloud, number) if new_cloud else None
        reference = self._references.get(now.reference) if new_reference else None
        if (new_cloud and cloud is None) or (new_reference and reference is None):
            return Step(frame, log_ns, known=False)
        return Step(frame, log_ns, now, cloud, reference)

    def _lookup(self, cache: "_ByRevision", revision: int, number: int) -> Any:
        """Return what had a revision when a chunk was written; None where it is not near that chunk."""
        if (found := cache.get(revision)) is not None or revision in cache.missing:
            return found
        having = self.recording.having(cache.topic)
        at = bisect_right(having, number)
        for one in (*having[max(at - MAX_DISTANCE, 0) : at][::-1], *having[at : at + MAX_DISTANCE]):
            self._read(one)
            if (found := cache.get(revision)) is not None:
                return found
        cache.missing.add(revision)
        return None

    def _read(self, number: int) -> list[Entry]:
        """Return the messages of a chunk, having kept what lasts."""
        entries = self.recording.read(number)
        for entry in entries:
            for cache in (self._clouds, self._conditions):
                if entry.topic == cache.topic:
                    cache.add(entry.data)
        return entries


def _add_note(notes: dict[int, dict[str, Any]], data: bytes) -> None:
    """Add what was published of a frame, unless it makes no sense."""
    with suppress(RecordingError, KeyError, TypeError, ValueError, OverflowError):
        note = unpack_json(data)
        notes[int(note["number"])] = note


class _ByRevision:
    """What has a revision, the newest of it.

    Args:
        topic: Of its messages.
        parse: Makes it of a message.
    """

    def __init__(self, topic: str, parse: Callable[[bytes], Any]) -> None:
        self.topic, self._parse = topic, parse
        self._found = OrderedDict[int, Any]()
        self.missing: set[int] = set()
        """Revisions that were not found."""
        self.malformed = 0
        """Messages that make no sense."""

    def add(self, data: bytes) -> None:
        try:
            found = self._parse(data)
        except FrameError:
            self.malformed += 1
            return
        if found.revision not in self._found:  # the same one stays the same object, which says that nothing changed
            self._found[found.revision] = found
        self._found.move_to_end(found.revision)
        while len(self._found) > MAX_CACHED:
            self._found.popitem(last=False)

    def get(self, revision: int) -> Any:
        return self._found.get(revision)


class Script(SeekableRecording):
    """A recording that was gone through once.

    Args:
        path: Of the recording.

    Raises:
        RecordingError: It cannot be used, or holds no frame.
        MismatchError: It is of another protocol.
        OSError: It cannot be read.
    """

    def __init__(self, path: str | Path) -> None:
        self.malformed = 0
        """Messages that make no sense."""
        super().__init__(path)
        self.states: list[dict[str, Any]] = []
        """All that was said of the skin, in order."""
        self.frames = 0
        """Of the wire."""
        for number in range(len(self.recording.chunks)):
            for entry in self._read(number):
                self.frames += entry.topic == WIRE.topic
                if entry.topic == STATE.topic:
                    try:
                        self.states.append(unpack_json(entry.data))
                    except RecordingError:
                        self.malformed += 1
        self.malformed += self._clouds.malformed + self._conditions.malformed

    @property
    def ending(self) -> str:
        """What is wrong with the file's end or middle, as a clause; "" if nothing is."""
        return super().ending + (f"; {self.malformed} messages make no sense" if self.malformed else "")

    @cached_property
    def clouds(self) -> dict[int, CloudInUse]:
        """All clouds, by revision: some 20 kB each."""
        found = {}
        for entry in self.recording.entries({CLOUD.topic}):
            with suppress(FrameError):
                cloud = CloudInUse.of(entry.data)
                found[cloud.revision] = cloud
        return found


def bundle_of(script: SeekableRecording, named: str | Path | None = None) -> Bundle:
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
        f"{script.path} was made with bundle {wanted[:16]}, which is not a shipped one; name it with --bundle FILE"
    )


def for_skin(bundle: Bundle, script: SeekableRecording) -> Bundle:
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


def reference_of(script: SeekableRecording, content: bytes, skin: Skin | None = None) -> Reference:
    """Return a recorded reference.

    Raises:
        BadReference: It cannot be used.
        MismatchError: It is of another device or configuration than the frames, or of another skin.
    """
    found = parsed(content, f"of {script.path}", "record anew", skin)
    found.check(script.hello)
    return found
