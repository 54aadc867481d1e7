"""The whole of a recording on one bar: when it was touched, what was lost, what happened, in rows of equal spans.

The file is gone through once, in a thread of its own, while pages look at it already; they are told how far it is.
"""

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from eitskin.errors import FrameError
from eitskin.messaging.frame import COUNTS, STAGES
from eitskin.messaging.streams.measured import WireFrame
from eitskin_proto.errors import SkinError
from eitskin_tools.recording.codec import unpack_json
from eitskin_tools.recording.layout import FRAME, WIRE, RecordingError
from eitskin_tools.recording.reader import Entry, Recording
from eitskin_tools.view.film.noted import count, number, texts
from eitskin_tools.view.messages import packed

ROWS: Final = 600
"""Spans of a recording: some pixels each."""

APART_S: Final = 0.5
"""Touches that are nearer to each other are one mark; the same event again within it is none."""

MOST_MARKS: Final = 2000
"""Of a kind, that a page is sent."""

TELL_S: Final = 0.5
"""Between two messages while it is being made."""

TOLD_OTHERWISE: Final = ("lost", "overrun", "cloud")
"""Events that are counted, or seen on the surface."""

Row = dict[str, Any]


class Overview:
    """What happened when, as far as the file was gone through.

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
        self.at_s = 0.0
        """How far it is."""

    def take(self, entry: Entry) -> None:
        """Take a message of the recording."""
        at_s = max((entry.log_ns - self._first_ns) * 1e-9, 0.0)
        self.at_s = max(self.at_s, at_s)
        try:
            if entry.topic == WIRE.topic:
                self._wire(at_s, WireFrame.of(entry.data, n=entry.sequence))
            else:
                self._note(at_s, unpack_json(entry.data))
        except (FrameError, RecordingError):
            return

    def _row(self, at_s: float) -> Row:
        k = min(int(at_s / max(self._seconds, 1e-9) * ROWS), ROWS - 1)
        return self._rows.setdefault(k, {"frames": 0, "peak": 0.0, "stages": [0.0] * (len(STAGES) - 1), "noted": 0,
                                         "drift": None, "drift_sd": None, "lost": {}})  # fmt: skip

    def _wire(self, at_s: float, frame: WireFrame) -> None:
        row = self._row(at_s)
        row["frames"] += 1
        if frame.touched:
            if self._touched and at_s - self._touched[-1][1] < APART_S:
                self._touched[-1][1] = at_s
            elif len(self._touched) < MOST_MARKS:
                self._touched.append([at_s, at_s])
        if frame.seq is not None:
            if self._sequence is not None and frame.seq > self._sequence + 1:
                self._count(row, "lost", frame.seq - self._sequence - 1)
            self._sequence = frame.seq
        if frame.withheld:
            self._count(row, "withheld", 1)

    def _note(self, at_s: float, note: dict[str, Any]) -> None:
        row = self._row(at_s)
        row["peak"] = max(row["peak"], number(note.get("peak")) or 0.0)
        row["drift"], row["drift_sd"] = number(note.get("drift")), number(note.get("drift_sd"))
        stamps, counts = note.get("host_ns"), note.get("counts")
        if isinstance(stamps, dict):
            ends = [count(stamps.get(stage)) for stage in STAGES]
            row["stages"] = [a + max(y - x, 0) / 1000 for a, x, y in zip(row["stages"], ends, ends[1:], strict=False)]
            row["noted"] += 1
        if isinstance(counts, dict):
            for name in ("corrupt", "overrun"):
                now = count(counts.get(name))
                if (more := now - self._before.get(name, now)) > 0:
                    self._count(row, name, more)
                self._before[name] = now
        for code in texts(note.get("events")):
            if code not in TOLD_OTHERWISE:
                self._event(at_s, code)

    def _event(self, at_s: float, code: str) -> None:
        if at_s - self._last.get(code, -APART_S) >= APART_S and len(self._events) < MOST_MARKS:
            self._events.append((round(at_s, 3), code))
        self._last[code] = at_s

    def _count(self, row: Row, name: str, more: int) -> None:
        row["lost"][name] = row["lost"].get(name, 0) + more

    def message(self, *, done: bool) -> bytes:
        """Return what a page is sent: times in s, rows by the middle of their spans, losses by row.

        Args:
            done: Whether the whole file was gone through.
        """
        rows = [
            {
                "t": (k + 0.5) * self._seconds / ROWS,
                "peak": round(row["peak"], 3),
                "stages_us": [round(value / max(row["noted"], 1), 1) for value in row["stages"]],
                "drift": [row["drift"], row["drift_sd"], None],
                "losses": {name: row["lost"].get(name, 0) for name in COUNTS},
            }
            for k, row in sorted(self._rows.items())
        ]
        share = 1.0 if done else min(self.at_s / max(self._seconds, 1e-9), 1.0)
        touched = [[round(begin, 3), round(end, 3)] for begin, end in self._touched]
        head = {
            "kind": "overview", "of": 0, "share": share, "seconds": self._seconds, "touched": touched,
            "events": self._events, "rows": rows, "row_s": self._seconds / ROWS,
        }  # fmt: skip
        return packed(head)


class Overlooking:
    """A thread that makes the overview; a context.

    Args:
        path: Of the recording.
        overview: What is made.
        tell: Takes its messages.
    """

    def __init__(self, path: Path, overview: Overview, tell: Callable[[bytes], None]) -> None:
        self._path, self._overview, self._tell = path, overview, tell
        self._left = threading.Event()
        self._thread = threading.Thread(target=self._run, name="view-overview", daemon=True)

    def _run(self) -> None:
        told_s = time.monotonic()
        try:
            for entry in Recording(self._path).entries({WIRE.topic, FRAME.topic}):
                self._overview.take(entry)
                if self._left.is_set():
                    return
                if (now_s := time.monotonic()) - told_s > TELL_S:
                    told_s = now_s
                    self._tell(self._overview.message(done=False))
        except (OSError, SkinError):
            pass  # a page that asks for a part is told why
        self._tell(self._overview.message(done=True))

    def __enter__(self) -> None:
        self._thread.start()

    def __exit__(self, *_: object) -> None:
        self._left.set()
        self._thread.join()
