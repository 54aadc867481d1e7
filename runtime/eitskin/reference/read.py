"""Reads the bytes of a reference's file, or says why it cannot; never advises to overwrite a file of another kind.

Only their owner can read reference files (mode 0600), so another user's file is a common case.
"""

from pathlib import Path
from typing import Final

from eitskin.errors import BadReference
from eitskin_proto.files.reading import FileError, read_bytes

OTHER_FILE_HINT: Final = "name a reference, or capture one into a new file: eitskin reference --port PORT --out NEW"
"""Advice about a file of another kind, which must stay."""


def capture_again(where: Path) -> str:
    """Return advice about a missing or unusable reference."""
    return f"capture it again: eitskin reference --port PORT --out {where}"


def read_reference(where: Path, form: str, largest: int) -> bytes:
    """Return the bytes of a file that says it is a reference, damaged or not.

    Args:
        where: The file.
        form: What a reference says that it is.
        largest: Bytes of a reference.

    Raises:
        BadReference: It is none, or cannot be read.
    """
    try:
        raw = read_bytes(where, largest)
    except FileError as error:
        raise BadReference(f"no reference: {error}; {OTHER_FILE_HINT}") from error
    except PermissionError as error:
        raise BadReference(
            f"reference {where} cannot be read: {error.strerror}; run this as its owner, or capture one into a file of "
            "your own: eitskin reference --port PORT --out NEW"
        ) from error
    except FileNotFoundError as error:
        raise BadReference(f"reference {where} cannot be read: {error.strerror}; {capture_again(where)}") from error
    except OSError as error:
        raise BadReference(f"reference {where} cannot be read: {error.strerror or error}; {OTHER_FILE_HINT}") from error
    if raw.lstrip()[:1] != b"{" or form.encode() not in raw:  # a recording holds one too, among other things
        raise BadReference(f"{where} is not a reference; {OTHER_FILE_HINT}")
    return raw
