"""Writes files whole or not at all: it writes a new file beside the old one and renames it.

A rename replaces anything with that name: a FIFO, a socket, for root even a device node. So only regular files are
replaced, or new ones made. If the name is a symbolic link, the link is replaced and its target stays, so a link placed
in a folder cannot cause another file to be overwritten.
"""

import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO, Final

from eitskin_proto.errors import SkinError
from eitskin_proto.files.reading import FileError, kind_of

SYSTEM: Final = ("/dev/", "/proc/", "/sys/")
"""Where names stand for devices and processes; /dev/shm is a folder like any."""

CUT_OFF: Final = ".part"
"""How names of files end that are being written."""


def check_target(path: str | Path) -> Path:
    """Return the path of a file that is to be written, or refuse one that must not be replaced.

    Args:
        path: A regular file, a link to one or to nothing, or a name that is free.

    Raises:
        FileError: It is a device, a FIFO, a socket or a folder.
        OSError: No file can have this name: it is too long, or leads where this user may not look.
    """
    found = Path(path)
    given = os.path.abspath(found)
    if given.startswith(SYSTEM) and not given.startswith("/dev/shm/"):  # /dev/stdout may be a link to a file
        raise FileError(f"{path} is a device or a stream, expected a regular file; name one")
    with suppress(FileNotFoundError):
        mode = found.stat().st_mode
        if not stat.S_ISREG(mode):
            raise FileError(f"{path} is {kind_of(mode)}, expected a regular file to write, or a new name; name another")
    return found


@contextmanager
def replacing(path: str | Path, mode: int = 0o666) -> Iterator[BinaryIO]:
    """Give a file to write; when the block ends well its content is on disk under ``path``, else nothing changed.

    Args:
        path: See :func:`check_target`.
        mode: Permissions of the file, less the process's umask.

    Raises:
        FileError: See :func:`check_target`.
        OSError: It cannot be written; it names ``path``.
    """
    where = check_target(path)
    begun = os.fsdecode(os.fsencode(where.name)[:200])
    beside = where.with_name(f".{begun}.{secrets.token_hex(6)}{CUT_OFF}")
    try:
        with open(beside, "xb", opener=lambda name, flags: os.open(name, flags, mode)) as stream:
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
        check_target(where)  # the work may have taken hours
        beside.replace(where)
    except BaseException as error:
        with suppress(OSError):
            beside.unlink()
        if isinstance(error, OSError) and error.filename in (None, str(beside)):
            error.filename = str(where)  # a full disk names no file, and the new file's name means nothing to a user
        raise
    if hasattr(os, "O_DIRECTORY"):  # Windows opens no folders
        folder = os.open(where.parent, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            os.fsync(folder)  # the new name is on disk too
        finally:
            os.close(folder)


def is_empty(folder: Path) -> bool:
    """Whether a folder is empty except for files left by killed writers."""
    return all(one.name.startswith(".") and one.name.endswith(CUT_OFF) for one in folder.iterdir())


def write_bytes(path: str | Path, content: bytes, mode: int = 0o666) -> None:
    """Write a file whole or not at all.

    Raises:
        FileError: See :func:`check_target`.
        OSError: It cannot be written.
    """
    with replacing(path, mode) as stream:
        stream.write(content)


class HeldError(SkinError):
    """Another process works in the folder."""


@contextmanager
def held(folder: Path, who: str, hint: str) -> Iterator[None]:
    """Hold a folder while a block runs; where a file system knows no locks, nothing is held.

    Args:
        folder: It is there.
        who: What another process that holds it does, for the message.
        hint: What to do then.

    Raises:
        HeldError: Another process holds it.
        OSError: It cannot be opened.
    """
    import fcntl  # noqa: PLC0415 -- Windows has none, and its programs write without holding a folder

    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        with suppress(OSError):
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise HeldError(f"{folder} is in use: {who}; {hint}") from None
        yield
    finally:
        os.close(handle)
