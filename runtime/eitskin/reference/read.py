"""Reads the bytes of a reference's file, or says why it cannot; never advises to overwrite a file of another kind.

Only their owner can read reference files (mode 0600), so another user's file is a common case.
"""

import os
import pwd
from contextlib import suppress
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
        raise BadReference(f"reference {where} cannot be read: {_denied(where)}") from error
    except FileNotFoundError as error:
        raise BadReference(f"reference {where} cannot be read: {error.strerror}; {capture_again(where)}") from error
    except OSError as error:
        raise BadReference(f"reference {where} cannot be read: {error.strerror or error}; {OTHER_FILE_HINT}") from error
    if raw.lstrip()[:1] != b"{" or form.encode() not in raw:  # a recording holds one too, among other things
        raise BadReference(f"{where} is not a reference; {OTHER_FILE_HINT}")
    return raw


def _denied(where: Path) -> str:
    """Return the owner of a file that this user may not read, and advice."""
    me = _user(os.geteuid())
    with suppress(OSError):
        found = where.stat()
        if found.st_uid != os.geteuid():
            owner = _user(found.st_uid)
            return (
                f"it belongs to the user {owner}, not to {me}; run this as {owner}, or capture it as "
                f"{me} into a file of its own, or give it away: sudo chown {me} {where}"
            )
        return f"its mode {found.st_mode & 0o777:04o} does not let even its owner, {me}, read it: chmod 600 {where}"
    return f"{me} may not enter its folder; put it where {me} may read it"


def _user(number: int) -> str:
    """Return a user's name, or the number of a user without one, as in a container."""
    try:
        return pwd.getpwuid(number).pw_name
    except KeyError:
        return str(number)
