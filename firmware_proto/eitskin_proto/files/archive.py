"""Reads members of a ZIP file within bounds: the sizes that a file states are not trusted."""

import io
import struct
import zipfile
import zlib
from dataclasses import dataclass
from typing import BinaryIO, Final

from eitskin_proto.files.plain import plain

DAMAGE: Final = (
    zipfile.BadZipFile, zlib.error, struct.error, EOFError, NotImplementedError, OSError, RuntimeError, ValueError,
)  # fmt: skip
"""What ``zipfile`` raises on files that are damaged, cut off, encrypted or packed in an unknown way."""


class BadArchiveError(ValueError):
    """A file is no ZIP file that can be read."""


MOST_MEMBERS: Final = 4096
LARGEST_DIRECTORY: Final = 1 << 20
"""Bytes of an archive's directory, which ``zipfile`` reads as a whole; a member takes about 60."""

END: Final = struct.Struct("<4s4H2LH")
"""The record at an archive's end: members and the directory's size are its fifth and sixth field."""


@dataclass(frozen=True, slots=True)
class Member:
    """One file in an archive, which must stay open while it is read."""

    archive: zipfile.ZipFile
    entry: zipfile.ZipInfo

    def read(self, largest: int) -> bytes:
        """Return its content.

        Args:
            largest: Most bytes that it may have.

        Raises:
            BadArchiveError: It is longer, damaged, or cannot be unpacked.
        """
        name, size = plain(self.entry.filename[:80]), self.entry.file_size
        if size > largest:
            raise BadArchiveError(f"{name} has {size} bytes by its header, expected at most {largest}")
        try:
            with self.archive.open(self.entry) as stream:
                content = stream.read(size + 1)
        except DAMAGE as error:
            raise BadArchiveError(f"{name} is damaged: {error}") from error
        if len(content) != size:
            raise BadArchiveError(f"{name} is damaged: it holds {len(content)} bytes, its header says {size}")
        return content


def members(source: bytes | BinaryIO) -> dict[str, Member]:
    """Return the members of a ZIP file by name.

    Args:
        source: Its bytes, or the open file.

    Raises:
        BadArchiveError: It is none, or damaged.
    """
    stream = io.BytesIO(source) if isinstance(source, bytes) else source
    try:
        _check_directory(stream)
        archive = zipfile.ZipFile(stream)
    except BadArchiveError:
        raise
    except DAMAGE as error:
        raise BadArchiveError(f"it is not a ZIP file, or its directory is damaged: {error}") from error
    return {entry.filename: Member(archive, entry) for entry in archive.infolist()}


def _check_directory(stream: BinaryIO) -> None:
    """Refuse a directory of millions of members before ``zipfile`` makes an object of each."""
    size = stream.seek(0, io.SEEK_END)
    stream.seek(max(0, size - (1 << 16) - END.size))
    tail = stream.read()
    ends = {len(tail) - END.size, tail.rfind(b"PK\5\6")}  # where zipfile looks, one after the other
    for at in ends:
        if at < 0 or tail[at : at + 4] != b"PK\5\6" or at + END.size > len(tail):
            continue
        _, _, _, here, count, directory, _, _ = END.unpack_from(tail, at)
        if max(here, count) > MOST_MEMBERS or directory > LARGEST_DIRECTORY or tail[at - 20 : at - 16] == b"PK\6\7":
            raise BadArchiveError(
                f"its directory lists {count} members in {directory} bytes, expected at most {MOST_MEMBERS} in "
                f"{LARGEST_DIRECTORY}"
            )
    stream.seek(0)
