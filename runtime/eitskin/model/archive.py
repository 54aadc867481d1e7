"""Reads members of a ZIP file within bounds: what a file claims about sizes is never believed."""

import io
import struct
import zipfile
import zlib
from dataclasses import dataclass
from typing import BinaryIO, Final

DAMAGE: Final = (
    zipfile.BadZipFile, zlib.error, struct.error, EOFError, NotImplementedError, OSError, RuntimeError, ValueError,
)  # fmt: skip
"""What ``zipfile`` raises on files that are damaged, cut off, encrypted or packed in an unknown way."""


class BadArchiveError(ValueError):
    """A file is no ZIP file that can be read."""


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
        name, size = self.entry.filename, self.entry.file_size
        if size > largest:
            raise BadArchiveError(f"{name} claims {size} bytes, expected at most {largest}")
        try:
            with self.archive.open(self.entry) as stream:
                content = stream.read(size + 1)
        except DAMAGE as error:
            raise BadArchiveError(f"{name} is damaged: {error}") from error
        if len(content) != size:
            raise BadArchiveError(f"{name} is damaged: it holds {len(content)} bytes and claims {size}")
        return content


def members(source: bytes | BinaryIO) -> dict[str, Member]:
    """Return the members of a ZIP file by name.

    Args:
        source: Its bytes, or the open file.

    Raises:
        BadArchiveError: It is none, or damaged.
    """
    try:
        archive = zipfile.ZipFile(io.BytesIO(source) if isinstance(source, bytes) else source)
    except DAMAGE as error:
        raise BadArchiveError(f"it is no ZIP file, or its directory is damaged: {error}") from error
    return {entry.filename: Member(archive, entry) for entry in archive.infolist()}
