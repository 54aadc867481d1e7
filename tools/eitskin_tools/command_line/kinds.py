"""What a command may replace: a file of the kind that it writes, or an empty one; a name of another is a slip.

A file is known by what it holds, never by its name. One that is damaged is still of its kind while its first words, or
the names of its arrays, say so.
"""

import re
import stat
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Final

from eitskin_proto.files.archive import BadArchiveError, members
from eitskin_proto.files.reading import FileError, opened

HEAD_BYTES: Final = 1 << 16
"""Bytes at a file's beginning that are looked at."""

ANY_LENGTH: Final = 1 << 62
"""Bytes: what is looked at is bounded, so the file may be as long as it likes."""


@dataclass(frozen=True, slots=True)
class FileKind:
    """A kind of file, and how to recognise it."""

    what: str
    """For people, with an article."""
    looks: bytes = b""
    """Regular expression of what the beginning of one holds."""
    holds: tuple[str, ...] = ()
    """Names that a ZIP file of this kind has; then ``looks`` is left out."""
    lacks: str = ""
    """A name that it does not have, but another kind with these names has."""

    def fits(self, head: bytes, names: frozenset[str]) -> bool:
        """Return whether a file is of this kind, by its beginning and, of a ZIP file, the names in it."""
        if self.holds:
            return names.issuperset(self.holds) and self.lacks not in names
        return re.search(self.looks, head, re.MULTILINE) is not None


REFERENCE: Final = FileKind("a reference", rb'\A\s*\{[^\0]*"eitskin-reference"')
SKIN: Final = FileKind("a skin's description", rb"^[ \t]*format[ \t]*=[ \t]*[\"']eitskin-skin[\"']")
BUNDLE: Final = FileKind("a bundle", holds=("manifest.json",))
CLOUD: Final = FileKind("a cloud of 'eitskin surface'", holds=("magic.npy", "cloud.npy"))
VOLTAGES: Final = FileKind("voltages of 'eitskin simulate'", holds=("voltages.npy", "voltages208.npy"))
GUIDED: Final = FileKind("a recording to calibrate from", holds=("reference_V.npy", "reference_frames.npy"))
PRESSES: Final = FileKind("presses at known places", holds=("xy_mm.npy", "size_mm.npy"))
CONVERTED: Final = FileKind("a converted recording (.npz)", holds=("voltages_V.npy", "reference_V.npy", "serial.npy"))
COMPUTED: Final = FileKind(
    "maps of 'eitskin reinfer'", holds=("map.npy", "solver.npy", "wall_ns.npy"), lacks="serial.npy"
)
PARQUET: Final = FileKind("a Parquet file", rb"\APAR1")
CSV: Final = FileKind("touches of 'eitskin convert'", rb"\Aseq,device_us,")
RECORDING: Final = FileKind("a recording (.mcap)", rb"\A\x89MCAP0")
PICTURE: Final = FileKind(
    "a picture",
    rb"\A(\x89PNG|\xff\xd8\xff|RIFF....WEBP|II\*\0|MM\0\*|%PDF|%!PS|(\s*<[?!][^>]*>)*\s*<svg)",
)
ARRAY: Final = FileKind("an array of numbers (.npy)", rb"\A\x93NUMPY")
LOG: Final = FileKind("a log of 'eitskin virtual-skin'", rb'\A\{"event": ')


def check_replaced(path: Path, written: FileKind) -> None:
    """Refuse to write over a file of another kind.

    Args:
        path: Of what is to be written; nothing need be there. A link is looked through.
        written: What is written there.

    Raises:
        FileError: There is a file, which is of another kind.
        OSError: It cannot be read, so it is unknown what would be lost.
    """
    try:
        if not stat.S_ISREG((found := path.stat()).st_mode) or found.st_size == 0:
            return
    except FileNotFoundError:
        return
    if not is_of(path, written):
        raise FileError(
            f"{path} holds something other than {written.what}, which would be lost; name another file, or move it away"
        )


def is_of(path: Path, kind: FileKind) -> bool:
    """Return whether a file is of a kind.

    Raises:
        OSError: It cannot be read.
    """
    with opened(path, ANY_LENGTH) as stream:
        head = stream.read(HEAD_BYTES)
        names = _names(stream) if head.startswith(b"PK") else frozenset[str]()
    return kind.fits(head, names)


def _names(stream: BinaryIO) -> frozenset[str]:
    try:
        return frozenset(members(stream))
    except BadArchiveError:
        return frozenset()
