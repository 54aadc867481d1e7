"""A folder held for one process: the kernel lets go of it with the process, however that ends."""

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from eitskin_proto.errors import SkinError


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
