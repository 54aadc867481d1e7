"""A recording as a sequence of events: each frame with its cloud, reference and conditions.

:class:`Script` returns any part without reading earlier ones. It keeps the chunks, clouds and conditions that were read
last, so its memory does not grow with the file, and its work for a frame is bounded.
"""

import hashlib
from bisect import bisect_right
from collections import Counter, OrderedDict
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
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
from eitskin_tools.recording.layout import CLOUD, CONDITIONS, FRAME, WIRE, RecordingError
from eitskin_tools.recording.reader import LATEST_NS, Entry, Recording

MAX_CACHED: Final = 256
"""Clouds, and conditions, that are kept: some megabytes."""

MAX_DISTANCE: Final = 16
"""Chunks before a frame's, and behind it, that are searched for what held; the one before has it, unless it is
damaged."""

NEIGHBOURS: Final = (0, 1, -1, 2, -2)
"""Chunks, counted from a frame's, that its note may be in: half a second to either side."""

MOST_FRAMES_S: Final = 10_000
"""Frames in a second of a recording; devices measure hundreds, a replay without pauses some thousands."""


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
    published: bytes = b""
    """What was noted when the frame was published; empty where nothing was."""

    @property
    def note(self) -> dict[str, Any]:
        """What was noted, as :func:`eitskin_tools.recording.codec.note_of` makes it; empty if it makes no sense."""
        with suppress(RecordingError):
            return unpack_json(self.published or b"{}")
        return {}


@dataclass(frozen=True, slots=True)
class _Chunk:
    entries: list[Entry]
    notes: dict[int, bytes]
    """By the number of the published frame, modulo 2^32."""


class Script:
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
        self._chunks = OrderedDict[int, _Chunk]()
        self._searched = set[int]()
        self._malformed = set[tuple[int, int]]()
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
            if found := [entry.log_ns for entry in self._read(number).entries if entry.topic == WIRE.topic]:
                return found[0] if way > 0 else found[-1]
        return None

    def head_text(self, name: str) -> str:
        """Return a text of the head: ``bundle``, ``configuration``, ``serial``, ..."""
        return self.recording.head.get(name, "")

    @property
    def ending(self) -> str:
        """What is wrong with the file's end or middle, as far as it was read, as a clause; "" if nothing is."""
        found = "; it was cut off and ends early" if self.recording.cut else ""
        if damaged := self.recording.damaged:
            found += f"; {damaged} damaged chunks are left out"
        return found + (f"; {len(self._malformed)} messages make no sense" if self._malformed else "")

    @property
    def seconds(self) -> float:
        """From the first frame to the last."""
        return max(self.last_ns - self.first_ns, 0) * 1e-9

    @cached_property
    def frames(self) -> int:
        """Frames of the wire; reads the whole file."""
        return sum(1 for _ in self.recording.entries({WIRE.topic}))

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
            to_s: End so long after it.

        Raises:
            RecordingError: There is no frame between the two, or there are more than any device measures.
            OSError: The file cannot be read any more.
        """
        count = 0
        for step in self.part(from_s, to_s):
            count += 1
            yield step
        if not count:
            raise RecordingError(
                f"{self.path} has no frame from {from_s or 0:g} s to {self.seconds if to_s is None else to_s:g} s; it "
                f"lasts {self.seconds:.1f} s"
            )

    def part(self, from_s: float | None, to_s: float | None) -> Iterator[Step]:
        """Yield the same as ``steps``, or nothing where there is no frame."""
        begin_ns = self.first_ns + round((from_s or 0.0) * 1e9)
        end_ns = LATEST_NS if to_s is None else self.first_ns + round(to_s * 1e9)
        before: Conditions | None = None
        counts = Counter[int]()
        for number in self.recording.between(begin_ns, end_ns):
            wires = [
                (place, entry)
                for place, entry in enumerate(self._read(number).entries)
                if entry.topic == WIRE.topic and begin_ns <= entry.log_ns <= end_ns
            ]
            seconds = [entry.log_ns // 10**9 for _, entry in wires]
            counts.update(seconds)
            if any(counts[second] > MOST_FRAMES_S for second in seconds):
                raise RecordingError(
                    f"{self.path}: found over {MOST_FRAMES_S} frames in a second, more than any device measures; "
                    "record again"
                )
            for place, entry in wires:
                try:
                    frame = replace(WireFrame.of(entry.data), n=entry.sequence)
                except FrameError:
                    self._malformed.add((number, place))
                    continue
                step = self._step(frame, entry.log_ns, before, number)
                yield step
                before = step.conditions if step.conditions is not None else before

    def _step(self, frame: WireFrame, log_ns: int, before: Conditions | None, number: int) -> Step:
        """Return a frame with what changed before it; with nothing where the recording lacks some of what it met.

        Args:
            frame: It.
            log_ns: When it was read, on the wall clock.
            before: What held when everything was known last; None at the beginning.
            number: Of its chunk.
        """
        note = self._note(frame, number)
        now = self._lookup(self._conditions, frame.conditions, number)
        if now is None:
            return Step(frame, log_ns, known=False, published=note)
        if now is before:
            return Step(frame, log_ns, published=note)
        new_cloud = before is None or before.cloud != now.cloud
        new_reference = before is None or before.reference != now.reference
        cloud = self._lookup(self._clouds, now.cloud, number) if new_cloud else None
        reference = self._references.get(now.reference) if new_reference else None
        if (new_cloud and cloud is None) or (new_reference and reference is None):
            return Step(frame, log_ns, known=False, published=note)
        return Step(frame, log_ns, now, cloud, reference, published=note)

    def _note(self, frame: WireFrame, number: int) -> bytes:
        """Return what was noted of a frame, in its chunk or in one near it."""
        if frame.frame is None:
            return b""
        for one in (number + k for k in NEIGHBOURS):
            notes = self._read(one).notes if 0 <= one < len(self.recording.chunks) else {}
            if (found := notes.get(frame.frame & 0xFFFFFFFF)) is not None:
                return found
        return b""

    def _lookup(self, cache: "_ByRevision", revision: int, number: int) -> Any:
        """Return what had a revision when a chunk was written; None where it is not near that chunk."""
        if (found := cache.get(revision)) is not None:
            return found
        if (place := cache.places.get(revision)) is not None:
            for entry in self._read(place[0]).entries[place[1] : place[1] + 1]:  # none if the file has changed
                return cache.add(entry.data, place)
        having = cache.chunks = cache.chunks or self.recording.having(cache.topic)
        at = bisect_right(having, number)
        for one in (*having[max(at - MAX_DISTANCE, 0) : at][::-1], *having[at : at + MAX_DISTANCE]):
            if one not in self._searched:
                self._read(one)
                if (found := cache.get(revision)) is not None:
                    return found
        return None

    def _read(self, number: int) -> _Chunk:
        """Return a chunk, having kept what lasts."""
        if (found := self._chunks.get(number)) is not None:
            return found
        entries = self.recording.read(number)
        notes = {entry.sequence: entry.data for entry in entries if entry.topic == FRAME.topic}
        found = self._chunks[number] = _Chunk(entries, notes)
        if len(self._chunks) > len(NEIGHBOURS) + 1:
            self._chunks.popitem(last=False)
        if number not in self._searched:
            self._searched.add(number)
            for place, entry in enumerate(entries):
                for cache in (self._clouds, self._conditions):
                    if entry.topic == cache.topic and cache.add(entry.data, (number, place)) is None:
                        self._malformed.add((number, place))
        return found


class _ByRevision:
    """What has a revision, the newest of it.

    Args:
        topic: Of its messages.
        parse: Makes it of a message.
    """

    def __init__(self, topic: str, parse: Callable[[bytes], Any]) -> None:
        self.topic, self._parse = topic, parse
        self._found = OrderedDict[int, Any]()
        self.places = dict[int, tuple[int, int]]()
        """Chunk and place in it of each."""
        self.chunks: list[int] = []
        """Those that have some."""

    def add(self, data: bytes, place: tuple[int, int]) -> Any:
        """Keep a message; return it parsed, or None if it makes no sense."""
        try:
            found = self._parse(data)
        except FrameError:
            return None
        self.places[found.revision] = place
        if found.revision not in self._found:  # the same one stays the same object, which says that nothing changed
            self._found[found.revision] = found
        self._found.move_to_end(found.revision)
        while len(self._found) > MAX_CACHED:
            self._found.popitem(last=False)
        return self._found[found.revision]

    def get(self, revision: int) -> Any:
        return self._found.get(revision)


def bundle_of(script: Script, named: str | Path | None = None) -> Bundle:
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


def for_skin(bundle: Bundle, script: Script) -> Bundle:
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


def reference_of(script: Script, content: bytes, skin: Skin | None = None) -> Reference:
    """Return a recorded reference.

    Raises:
        BadReference: It cannot be used.
        MismatchError: It is of another device or configuration than the frames, or of another skin.
    """
    found = parsed(content, f"of {script.path}", "record anew", skin)
    found.check(script.hello)
    return found
