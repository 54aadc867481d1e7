"""Shared memory with three letters: how a shape is set up, a frame to verify, and what the sheet reads untouched.

Each is overwritten by the next of its kind: who writes never waits, and who reads finds the newest, so nothing queues
up. A letter that is overwritten while it is read does not have its checksum, and is read again when the bell rings. ::

    beat | late | head of SETUP | SETUP ... | head of FRAME | FRAME ... | head of REST | REST ...
"""

import mmap
import os
import struct
import zlib
from typing import Final, Self

SETUP, FRAME, REST = 0, 1, 2
"""The letters."""

SIZES: Final = (1 << 18, 1 << 16, 1 << 10)
"""Bytes of each: a cloud of the largest map has 173 kB, its map 58 kB, and the rows of a frame 832 bytes."""

_HEAD: Final = struct.Struct("<QII")
"""Number, length, checksum."""

_WORD: Final = struct.Struct("@Q")
"""Native: written at once, so that the other side never reads half of it."""

_BEAT: Final = 0
_LATE: Final = 8
_STARTS: Final = tuple(64 + which * _HEAD.size + sum(SIZES[:which]) for which in (SETUP, FRAME, REST))
_BYTES: Final = _STARTS[REST] + _HEAD.size + SIZES[REST]


class Mailbox:
    """The memory, seen from one side.

    Args:
        descriptor: Of the memory.
    """

    def __init__(self, descriptor: int) -> None:
        self.descriptor = descriptor
        self._memory = mmap.mmap(descriptor, _BYTES)
        self._read = [0] * len(SIZES)
        self.written = [0] * len(SIZES)
        """Numbers of the letters written from this side."""

    @classmethod
    def made(cls) -> Self:
        """Return a new one."""
        descriptor = os.memfd_create("eitskin-verifier")
        os.ftruncate(descriptor, _BYTES)
        return cls(descriptor)

    def put(self, which: int, *parts: bytes) -> int:
        """Write a letter over the one before, and return its number, from 1 on.

        Args:
            which: ``SETUP``, ``FRAME`` or ``REST``.
            parts: Of its content.

        Raises:
            ValueError: It does not fit.
        """
        content = b"".join(parts)
        if len(content) > SIZES[which]:
            raise ValueError(f"a letter of {len(content)} bytes; expected at most {SIZES[which]}")
        self.written[which] = number = self.written[which] + 1
        at = _STARTS[which]
        end = at + _HEAD.size + len(content)
        check = zlib.crc32(content, number & 0xFFFFFFFF)
        self._memory[at:end] = _HEAD.pack(number, len(content), check) + content
        return number

    def take(self, which: int) -> tuple[int, bytes] | None:
        """Return number and content of a letter that was not taken before; None where there is none, or not yet.

        Args:
            which: ``SETUP``, ``FRAME`` or ``REST``.
        """
        at = _STARTS[which]
        number, length, check = _HEAD.unpack_from(self._memory, at)
        if number == self._read[which] or length > SIZES[which]:
            return None
        begin = at + _HEAD.size
        content = self._memory[begin : begin + length]
        if zlib.crc32(content, number & 0xFFFFFFFF) != check:
            return None
        self._read[which] = number
        return number, content

    def skip(self, which: int, number: int) -> None:
        """Take a letter for taken: it was for somebody before."""
        self._read[which] = number

    @property
    def beat(self) -> int:
        """What changes as long as the verifier lives."""
        found: int = _WORD.unpack_from(self._memory, _BEAT)[0]
        return found

    def give_beat(self) -> None:
        """Change it."""
        _WORD.pack_into(self._memory, _BEAT, (self.beat + 1) & 0xFFFFFFFFFFFF)

    @property
    def late_s(self) -> float:
        """Seconds that what is computed takes beyond what it may; 0 while it is in time."""
        return 1e-3 * float(_WORD.unpack_from(self._memory, _LATE)[0])

    @late_s.setter
    def late_s(self, late_s: float) -> None:
        _WORD.pack_into(self._memory, _LATE, round(1e3 * late_s))

    def close(self) -> None:
        """Let go of the memory; closing twice is fine."""
        if not self._memory.closed:
            self._memory.close()
            os.close(self.descriptor)
