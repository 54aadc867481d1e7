"""Reads members of a ZIP file, and no more of ZIP than bundles need: stored or deflated, no encryption, under 4 GB.

Python's ``zipfile`` is complete, and for that loads compressors, temporary files and logging: 20 ms and 3 MB of a
runtime that reads one file. What a file claims about sizes is never believed. ::

    member 1 | member 2 | ... | directory: an entry for each | end: where the directory is
"""

import mmap
import struct
import zlib
from collections.abc import Iterator
from typing import Final

Data = bytes | mmap.mmap

END: Final = struct.Struct("<4s4H2LH")
"""Signature, disk numbers, entries on this disk and in all, size and offset of the directory, length of a comment."""

ENTRY: Final = struct.Struct("<4s6H3L5H2L")
"""Signature, versions, flags, method, time, date, CRC-32, sizes packed and unpacked, three lengths, disk, attributes,
offset."""

LOCAL: Final = struct.Struct("<4s5H3L2H")
"""The same once more before each member."""

STORED, DEFLATED = 0, 8


class BadArchiveError(ValueError):
    """A file is no ZIP file that can be read."""


def members(data: Data) -> dict[str, "Member"]:
    """Return the members of a ZIP file by name.

    Raises:
        BadArchiveError: It is none, or damaged.
    """
    at = data.rfind(b"PK\5\6", max(0, len(data) - 65557))
    if at < 0 or at + END.size > len(data):
        raise BadArchiveError("it is no ZIP file, or its end is missing")
    _, _, _, _, count, _, offset, _ = END.unpack_from(data, at)
    try:
        return {member.name: member for member in _entries(data, offset, count)}
    except (struct.error, UnicodeDecodeError) as error:
        raise BadArchiveError(f"its directory is damaged: {error}") from error


def _entries(data: Data, at: int, count: int) -> Iterator["Member"]:
    for _ in range(count):
        fields = ENTRY.unpack_from(data, at)
        signature, method, crc, packed, size, offset = fields[0], fields[4], *fields[7:10], fields[16]
        name, extra, comment = fields[10:13]
        if signature != b"PK\1\2":
            raise BadArchiveError("its directory is damaged")
        start = at + ENTRY.size
        yield Member(data, data[start : start + name].decode(), method, crc, packed, size, offset)
        at = start + name + extra + comment


class Member:
    """One file in the archive."""

    __slots__ = ("_crc", "_data", "_method", "_offset", "_packed", "name", "size")

    def __init__(self, data: Data, name: str, method: int, crc: int, packed: int, size: int, offset: int) -> None:
        self._data = data
        self._method, self._crc, self._packed, self._offset = method, crc, packed, offset
        self.name = name
        self.size = size
        """Bytes that it claims to have."""

    def read(self, largest: int, *, check: bool = True) -> bytes:
        """Return its content.

        Args:
            largest: Most bytes that it may have.
            check: Compare its CRC-32; not needed where a digest of it is known.

        Raises:
            BadArchiveError: It is longer, damaged, or packed in an unknown way.
        """
        if self.size > largest:
            raise BadArchiveError(f"{self.name} claims {self.size} bytes, expected at most {largest}")
        if self._offset + LOCAL.size > len(self._data):
            raise BadArchiveError(f"{self.name} is cut off")
        local = LOCAL.unpack_from(self._data, self._offset)
        start = self._offset + LOCAL.size + local[9] + local[10]
        packed = self._data[start : start + self._packed]
        if local[0] != b"PK\3\4" or len(packed) != self._packed:
            raise BadArchiveError(f"{self.name} is cut off")
        content = self._unpack(packed)
        if len(content) != self.size or (check and zlib.crc32(content) != self._crc):
            raise BadArchiveError(f"{self.name} is damaged")
        return content

    def _unpack(self, packed: bytes) -> bytes:
        if self._method == STORED:
            return packed
        if self._method != DEFLATED:
            raise BadArchiveError(f"{self.name} is packed by method {self._method}, expected stored or deflated")
        try:
            return zlib.decompressobj(-15).decompress(packed, self.size + 1)  # a bounded read: the claim may be a lie
        except zlib.error as error:
            raise BadArchiveError(f"{self.name} is damaged: {error}") from error
