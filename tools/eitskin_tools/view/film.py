"""A recording in parts of one second, each made when a page asks for it, with surfaces and frames as on a live page.

Touches keep their numbers from part to part while a page plays, and get new ones after a jump.
"""

import math
import threading
import time
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, Self

from eitskin.errors import FrameError
from eitskin.frame_record import STAGES
from eitskin.messaging.frame import COUNTS
from eitskin.messaging.streams.measured import WireFrame
from eitskin.robot.pose import Pose
from eitskin.touches.watch import TouchWatch
from eitskin_proto.errors import SkinError
from eitskin_tools.recording.codec import unpack_json
from eitskin_tools.recording.frames import RecordedFrames, count, number, texts
from eitskin_tools.recording.layout import FRAME, WIRE, RecordingError
from eitskin_tools.recording.reader import Entry, Recording
from eitskin_tools.recording.script import Script, bundle_of
from eitskin_tools.view.messages import event_list, frame_message, packed, skin_message, status_message, surface_message
from eitskin_tools.view.server import PageServer

PART_S: Final = 1.0
"""Of a recording in one answer."""

MAX_FRAMES: Final = 3000
"""In one part: they take a page some seconds to get."""

MAX_CACHED_BYTES: Final = 32 << 20
"""Cache of parts, for other pages and for going back."""

MAX_WATCHES: Final = 8
"""Ends of parts whose touches are kept, so that the next part continues their numbers."""


class Film:
    """A recording to show, for any number of threads.

    Args:
        path: Of the file.
        bundle: Computes the maps; None for the shipped one with which the recording was made.

    Raises:
        SkinError: Recording or bundle cannot be used, with what to do.
        OSError: The file cannot be read.
    """

    def __init__(self, path: Path, bundle: Path | None = None) -> None:
        self._script = Script(path)
        found = bundle_of(self._script, bundle)
        self._frames = RecordedFrames(self._script, found)
        self.path, self.skin, self.labels = path, found.skin, found.labels
        self.seconds = self._script.seconds
        self.ending = self._script.ending.removeprefix("; ")
        """A defect of the file in words, or ""."""
        self.first_ns = self._script.first_ns
        """Wall clock of the first frame."""
        self.parts = math.floor(self.seconds / PART_S) + 1
        self._lock = threading.Lock()
        self._made: OrderedDict[int, bytes] = OrderedDict()
        self._watches: OrderedDict[int, TouchWatch] = OrderedDict()
        self._run = self._script.head_text("run")

    def part(self, number: int) -> bytes:
        """Return the messages of a part, one after another.

        Args:
            number: From 0 to below ``parts``.

        Raises:
            SkinError: It cannot be computed.
            OSError: The file cannot be read any more.
        """
        with self._lock:
            if number not in self._made:
                self._made[number] = self._make(number)
                while len(self._made) > 1 and sum(map(len, self._made.values())) > MAX_CACHED_BYTES:
                    self._made.popitem(last=False)
            self._made.move_to_end(number)
            return self._made[number]

    def overview(self) -> Iterator[bytes]:
        """Yield messages of what happened when: now and then while the file is read, and at its end."""
        found, told_s = Overview(self.seconds, self.first_ns), time.monotonic()
        with suppress(OSError, SkinError):  # a page learns why when it asks for a part
            for entry in Recording(self.path).entries({WIRE.topic, FRAME.topic}):
                found.add(entry)
                if (now_s := time.monotonic()) - told_s > REPORT_S:
                    told_s = now_s
                    yield found.message(done=False)
        yield found.message(done=True)

    def _make(self, number: int) -> bytes:
        watch = self._watches.pop(number - 1, None) or self._frames.watch()
        messages: list[bytes] = []
        part = self._frames.part(number * PART_S, (number + 1) * PART_S - 1e-9, watch)
        for before, (step, frame) in enumerate(part):
            if before >= MAX_FRAMES:
                raise RecordingError(f"{self.path}: found over {MAX_FRAMES} frames in a second; replay it instead")
            if (cloud := step.cloud) is not None:
                messages.append(surface_message(cloud.revision, cloud.cloud, self._run, 0, Pose()))
            if frame is not None:
                messages.append(frame_message(frame, 0, Pose()))
        self._watches[number] = watch
        while len(self._watches) > MAX_WATCHES:
            self._watches.popitem(last=False)
        return b"".join(messages)


class FilmServer(PageServer):
    """Serves the page of a recording.

    Args:
        film: The recording.
        host: Address to serve on.
        port: 0 for any that is free.
        allowed: Further host names that a request may state.

    Raises:
        PortUnavailable: The address cannot be bound.
    """

    def __init__(self, film: Film, *, host: str = "127.0.0.1", port: int = 0, allowed: Sequence[str] = ()) -> None:
        super().__init__()
        self._film = film
        about = {
            "name": "", "skins": 1, "file": film.path.name, "seconds": film.seconds, "parts": film.parts,
            "part_s": PART_S, "begin_ms": film.first_ns / 1e6, "labels": film.labels,
        }  # fmt: skip
        self.board.post("skin", skin_message(film.skin, 0, Pose(), about))
        self.board.post("status", status_message("live", film.ending))
        self.serve(host, port, allowed, film=film)

        self._left = threading.Event()
        self._overview = threading.Thread(target=self._post_overview, name="view-overview", daemon=True)

    def __enter__(self) -> Self:
        self.stack.callback(self._overview.join)
        self.stack.callback(self._left.set)  # before it is waited for
        self._overview.start()
        return super().__enter__()

    def _post_overview(self) -> None:
        for message in self._film.overview():
            if self._left.is_set():
                return
            self.board.post("overview", message)


ROWS: Final = 600
"""Spans of a recording, each a few pixels wide."""

MIN_GAP_MS: Final = 500.0
"""Touches that are closer in time share a mark; an event that repeats within it gets no other mark."""

MAX_MARKS: Final = 2000
"""Of one kind, sent to a page."""

REPORT_S: Final = 0.5
"""Between two messages while the file is read."""

Row = dict[str, Any]


class Overview:
    """What happened when, in the part of the file that was read so far.

    Args:
        seconds: From the first frame to the last.
        first_ns: Wall clock of the first.
    """

    def __init__(self, seconds: float, first_ns: int) -> None:
        self._seconds, self._first_ns = seconds, first_ns
        self._rows: dict[int, Row] = {}
        self._touched: list[list[float]] = []
        self._events: list[tuple[float, str]] = []
        self._last: dict[str, float] = {}
        self._before: dict[str, int] = {}
        self._sequence: int | None = None
        self.at_ms = 0.0
        """How far it is."""

    def add(self, entry: Entry) -> None:
        """Add a message of the recording."""
        at_ms = max((entry.log_ns - self._first_ns) / 1e6, 0.0)  # exactly a frame's t_ms, so that marks are at frames
        self.at_ms = max(self.at_ms, at_ms)
        try:
            if entry.topic == WIRE.topic:
                self._wire(at_ms, replace(WireFrame.of(entry.data), n=entry.sequence))
            else:
                self._note(at_ms, unpack_json(entry.data))
        except (FrameError, RecordingError):
            return

    def _row(self, at_ms: float) -> Row:
        k = min(int(at_ms / max(1e3 * self._seconds, 1e-6) * ROWS), ROWS - 1)
        return self._rows.setdefault(k, {"frames": 0, "peak": 0.0, "stages": [0.0] * (len(STAGES) - 1), "noted": 0,
                                         "drift": None, "drift_sd": None, "lost": {}})  # fmt: skip

    def _wire(self, at_ms: float, frame: WireFrame) -> None:
        row = self._row(at_ms)
        row["frames"] += 1
        if frame.touched:
            if self._touched and at_ms - self._touched[-1][1] < MIN_GAP_MS:
                self._touched[-1][1] = at_ms
            elif len(self._touched) < MAX_MARKS:
                self._touched.append([at_ms, at_ms])
        if frame.seq is not None:
            if self._sequence is not None and frame.seq > self._sequence + 1:
                self._count(row, at_ms, "lost", frame.seq - self._sequence - 1)
            self._sequence = frame.seq
        if frame.withheld:
            self._count(row, at_ms, "withheld", 1)

    def _note(self, at_ms: float, note: dict[str, Any]) -> None:
        row = self._row(at_ms)
        row["peak"] = max(row["peak"], number(note.get("peak")) or 0.0)
        names = () if note.get("touched") else ("drift", "drift_sd")  # unknown while touched
        row |= {"drift": None, "drift_sd": None} | {name: number(note.get(name)) for name in names}
        stamps, counts = note.get("host_ns"), note.get("counts")
        if isinstance(stamps, dict):
            ends = [count(stamps.get(stage)) for stage in STAGES]
            row["stages"] = [a + max(y - x, 0) / 1000 for a, x, y in zip(row["stages"], ends, ends[1:], strict=False)]
            row["noted"] += 1
        if isinstance(counts, dict):
            for name in ("corrupt", "overrun"):
                now = count(counts.get(name))
                if (more := now - self._before.get(name, now)) > 0:
                    self._count(row, at_ms, name, more)
                self._before[name] = now
        for words in event_list(texts(note.get("events"))):
            if at_ms - self._last.get(words, -MIN_GAP_MS) >= MIN_GAP_MS and len(self._events) < MAX_MARKS:
                self._events.append((at_ms, words))
            self._last[words] = at_ms

    def _count(self, row: Row, at_ms: float, name: str, more: int) -> None:
        row.setdefault("lost_ms", at_ms)
        row["lost"][name] = row["lost"].get(name, 0) + more

    def message(self, *, done: bool) -> bytes:
        """Return the message to a page: marks in ms, rows by the middle of their spans in s, losses by row.

        ``lost_ms`` is when the first loss of a row was.

        Args:
            done: Whether the whole file was read.
        """
        rows = [
            {
                "t": (k + 0.5) * self._seconds / ROWS,
                "peak": round(row["peak"], 3),
                "stages_us": [round(value / max(row["noted"], 1), 1) for value in row["stages"]],
                "drift": [row["drift"], row["drift_sd"], None],
                "losses": {name: row["lost"].get(name, 0) for name in COUNTS},
                "lost_ms": row.get("lost_ms"),
            }
            for k, row in sorted(self._rows.items())
        ]
        share = 1.0 if done else min(self.at_ms / max(1e3 * self._seconds, 1e-6), 1.0)
        head = {
            "kind": "overview", "of": 0, "share": share, "seconds": self._seconds, "touched": self._touched,
            "events": self._events, "rows": rows, "row_s": self._seconds / ROWS,
        }  # fmt: skip
        return packed(head)
