"""Writes one recording: a chunk at least every ``FLUSH_S``, forced onto the disk at once, and a summary at the end.

Whoever reads a file that was cut off, by a kill or by the power, has everything up to the last chunk
(:mod:`eitskin_tools.recording.reader`).
"""

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

from mcap.writer import Writer

from eitskin_tools.recording.channels import CHANNELS
from eitskin_tools.recording.layout import FORMAT, HEAD, VERSION, Channel
from eitskin_tools.recording.sink import Reserve, Sink

FLUSH_S: Final = 0.25
"""So much waits in memory, and is lost with the process; with the power goes what is on its way to the disk besides."""

CHUNK_BYTES: Final = 1 << 20
"""A chunk may be smaller, for ``FLUSH_S``; more is written at once."""


class RecordingWriter:
    """Writes a new file; end it with ``close``.

    Args:
        path: Of the file, which must not be there.
        head: Of the metadata: ids, host, clock offset.
        reserve: See :mod:`eitskin_tools.recording.sink`; whoever made it gives it up. None for one of its own.
        now_s: The clock of ``FLUSH_S``.

    Raises:
        RecordingError: It is there, or there is not even room for a reserve.
        OSError: It cannot be made.
    """

    def __init__(
        self,
        path: Path,
        head: Mapping[str, str],
        *,
        reserve: Reserve | None = None,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._sink = Sink(path)
        self._own = None if reserve is not None else Reserve(path.parent)
        self._now_s = now_s
        self._open = True
        self._writer = Writer(self._sink, chunk_size=CHUNK_BYTES, enable_data_crcs=False)  # type: ignore[arg-type]
        self._writer.start(profile="", library="eitskin")
        self.messages = 0
        """Written so far."""
        self.metadata(HEAD, {"format": FORMAT, "version": str(VERSION), **head})
        try:
            self._sink.begin(reserve or self._own)
        except BaseException:
            self._give_up()
            raise
        self._ids = {channel.topic: self._register(channel) for channel in CHANNELS}
        self._flushed_s = now_s()
        self._begun_s = self._flushed_s

    @property
    def path(self) -> Path:
        """Of the file."""
        return self._sink.path

    @property
    def size(self) -> int:
        """On the way to the disk so far."""
        return self._sink.bytes

    @property
    def age_s(self) -> float:
        """Since it was made."""
        return self._now_s() - self._begun_s

    @property
    def full(self) -> bool:
        """Whether the disk is full: the file must be ended now."""
        return self._sink.full

    @property
    def due_s(self) -> float:
        """How long what is in memory may stay there yet; 0 where it is late."""
        return max(self._flushed_s + FLUSH_S - self._now_s(), 0.0)

    def metadata(self, name: str, fields: Mapping[str, str]) -> None:
        """Write texts by name, at once."""
        self._writer.add_metadata(name, dict(fields))

    def attach(self, name: str, media_type: str, content: bytes, log_ns: int) -> None:
        """Write a file within the file."""
        self._writer.flush()  # type: ignore[no-untyped-call]  # what came before it stays before it
        self._writer.add_attachment(log_ns, log_ns, name, media_type, content)

    def add(self, channel: Channel, data: bytes, log_ns: int, sequence: int = 0) -> None:
        """Write a message.

        Args:
            channel: Its channel.
            data: In the channel's encoding.
            log_ns: Wall clock in ns.
            sequence: Whatever counts; kept modulo 2^32.

        Raises:
            OSError: It cannot be written, for another reason than a full disk.
        """
        self._writer.add_message(self._ids[channel.topic], log_ns, data, log_ns, sequence & 0xFFFFFFFF)
        self.messages += 1
        if self._now_s() - self._flushed_s >= FLUSH_S:
            self.sync()

    def _register(self, channel: Channel) -> int:
        schema = 0
        if channel.schema:
            schema = self._writer.register_schema(channel.schema_name, "jsonschema", channel.schema.encode())
        return self._writer.register_channel(channel.topic, channel.encoding, schema)

    def sync(self) -> None:
        """End the chunk, and have it forced onto the disk.

        Raises:
            OSError: It cannot be written, for another reason than a full disk.
        """
        self._writer.flush()  # type: ignore[no-untyped-call]
        self._sink.sync_soon()
        self._flushed_s = self._now_s()

    def close(self, *, wait: bool = True) -> None:
        """Write the summary and end the file; closing twice is fine.

        Args:
            wait: Until all of it is on the disk; else that is done behind, and closing again waits.

        Raises:
            OSError: It cannot be written, or not forced onto the disk; what came before can be read all the same.
        """
        try:
            if self._open:
                self._open = False
                self._writer.finish()  # type: ignore[no-untyped-call]
        finally:
            self._give_up()
            self._sink.close(wait=wait)

    def _give_up(self) -> None:
        """Free the reserve, if it is our own."""
        if self._own is not None:
            self._own.give_up()
