"""Goes on in a new file when one is large or old enough; each of them can be read by itself.

A new file begins with a frame of the wire, and no file is ended before it has one: none is left without, also where the
disk is full just then. A file that is there already is never written over: the next one takes the next number that is
free.
"""

import os
import re
from collections import deque
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any, Final

from eitskin_tools.recording.layout import WIRE, Channel, RecordingError
from eitskin_tools.recording.sink import Reserve
from eitskin_tools.recording.writer import RecordingWriter

MOST_ENDING: Final = 4
"""Files that may be on their way to the disk beside the one in hand."""


def path_of(first: Path, number: int) -> Path:
    """Return the path of a file of a series: FILE.mcap, FILE.0002.mcap, FILE.0003.mcap, ..."""
    return first if number == 1 else first.with_name(f"{first.stem}.{number:04d}{first.suffix}")


def others(first: Path) -> list[Path]:
    """Return the files that are there already and are called like the second or a later one of a series."""
    name = re.compile(rf"{re.escape(first.stem)}\.[0-9]{{4,}}{re.escape(first.suffix)}")
    with suppress(OSError):  # a folder that may be written to and not read
        return sorted(path for path in first.parent.iterdir() if name.fullmatch(path.name))
    return []


class Series:
    """Writes one file after another.

    Args:
        first: Path of the first.
        head: Metadata of each.
        most_bytes: A file that has more is followed by another; None for no bound.
        most_s: The same for its age.
        options: Of :class:`RecordingWriter`.

    Raises:
        RecordingError: The first file is there, or there is no room.
        OSError: It cannot be made.
    """

    def __init__(
        self,
        first: Path,
        head: Mapping[str, str],
        *,
        most_bytes: int | None = None,
        most_s: float | None = None,
        **options: Any,
    ) -> None:
        self._first, self._head = first, head
        self._most_bytes, self._most_s, self._options = most_bytes, most_s, options
        self._lasting: dict[str, tuple[Channel, bytes, int]] = {}
        self._attached: tuple[str, str, bytes] | None = None
        self.files: list[Path] = []
        """Made so far."""
        self._before = 0
        self._holds_frames = False
        """Whether there is one of the wire in the file in hand."""
        self._number = 1
        self._ended: deque[RecordingWriter] = deque()
        self._reserve = Reserve(first.parent)
        try:
            self._writer = self._begin(first)
        except BaseException:
            self._reserve.give_up()
            raise

    @property
    def size(self) -> int:
        """Of all files."""
        return self._before + self._writer.size

    @property
    def full(self) -> bool:
        """Whether the disk is full."""
        return self._writer.full

    @property
    def due_s(self) -> float:
        """How long what is in memory may stay there yet; 0 where it is late."""
        return self._writer.due_s

    @property
    def path(self) -> Path:
        """Of the file in hand."""
        return self._writer.path

    def _begin_next(self) -> RecordingWriter:
        while True:
            self._number += 1
            path = path_of(self._first, self._number)
            if os.path.lexists(path):
                continue
            try:
                return self._begin(path)
            except RecordingError:
                if not os.path.lexists(path):  # else somebody else made it just now
                    raise

    def _begin(self, path: Path) -> RecordingWriter:
        head = {**self._head, "file": str(len(self.files) + 1)}
        writer = RecordingWriter(path, head, reserve=self._reserve, **self._options)
        self.files.append(path)
        self._holds_frames = False
        return writer

    def attach(self, name: str, media_type: str, content: bytes, log_ns: int) -> None:
        """Write a file within the file; the last one is in each file that follows."""
        self._attached = name, media_type, content
        self._writer.attach(name, media_type, content, log_ns)

    def add(self, channel: Channel, data: bytes, log_ns: int, sequence: int = 0) -> None:
        """Write a message, a frame of the wire into a new file if it is time for one; nothing more on a full disk.

        Raises:
            OSError: It cannot be written, for another reason than a full disk.
        """
        if self.full:
            return
        if channel.lasts:
            self._lasting[channel.topic] = channel, data, sequence
        elif channel.topic == WIRE.topic:
            if self._holds_frames and self._is_time() and not self._next(log_ns):
                return
            self._holds_frames = True
        self._writer.add(channel, data, log_ns, sequence)

    def begin_anew(self, head: Mapping[str, str]) -> None:
        """Go on in a new file with another head, of a runtime that was started anew; nothing holds any more."""
        self._head, self._attached = head, None
        self._lasting.clear()
        self._next(0)

    def _is_time(self) -> bool:
        writer = self._writer
        if self._most_bytes is not None and writer.size >= self._most_bytes:
            return True
        return self._most_s is not None and writer.age_s >= self._most_s

    def _next(self, log_ns: int) -> bool:
        """End the file in hand and begin the next with whatever still holds; the disk need not have all of it yet.

        Returns:
            Whether there is a next one: not where the disk was full before.
        """
        before = self._writer
        if len(self._ended) >= MOST_ENDING:
            self._ended.popleft().close()
        before.close(wait=False)
        self._ended.append(before)
        if before.full:
            return False
        self._before += before.size
        self._writer = self._begin_next()
        if self._attached is not None:
            self._writer.attach(*self._attached, log_ns)
        for channel, data, sequence in self._lasting.values():
            self._writer.add(channel, data, log_ns, sequence)
        return True

    def sync(self) -> None:
        """Have everything forced onto the disk."""
        self._writer.sync()

    def close(self) -> None:
        """End the file in hand, and wait until all are on the disk; closing twice is fine.

        Raises:
            OSError: One of them could not be written, or not forced onto the disk; the others are closed all the same.
        """
        with ExitStack() as left:
            left.callback(self._reserve.give_up)
            while self._ended:
                left.callback(self._ended.pop().close)
            self._writer.close()
