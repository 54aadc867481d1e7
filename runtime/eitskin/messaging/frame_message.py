"""Packs a frame's record into one message buffer that every frame overwrites.

Values that change with each frame have a fixed width and come first, so that they are overwritten in place and the time
of publishing is stamped last. Only the texts at the end vary in length. ::

    v n seq device_us ... weak_rows map_seq host_ns{..} counts{..} shape map | solver skipped events regions ...

While a subscriber asks for touches, they follow at the very end. A touch message is the same without shape and map; it
has version 2 and begins with another byte.

Packing has two halves, because the frame is compared with its latency budget between them::

    begin     number, map                           stamp: pack
    finish    texts, all numbers, the age           stamp: publish
"""

import os
import struct
import time
from typing import Any, Final, NamedTuple

import msgpack  # type: ignore[import-untyped]

from eitskin.frame_record import PACK, PUBLISH, STAGES, FrameRecord
from eitskin.messaging.frame import (
    COUNTS,
    FIRST_BYTE,
    LARGEST_REST,
    MAX_TEXT,
    MAX_TEXTS,
    NUMBERS,
    TOUCH_FIRST_BYTE,
    TOUCH_VERSION,
    TOUCHED,
    VERSION,
    host_id,
)
from eitskin.messaging.regions import whole
from eitskin.touches.touch import KEYS, LAYOUT

HEAD_END: Final = 6
"""Bytes of a message up to its version."""

SHORT_HEAD: Final = bytes(msgpack.packb("v") + msgpack.packb(VERSION))
TOUCH_HEAD: Final = bytes(msgpack.packb("v") + msgpack.packb(TOUCH_VERSION))
TOUCHES_KEY: Final = bytes(msgpack.packb("touches"))
BYTES_ENTRY: Final = bytes(msgpack.packb("touch_bytes") + msgpack.packb(LAYOUT.size))
EVENTS_KEY: Final = bytes(msgpack.packb("touch_events"))
MORE_KEY: Final = bytes(msgpack.packb("touches_more"))


class FramePacker:
    """One message in memory, overwritten for each frame.

    Args:
        configuration: Name and digest of the device's configuration.
        bundle: Id.
        serial_number: Of the device.
        run: Differs after each start.
        shape: Rows and columns of the map.
    """

    __slots__ = (
        "_arguments", "_at", "_buffer", "_constant", "_end", "_entries", "_extra", "_layout", "_map", "_map_at",
        "_tail_at", "_tails", "_texts", "_view", "_whole_map",
    )  # fmt: skip

    _KINDS: Final = {"u": (b"\xcf", "Q", 0), "f": (b"\xcb", "d", 0), "b": (b"", "B", TOUCHED[False])}
    """MessagePack's byte before a number, the number's layout, and its first value."""

    def __init__(
        self, *, configuration: str, bundle: str, serial_number: str, run: str, shape: tuple[int, int]
    ) -> None:
        map_bytes = 4 * shape[0] * shape[1]
        self._whole_map = whole(shape)
        head = bytearray()
        layout, end = ">", 0
        self._arguments: list[Any] = []
        """Of ``_layout``: each number, and the bytes before it."""

        def slot(name: str, kind: str) -> None:
            nonlocal layout, end
            code, number, first = self._KINDS[kind]
            head.extend(msgpack.packb(name) + code)
            layout += f"{len(head) - end}s{number}"
            self._arguments.extend((bytes(head[end:]), first))
            head.extend(bytes(struct.calcsize(number)))
            end = len(head)

        constant = {"configuration": configuration, "bundle": bundle, "serial": serial_number, "run": run}
        self._constant: dict[str, object] = {**constant, "host": host_id()}
        plain = (("n", "u"), ("seq", "u"), ("device_us", "u"), ("age_us", "u"), ("touched", "b"), ("gate_logit", "f"),
                 ("cloud", "u"), ("weak_rows", "u"), ("map_seq", "u"), ("drift", "f"), ("drift_sd", "f"),
                 ("drift_uneven", "f"), ("fused", "u"))  # fmt: skip
        assert tuple(name for name, _ in plain) == NUMBERS[: len(plain)]
        entries = 1 + len(plain) + 4 + 5 + len(self._constant)
        self._entries, self._extra = entries, 0
        head += FIRST_BYTE + struct.pack(">H", entries) + SHORT_HEAD
        self._at = end = len(head)
        for name, kind in plain:
            slot(name, kind)
        for group, names in (("host_ns", STAGES), ("counts", COUNTS)):
            head += msgpack.packb(group) + bytes([0x80 | len(names)])
            for name in names:
                slot(name, "u")
        self._layout = struct.Struct(layout)
        self._map_at = len(head)
        head += msgpack.packb("shape") + msgpack.packb(list(shape)) + msgpack.packb("map")
        head += b"\xc5" + struct.pack(">H", map_bytes)
        map_at = len(head)
        self._tail_at = map_at + map_bytes
        self._buffer = bytearray(head) + bytes(map_bytes + LARGEST_REST - len(head))
        self._layout.pack_into(self._buffer, self._at, *self._arguments)
        self._view = memoryview(self._buffer)
        self._map = self._view[map_at : self._tail_at]
        self._tails: dict[tuple[str, tuple[str, ...], tuple[str, ...], tuple[str, ...]], bytes] = {}
        self._texts: object = None
        self._end = self._tail_at

    def put_numbers(self, numbers: tuple[float, ...]) -> None:
        """Overwrite all numbers.

        Args:
            numbers: In the order of ``NUMBERS``; touched as ``TOUCHED[bool]``.
        """
        self._arguments[1::2] = numbers
        self._layout.pack_into(self._buffer, self._at, *self._arguments)

    def put(self, name: str, value: float) -> None:
        """Overwrite one number of ``NUMBERS``."""
        self._arguments[2 * NUMBERS.index(name) + 1] = value
        self._layout.pack_into(self._buffer, self._at, *self._arguments)

    def put_map(self, values: memoryview) -> None:
        """Copy the map.

        Args:
            values: 4 bytes a pixel, float32 little-endian.
        """
        self._map[:] = values

    def put_texts(
        self,
        solver: str,
        skipped: tuple[str, ...],
        events: tuple[str, ...],
        electrodes: tuple[str, ...] = (),
    ) -> None:
        """Replace the texts; recurring combinations are kept ready."""
        wanted = (solver, skipped, events, electrodes)
        if wanted == self._texts:
            return  # it is there already
        self._texts = wanted
        tail = self._tails.get(wanted)
        if tail is None:
            content = {
                "solver": solver,
                "skipped": [text[:MAX_TEXT] for text in skipped[:MAX_TEXTS]],
                "events": [text[:MAX_TEXT] for text in events[:MAX_TEXTS]],
                "regions": [list(region.bounds) for region in self._whole_map],
                "electrodes": [text[:MAX_TEXT] for text in electrodes[:MAX_TEXTS]],
                **self._constant,
            }
            tail = b"".join(msgpack.packb(name) + msgpack.packb(value) for name, value in content.items())
            if len(self._tails) < 256:  # bounded, since events can combine in many ways
                self._tails[wanted] = tail
        self._end = self._tail_at + len(tail)
        self._view[self._tail_at : self._end] = tail

    def put_touches(self, touches: tuple[bytes, bytes, int] | None) -> None:
        """Replace the touches, behind the texts.

        Args:
            touches: Their bytes, their events' bytes, and how many are not listed; None for a message without.
        """
        if touches is None and not self._extra:
            return
        extra, entries = b"", self._entries
        if touches is not None:
            listed, events, more = touches
            pack = msgpack.packb
            extra = b"".join((TOUCHES_KEY, pack(listed), BYTES_ENTRY, EVENTS_KEY, pack(events), MORE_KEY, pack(more)))
            entries += KEYS
        self._extra = len(extra)
        self._view[self._end : self._end + len(extra)] = extra
        struct.pack_into(">H", self._buffer, 1, entries)

    def message(self) -> memoryview:
        """Return the present message; the next ``put`` changes it."""
        return self._view[: self._end + self._extra]

    def short_message(self) -> bytes:
        """Return the present message without shape and map."""
        return self._without_map(FIRST_BYTE, ">H", SHORT_HEAD)

    def touch_message(self) -> bytes:
        """Return the message of those that take touches without maps."""
        return self._without_map(TOUCH_FIRST_BYTE, ">I", TOUCH_HEAD)

    def _without_map(self, first: bytes, count: str, version: bytes) -> bytes:
        head, tail = self._view[HEAD_END : self._map_at], self._view[self._tail_at : self._end + self._extra]
        entries = self._entries - 2 + (KEYS if self._extra else 0)
        return b"".join((first, struct.pack(count, entries), version, head, tail))


MAP_UNCHANGED: Final = ("map:unchanged",)
"""The entry of ``skipped`` in a message without its map."""

ZERO: Final = "zero"
"""Instead of a map's key: nothing was computed."""


class FrameMessages:
    """Makes the message of one frame after another, in the memory of one.

    Args:
        configuration: Name and digest of the device's configuration.
        bundle: Id.
        serial_number: Of the device.
        shape: Rows and columns of the map.
    """

    __slots__ = ("_packed_map", "_packer", "_sent_map", "_short", "published", "run")

    def __init__(self, configuration: str, bundle: str, serial_number: str, shape: tuple[int, int]) -> None:
        self.run = os.urandom(4).hex()
        """Differs after each start."""
        self._packer = FramePacker(
            configuration=configuration, bundle=bundle, serial_number=serial_number, run=self.run, shape=shape
        )
        self.published = 0
        """Frames packed so far."""
        self._sent_map: tuple[int, int] | None = None
        """The key of the map that went out last; None where none did."""
        self._packed_map: tuple[int, int] | str | None = None
        """The key of the map that the packer holds, or :data:`ZERO`."""
        self._short = False

    def begin(self, record: FrameRecord, *, short: bool, frames: bool = True) -> None:
        """Give a frame its number and copy its map.

        Args:
            record: The frame.
            short: Omit the map if it is that of the previous frame, which every subscriber has.
            frames: Whether frames have subscribers; else only the touch message is needed, and no map is copied.
        """
        self.published += 1
        if not frames:
            self._short, self._sent_map = False, None
            record.stamps[PACK] = time.perf_counter_ns()
            return
        key = record.map_key
        self._short = short and key == self._sent_map
        self._sent_map = key
        if self._short:
            record.skipped += MAP_UNCHANGED
        else:
            packed = ZERO if record.map_is_zero else key
            if packed != self._packed_map:
                self._packer.put_map(record.map)
                self._packed_map = packed
        record.stamps[PACK] = time.perf_counter_ns()

    def finish(self, record: FrameRecord) -> memoryview:
        """Return the message of the frame, with publishing stamped as now; the next frame overwrites it."""
        packer, stamps = self._packer, record.stamps
        packer.put_texts(record.solver, record.skipped, record.events, record.electrodes)
        packer.put_touches(record.touches)
        stamps[PUBLISH] = time.perf_counter_ns()
        age_us = max(0, (stamps[PUBLISH] - record.scanned_ns) // 1000)
        packer.put_numbers(
            (self.published, record.sequence, record.device_us, age_us, TOUCHED[record.touched], record.gate_logit,
             record.cloud, record.weak_rows, record.map_sequence, *record.drift, record.fused, *stamps, record.lost,
             record.corrupt, record.withheld, record.overrun)
        )  # fmt: skip
        return memoryview(packer.short_message()) if self._short else packer.message()

    def touch_message(self) -> bytes:
        """Return the message, of the frame that was finished last, of those that take touches without maps."""
        return self._packer.touch_message()


class Demand(NamedTuple):
    """What consumers request in addition to frames."""

    frames: bool = True
    """Frames with their maps are requested."""
    touches: bool = False
    """Touches are requested."""
    alone: bool = False
    """Touches without maps are requested."""


class LastMessage:
    """Takes every message, whole, in this process.

    Args:
        touches: Whether the messages have the touches.
    """

    __slots__ = ("asked", "message")
    wanted, short = True, False

    def __init__(self, *, touches: bool = False) -> None:
        self.asked = Demand(touches=touches)
        self.message = b""
        """A copy of the last one."""

    def send(self, message: memoryview) -> None:
        """Keep a copy."""
        self.message = bytes(message)
