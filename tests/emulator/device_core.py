"""The device's C code on this machine, through ctypes: the very functions that the firmware has.

:class:`Core` wraps the codecs; :class:`HostDevice` is a whole device with storage, clock and front end in memory, and
also a :class:`eitskin.acquisition.transport.Transport`, so that everything that talks to a real skin can talk to it.
"""

import ctypes
from functools import cache
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
from tests.emulator.firmware import build

from eitskin.errors import PortLost

OK: Final = 0
"""``EIT_OK``."""


MOST_OUTCOMES: Final = 32
"""So many different outcomes are kept between two looks."""


class Outcome(NamedTuple):
    """What a device runs after a boot, and what once every trial is over; generation 0 is what is built in."""

    generation: int
    digest: int
    trial: int
    """1: it runs on trial."""
    settled_generation: int
    settled_digest: int


class _DeframerState(ctypes.Structure):
    """``struct eit_deframer``."""

    _fields_ = (
        ("buffer", ctypes.c_void_p), ("capacity", ctypes.c_size_t), ("used", ctypes.c_size_t),
        ("seen", ctypes.c_size_t), ("left", ctypes.c_uint8), ("zero_pending", ctypes.c_bool),
        ("flooded", ctypes.c_bool), ("synchronised", ctypes.c_bool), ("packets", ctypes.c_uint32),
        ("corrupt", ctypes.c_uint32), ("discarded_bytes", ctypes.c_uint32),
    )  # fmt: skip


class FrameState(ctypes.Structure):
    """``struct eit_frame``."""

    _fields_ = (
        ("flags", ctypes.c_uint8), ("sample_bytes", ctypes.c_uint8), ("rows", ctypes.c_uint8),
        ("generation", ctypes.c_uint32), ("sequence", ctypes.c_uint32), ("device_us", ctypes.c_uint32),
        ("drives", ctypes.c_uint16), ("device_dropped", ctypes.c_uint16),
    )  # fmt: skip


@cache
def library() -> ctypes.CDLL:
    """Return the library, built on first use.

    Raises:
        SkinError: It cannot be built; the text says what is missing.
    """
    return load(build("host"))


def load(path: Path) -> ctypes.CDLL:
    """Return the library of a file, with the types of its functions declared."""
    core = ctypes.CDLL(str(path))
    u8, u32, size, pointer = ctypes.c_uint8, ctypes.c_uint32, ctypes.c_size_t, ctypes.c_void_p
    for name, result, arguments in (
        ("eit_crc", u32, [ctypes.c_char_p, size]),
        ("eit_packet", ctypes.c_int, [ctypes.c_char_p, size, pointer, size, ctypes.POINTER(size)]),
        ("eit_deframer_init", None, [ctypes.POINTER(_DeframerState), pointer, size]),
        ("eit_host_feed", size, [ctypes.POINTER(_DeframerState), ctypes.c_char_p, size, pointer, size]),
        ("eit_message_check", ctypes.c_int, [ctypes.c_char_p, size]),
        ("eit_row_count", u8, [ctypes.c_bool, ctypes.c_uint16]),
        ("eit_drive_count", u8, [ctypes.c_bool, ctypes.c_uint16]),
        ("eit_frame_get_header", ctypes.c_int, [ctypes.c_char_p, size, ctypes.POINTER(FrameState)]),
        ("eit_frame_get_sample", ctypes.c_int32, [ctypes.c_char_p, u8, u8]),
        ("eit_frame_put_sample", None, [pointer, u8, u8, ctypes.c_int32]),
        ("eit_frame_put_header", None, [ctypes.POINTER(FrameState), pointer]),
        ("eit_config_read", ctypes.c_int, [ctypes.c_char_p, size, pointer]),
        ("eit_host_bytes", size, []),
        ("eit_host_init", None, [pointer]),
        ("eit_host_boot", None, [pointer]),
        ("eit_host_receive", None, [pointer, ctypes.c_char_p, size]),
        ("eit_host_run", None, [pointer, u32, u32]),
        ("eit_host_take", size, [pointer, pointer, size]),
        ("eit_host_set_line", None, [pointer, size]),
        ("eit_host_cut", None, [pointer, u32, u32]),
        ("eit_host_changes", u32, [pointer]),
        ("eit_host_is_dead", ctypes.c_int, [pointer]),
        ("eit_host_restarts", u32, [pointer]),
        ("eit_host_set_counts", None, [pointer, pointer, pointer]),
        ("eit_host_set_front_end", None, [pointer, ctypes.c_int]),
        ("eit_host_set_clock", None, [pointer, u32]),
        ("eit_host_watch", None, [pointer, u32]),
        ("eit_host_outcomes", size, [pointer, pointer, size]),
        ("eit_host_images", u32, [pointer]),
        ("eit_host_outcome_of", None, [ctypes.c_char_p, pointer]),
    ):
        function = getattr(core, name)
        function.restype, function.argtypes = result, arguments
    return core


def packet(payload: bytes, capacity: int) -> tuple[int, bytes, bytes]:
    """Return status, packet and the canary bytes behind it, from the C encoder with a buffer of this capacity."""
    buffer = ctypes.create_string_buffer(b"\xa5" * (capacity + 16), capacity + 16)
    written = ctypes.c_size_t()
    status = library().eit_packet(payload, len(payload), buffer, capacity, ctypes.byref(written))
    return status, buffer.raw[: written.value], buffer.raw[capacity:]


class CoreDeframer:
    """The C deframer with the interface of :class:`eitskin_proto.wire.framing.Deframer`."""

    def __init__(self, max_payload: int) -> None:
        self._capacity = max_payload + 4
        self._buffer = ctypes.create_string_buffer(b"\xa5" * (self._capacity + 16), self._capacity + 16)
        self._state = _DeframerState()
        library().eit_deframer_init(ctypes.byref(self._state), self._buffer, self._capacity)

    @property
    def packets(self) -> int:
        """Intact packets so far."""
        return int(self._state.packets)

    @property
    def corrupt(self) -> int:
        """Pieces that were no intact packet."""
        return int(self._state.corrupt)

    @property
    def discarded_bytes(self) -> int:
        """Bytes that were dropped."""
        return int(self._state.discarded_bytes)

    @property
    def canary(self) -> bytes:
        """Sixteen bytes behind the buffer, which nothing may change from 0xa5."""
        return self._buffer.raw[self._capacity :]

    def feed(self, data: bytes) -> list[bytes]:
        """Return the payloads that these bytes complete."""
        out = ctypes.create_string_buffer(3 * len(data) + self._capacity + 8)
        used = library().eit_host_feed(ctypes.byref(self._state), data, len(data), out, len(out))
        raw, payloads, at = out.raw[:used], [], 0
        while at < used:
            length = int.from_bytes(raw[at : at + 2], "little")
            payloads.append(raw[at + 2 : at + 2 + length])
            at += 2 + length
        return payloads


class HostDevice:
    """A device made of the C core, in this process, with a clock that only ``read`` and ``run`` move.

    Args:
        core: The core's library; by default the one that is built from the sources.
    """

    def __init__(self, core: ctypes.CDLL | None = None) -> None:
        self._core = core or library()
        self._memory = ctypes.create_string_buffer(self._core.eit_host_bytes())
        self._core.eit_host_init(self._memory)
        self._out = ctypes.create_string_buffer(65536)
        self._outcomes = (ctypes.c_uint32 * (5 * MOST_OUTCOMES))()
        self.cut_line = False
        """True: bytes to the device are lost, as with a pulled plug."""

    @property
    def name(self) -> str:
        """What people call this line."""
        return "the host model of the device"

    @property
    def line_bytes_per_s(self) -> int:
        """No limit of its own; the device's HELLO names one."""
        return 0

    def read(self, timeout_s: float | None = None) -> bytes:
        """Let the device work until it says something, or until the timeout has passed on its clock.

        Raises:
            PortLost: The power was cut.
        """
        left_us = 1_000_000 if timeout_s is None else round(timeout_s * 1e6)
        while True:
            if self.dead:
                raise PortLost(f"{self.name} has no power")
            data = self.take()
            if data or left_us <= 0:
                return data
            self.run(min(left_us, 1000))
            left_us -= 1000

    def write(self, data: bytes) -> None:
        """Send bytes to the device."""
        if not self.cut_line:
            self._core.eit_host_receive(self._memory, bytes(data), len(data))

    def cancel(self) -> None:
        """Nothing waits here for longer than a call."""

    def report(self) -> list[str]:
        """Return nothing: no options were asked for."""
        return []

    def close(self) -> None:
        """Nothing to give back."""

    def take(self) -> bytes:
        """Return what the device has sent, without letting time pass."""
        count = self._core.eit_host_take(self._memory, self._out, len(self._out))
        return ctypes.string_at(self._out, count)

    def run(self, duration_us: int, step_us: int = 50) -> None:
        """Let time pass."""
        self._core.eit_host_run(self._memory, duration_us, step_us)

    def boot(self) -> None:
        """Switch off and on: memory is lost, storage is not, and what was on the line is gone."""
        self.take()
        self._core.eit_host_boot(self._memory)

    def cut_power_at(self, change: int, seed: int) -> None:
        """Cut the power at the n-th change of storage from now; 0 for never.

        Args:
            change: 1 is the next one.
            seed: 0 cuts just before it, 1 just after it, any other number chooses the bits that a torn word got.
        """
        self._core.eit_host_cut(self._memory, change, seed)

    @property
    def changes(self) -> int:
        """Changes of storage so far: a programmed word, or a word of an erase."""
        return int(self._core.eit_host_changes(self._memory))

    @property
    def dead(self) -> bool:
        """Whether the power is cut; ``boot`` brings it back."""
        return bool(self._core.eit_host_is_dead(self._memory))

    @property
    def restarts(self) -> int:
        """Times that the device restarted on request."""
        return int(self._core.eit_host_restarts(self._memory))

    def watch(self, seed: int) -> None:
        """Find out at every change of storage what would boot if power failed then; 0: no more.

        Args:
            seed: Of the bits that a torn word got.
        """
        self._core.eit_host_watch(self._memory, seed)

    def outcomes(self) -> list[Outcome]:
        """Return what was found since the last call, each outcome once; at most 32 of them."""
        found = self._outcomes
        count = self._core.eit_host_outcomes(self._memory, found, MOST_OUTCOMES)
        return [Outcome(*found[5 * i : 5 * i + 5]) for i in range(count)]

    @property
    def images(self) -> int:
        """States of storage that were booted to find that out, since ``watch``."""
        return int(self._core.eit_host_images(self._memory))

    def limit_line(self, capacity: int) -> None:
        """Limit the bytes that the line holds until they are taken."""
        self._core.eit_host_set_line(self._memory, capacity)

    def set_clock(self, now_us: int) -> None:
        """Set the device's clock, to come close to its wrap."""
        self._core.eit_host_set_clock(self._memory, now_us)

    def break_front_end(self, broken: bool) -> None:
        """Let the front end fail from now on, or work again."""
        self._core.eit_host_set_front_end(self._memory, int(broken))

    def set_counts(self, counts: npt.NDArray[np.int32], saturated: npt.NDArray[np.uint16]) -> None:
        """Set what the front end measures.

        Args:
            counts: (16 drives, 16 pairs) left-justified in 32 bit.
            saturated: (16 drives,) bit m: pair m was cut off.
        """
        flat = np.ascontiguousarray(counts, dtype=np.int32).reshape(16, 16)
        bits = np.ascontiguousarray(saturated, dtype=np.uint16).reshape(16)
        self._core.eit_host_set_counts(self._memory, flat.ctypes.data, bits.ctypes.data)
