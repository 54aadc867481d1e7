"""Writes two subscriptions to a file: measurements, published frames, and pictures for Foxglove.

The recorder is a process of its own: packing a chunk and forcing it onto the disk takes milliseconds, for which the
frame loop must not wait. :class:`Recorder` knows no socket; it is called with one value after the other.

:class:`SubscriptionQueue` has a thread for each subscription that only takes messages from its socket, since the disk
may hold up the writer. The threads sleep between frames and then take all messages, because each waking takes time from
the frame loop where cores are few.
"""

import threading
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from queue import Empty, SimpleQueue
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin.errors import NoFrame
from eitskin.messaging.frame import Frame
from eitskin.messaging.streams.measured import CloudInUse, Conditions, WireFrame
from eitskin.messaging.streams.state import SkinState
from eitskin_proto.errors import SkinError
from eitskin_proto.skin.skin import PAPER
from eitskin_tools.processes.rhythm import Rhythm
from eitskin_tools.recording import pictures
from eitskin_tools.recording.codec import note_of, pack_json, pack_map
from eitskin_tools.recording.layout import (
    CLOUD,
    CONDITIONS,
    FRAME,
    GRID,
    JSON_MEDIA,
    MAP,
    REFERENCE,
    STATE,
    SURFACE,
    WIRE,
    RecordingError,
)
from eitskin_tools.recording.writer import Series

MAX_QUEUED: Final = 20_000
"""Messages that wait for the disk: half a minute at 200 frames/s; more would be memory without end."""

POLL_S: Final = 0.02
"""How long threads rest, at least, where they have taken what there was: 4 frames come meanwhile at 200 frames/s."""


def add_frame(rhythm: Rhythm, found: object) -> None:
    """Have a rhythm take note of a frame, whatever stream it is of."""
    match found:
        case Frame():
            rhythm.add(found.number, found.host_ns["read"])
        case WireFrame():
            rhythm.add(found.n, found.read_ns)


class SubscriptionQueue:
    """Takes from subscriptions until it is closed.

    Args:
        sources: Each makes a subscription that ends its waiting with :class:`eitskin.NoFrame` now and then.
    """

    def __init__(self, sources: Iterable[Callable[[], Any]]) -> None:
        self._queue: SimpleQueue[object] = SimpleQueue()
        self._rhythm = Rhythm()
        self._closing = threading.Event()
        self.dropped = 0
        """Messages that were not taken because the disk was too slow."""
        self.silent: SkinError | None = None
        """Why nothing comes, in the words of the last source that timed out; None once something came."""
        self.unusable: SkinError | None = None
        """The same of a source to which something comes that it cannot use: of another version, say."""
        self._threads = [
            threading.Thread(target=self._receive, args=(source,), name=f"record-{number}", daemon=True)
            for number, source in enumerate(sources)
        ]
        for thread in self._threads:
            thread.start()

    def _receive(self, source: Callable[[], Any]) -> None:
        try:
            subscription = source()
        except Exception as error:
            self._queue.put(error)
            return
        rhythm, rejected = Rhythm(), 0
        try:
            while not self._closing.is_set():
                try:
                    for found in subscription:
                        self.silent = self.unusable = None
                        if self._queue.qsize() < MAX_QUEUED:
                            self._queue.put(found)
                        else:
                            self.dropped += 1
                        add_frame(rhythm, found)
                        if not subscription.waits:
                            self._rhythm = rhythm
                            self._closing.wait(rhythm.pause_s(POLL_S))
                        if self._closing.is_set():
                            return
                except NoFrame as error:
                    self.silent = error
                    if subscription.rejected > rejected:
                        self.unusable, rejected = error, subscription.rejected
        except Exception as error:
            self._queue.put(error)
        finally:
            subscription.close()

    def next(self, timeout_s: float) -> object | None:
        """Return what came next; None if nothing came in time.

        Raises:
            SkinError: A subscription failed.
        """
        if self._queue.empty():
            time.sleep(min(self._rhythm.pause_s(POLL_S), timeout_s))
        with suppress(Empty):
            found = self._queue.get(timeout=timeout_s)
            if isinstance(found, Exception):
                raise found
            return found
        return None

    def close(self) -> None:
        """End the subscriptions, and wait for their threads."""
        self._closing.set()
        for thread in self._threads:
            thread.join(5.0)


MAX_EARLY: Final = 4000
"""Values that wait until the skin has said what it is: 10 s of a stream of 400 a second."""

REPEAT_NS: Final = 1_000_000_000
"""Between two pictures while nothing changes in them."""


@dataclass(frozen=True, slots=True)
class RecorderOptions:
    """What of the stream is kept beside the wire, the clouds and the state."""

    maps: bool = False
    """The maps themselves, not their digests alone."""
    every: int = 1
    """One of this many maps is kept."""
    pictures_hz: float = 30.0
    """Pictures for Foxglove a second, at most; 0 for none."""


SeriesFactory = Callable[[dict[str, str]], Series]
"""Makes the files, given their head."""

NO_CLOUD: Final = np.zeros((3, 0, 0), dtype=np.float32)


def head_of(found: SkinState) -> dict[str, str]:
    """Return what a recording's head says of the skin."""
    names = ("host", "serial", "configuration", "bundle", "skin", "protocol_id", "grid_id", "run")
    created = datetime.fromtimestamp(found.utc_ns * 1e-9, UTC).isoformat(timespec="seconds")
    return {
        **{name: getattr(found, name) for name in names},
        "release": found.version,
        "solvers": " ".join(found.solvers),
        "hello": found.hello.hex(),
        "created_utc": created,
    }


class Recorder:
    """Writes what it is given; end it with ``close``.

    Args:
        opener: Makes the files, as soon as the skin has said what it is.
        kept: What of the stream is kept.
    """

    def __init__(self, opener: SeriesFactory, kept: RecorderOptions) -> None:
        self._opener, self._kept = opener, kept
        self._pixel_mm: tuple[float, float] | None = None
        self.series: Series | None = None
        """The files; None before the skin has said what it is."""
        self._early: list[tuple[str, Callable[[Any], None], Any]] = []
        self._run = self._reference = ""
        self._offset_ns = self._now_ns = 0
        self._cloud = NO_CLOUD
        self._map_sequence = -1
        self._picture_ns = 0
        self._picture_sequence = -1
        self._maps = 0
        self.frames = 0
        """Of the wire, written."""
        self.missed = 0
        """Of the wire: numbered by the runtime, never received."""
        self._number = -1
        self.published = 0
        """Frames whose digests were written."""
        self._first_ns = self._last_ns = 0
        self._conditions_revision = self._cloud_revision = -1

    @property
    def recorded_s(self) -> float:
        """From the first frame of the wire to the last."""
        return (self._last_ns - self._first_ns) * 1e-9

    @property
    def full(self) -> bool:
        """Whether the disk is full: the recording must be ended now."""
        return self.series is not None and self.series.full

    def record(self, found: object) -> None:
        """Write whatever a stream carries.

        Raises:
            OSError: It cannot be written, for another reason than a full disk.
            RecordingError: Much came, but not what skin it is of; or there is no room for a file.
        """
        match found:
            case WireFrame():
                self._when_known(found.run, self._wire, found)
            case CloudInUse():
                self._when_known(found.run, self._cloud_in_use, found)
            case Conditions():
                self._when_known(found.run, self._conditions, found)
            case Frame():
                self._when_known(found.run, self._frame, found)
            case SkinState():
                self._state(found)

    def _when_known(self, run: str, write: Callable[[Any], None], found: Any) -> None:
        """Write it, if the file is of the run that it is of; else keep it until that run has said what it is."""
        if run == self._run and self.series is not None:
            write(found)
            return
        if len(self._early) >= MAX_EARLY:
            raise RecordingError("the runtime does not describe its skin; update it to this release")
        self._early.append((run, write, found))

    def _state(self, found: SkinState) -> None:
        """Write what is known of the skin; the first of a run begins a file."""
        if found.run != self._run:
            head = {**head_of(found), "wall_minus_host_ns": str(found.utc_ns - found.made_ns)}
            self._offset_ns = found.utc_ns - found.made_ns
            if self.series is None:
                self.series = self._opener(head)
            else:
                self.series.begin_anew(head)
            self._run, self._reference = found.run, ""
            self._cloud, self._pixel_mm = NO_CLOUD, PAPER.grid.pixel_mm if found.grid_id == PAPER.grid_id else None
            self._number = self._map_sequence = self._conditions_revision = self._cloud_revision = -1
        assert self.series is not None
        self._now_ns = found.made_ns + self._offset_ns
        if found.reference is not None and found.reference_sha256 != self._reference:
            self._reference = found.reference_sha256
            name = f"{REFERENCE}{self._reference[:16]}.json"
            self.series.attach(name, JSON_MEDIA, found.reference, self._now_ns)
        self.series.add(STATE, pack_json(found.as_dict()), self._now_ns, found.n)
        early, self._early = self._early, []
        for run, write, one in early:
            self._when_known(run, write, one)

    def _wire(self, found: WireFrame) -> None:
        if 0 <= self._number < found.n:
            self.missed += found.n - self._number - 1
        self._number = found.n
        self.frames += 1
        self._first_ns = self._first_ns or found.read_ns
        self._last_ns = max(self._last_ns, found.read_ns)
        self._now_ns = found.read_ns + self._offset_ns
        self._series_in_hand.add(WIRE, found.body(), self._now_ns, found.n)

    def _cloud_in_use(self, found: CloudInUse) -> None:
        """Write a cloud once, however often it arrives; with the clock of the frames, since the wall clock may jump."""
        if found.revision == self._cloud_revision:
            return
        self._cloud_revision, self._cloud = found.revision, found.cloud
        self._picture_sequence = -1
        if self._pixel_mm is None:  # of a sheet of its own: no stream says how large it is, but by its surface
            self._pixel_mm = pictures.pixel_of(found.cloud)
        taken_ns = found.taken_ns + self._offset_ns if found.taken_ns else self._now_ns
        self._series_in_hand.add(CLOUD, found.body(), taken_ns, found.n)

    def _conditions(self, found: Conditions) -> None:
        if found.revision == self._conditions_revision:
            return
        self._conditions_revision = found.revision
        self._series_in_hand.add(CONDITIONS, found.body(), self._now_ns, found.n)

    @property
    def _series_in_hand(self) -> Series:
        assert self.series is not None
        return self.series

    def _frame(self, found: Frame) -> None:
        series, read_ns = self._series_in_hand, found.host_ns["read"] + self._offset_ns
        self.published += 1
        series.add(FRAME, pack_json(note_of(found)), read_ns, found.number)
        if self._kept.maps and found.map_sequence != self._map_sequence:
            self._map_sequence = found.map_sequence
            if self._maps % self._kept.every == 0:
                series.add(MAP, pack_map(found.map_sequence, found.map), read_ns, found.number)
            self._maps += 1
        self._draw(found.map, found.map_sequence, read_ns)

    def _draw(self, values: npt.NDArray[np.float32], sequence: int, wall_ns: int) -> None:
        """Write pictures, if it is time for some."""
        if not self._kept.pictures_hz or self._pixel_mm is None or values.shape != self._cloud.shape[1:]:
            return
        since_ns = wall_ns - self._picture_ns
        if since_ns < 1e9 / self._kept.pictures_hz or (sequence == self._picture_sequence and since_ns < REPEAT_NS):
            return
        self._picture_ns, self._picture_sequence = wall_ns, sequence
        series = self._series_in_hand
        series.add(GRID, pictures.grid(values, self._pixel_mm, wall_ns), wall_ns)
        series.add(SURFACE, pictures.surface(values, self._cloud, wall_ns), wall_ns)

    def close(self) -> None:
        """End the file; closing twice is fine."""
        if self.series is not None:
            self.series.close()
