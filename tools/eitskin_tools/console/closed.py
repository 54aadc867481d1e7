"""Standard streams that were closed, as by ``eitskin run ... 2>&-``, that take no more, or not every character.

Python has None in place of a closed one, and what is opened next gets its number: a library's warning would go down the
line to a device. So /dev/null takes the place of each before anything else is opened; and that of one that is on a full
disk, or that nobody reads any more, before the interpreter ends: it would end with a status and words of its own.

Where standard output is not UTF-8, a character that it does not have is written as an escape, as standard error does by
itself: no command ends for a file's name.
"""

import io
import os
import select
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Final, TextIO

STREAMS: Final = {0: ("stdin", "r"), 1: ("stdout", "w"), 2: ("stderr", "w")}
"""File descriptor -> name in ``sys``, and how it is opened."""


def replace_closed() -> None:
    """Put /dev/null in place of every standard stream that was closed."""
    for number, (name, mode) in STREAMS.items():
        if getattr(sys, name) is not None:
            continue
        handle = os.open(os.devnull, os.O_RDWR)  # the lowest number that is free: mostly the stream's own
        if handle != number and _free(number):
            os.dup2(handle, number)
            os.close(handle)
            handle = number
        setattr(sys, name, open(handle, mode, encoding="utf-8", closefd=False))  # noqa: SIM115 -- as long as we run


def escape_unwritable() -> None:
    """Have characters that standard output cannot encode written as escapes, as standard error does by itself."""
    stream = sys.stdout
    if isinstance(stream, io.TextIOWrapper) and (stream.errors == "strict" or stream.encoding.lower() != "utf-8"):
        stream.reconfigure(errors="backslashreplace")


def unread() -> bool:
    """Return whether nobody reads standard output or standard error any more, as behind ``| head -1``."""
    poller = select.poll()
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):  # a test's has no file
            poller.register(stream.fileno(), 0)
    return any(found & (select.POLLERR | select.POLLHUP) for _, found in poller.poll(0))


def takes_more(stream: TextIO, wait_s: float) -> bool:
    """Return whether a stream takes a line of up to 4096 bytes at once: a pipe that nobody empties does not.

    Args:
        stream: One without a file always does.
        wait_s: How long it may take until there is room.
    """
    poller = select.poll()
    try:
        poller.register(stream.fileno(), select.POLLOUT)
    except (OSError, ValueError):
        return True
    return bool(poller.poll(1000 * wait_s))


@contextmanager
def written_out() -> Iterator[None]:
    """Have all that the block said written when it ends.

    Raises:
        OSError: Standard output takes no more; what standard error does not take changes no result.
    """
    try:
        yield
    finally:
        _flush(sys.stderr)
        if (error := _flush(sys.stdout)) is not None:
            raise error


def _flush(stream: TextIO) -> OSError | None:
    """Write what a stream holds, to /dev/null where it takes no more; return why it does not."""
    try:
        stream.flush()
    except OSError as error:
        nowhere = os.open(os.devnull, os.O_WRONLY | os.O_CLOEXEC)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)
        return error
    return None


def _free(number: int) -> bool:
    try:
        os.fstat(number)
    except OSError:
        return True
    return False
