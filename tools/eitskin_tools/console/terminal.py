"""Output to a terminal: lines without control characters, a status line, and the journal's levels.

Parts of a line may come from a device, a file or a network, so control characters are made visible. A standard stream
that accepts no more, on a full disk or without a reader, is replaced by /dev/null before the interpreter ends, because
the interpreter would otherwise print an error and change the exit status. In systemd's journal, whose device and inode
``JOURNAL_STREAM`` names, each line begins with its level (``sd-daemon(3)``).
"""

import argparse
import json
import os
import select
import shutil
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any, Final, TextIO

from eitskin_proto.files.plain import plain


def unread() -> bool:
    """Return whether standard output or standard error has lost its reader, as behind ``| head -1``."""
    poller = select.poll()
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):  # a test's has no file
            poller.register(stream.fileno(), 0)
    return any(found & (select.POLLERR | select.POLLHUP) for _, found in poller.poll(0))


def takes_more(stream: TextIO, wait_s: float) -> bool:
    """Return whether a stream takes a line of up to 4096 bytes at once; a full pipe does not.

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


LEVELS: Final = {"error": 3, "warning": 4, "ready": 5, "info": 6, "status": 6}
"""syslog's levels by event: err, warning, notice, info."""


def goes_to_journal(stream: TextIO, environment: Mapping[str, str]) -> bool:
    """Return whether a stream is the one that the journal reads."""
    device, _, inode = environment.get("JOURNAL_STREAM", "").partition(":")
    if not device.isdecimal() or not inode.isdecimal():
        return False
    try:
        found = os.fstat(stream.fileno())
    except (OSError, ValueError):  # closed, or none of the system's
        return False
    return (found.st_dev, found.st_ino) == (int(device), int(inode))


def prefix(event: str) -> str:
    """Return what stands before a line of an event in the journal."""
    return f"<{LEVELS.get(event, 6)}>"


def has_display(stream: TextIO) -> bool:
    """Return whether a stream is a terminal within a desktop session."""
    return stream.isatty() and bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def say(line: str) -> None:
    """Print one line."""
    print(plain(line), flush=sys.stdout.isatty())


def note(line: str) -> None:
    """Print one line on stderr, of what goes on."""
    print(plain(line), file=sys.stderr, flush=True)


def answer(arguments: argparse.Namespace, found: Mapping[str, Any], *lines: str) -> int:
    """Print what a command found, as one JSON object with ``--json`` and as lines else; return 0."""
    if arguments.json:
        print(json.dumps(found))
    else:
        for line in "\n".join(lines).splitlines():
            say(line)
    return 0


def in_words(value: object) -> str:
    """Return a value on one line: ``none`` for nothing, ``yes`` or ``no``, texts of a list behind each other.

    Names of codes, such as ``ROLLED_BACK``, are in small letters. Numbers, and lists of them, are as a TOML file has
    them.
    """
    if value is None or value in ("", []):
        return "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list) and all(isinstance(one, str) for one in value):
        return "; ".join(one.lower().replace("_", " ") if one.isupper() else one for one in value)
    return str(value)


class StatusLine:
    """Owns the last line of a stream while something runs.

    Args:
        stream: Where it goes; nothing is drawn where it is no terminal.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._shown = False
        self.live = stream.isatty()
        """Whether it is a terminal, where a line can be rewritten."""

    def show(self, text: str) -> None:
        """Put a text in place of the one before."""
        if self.live:
            width = shutil.get_terminal_size().columns - 1  # a full line would wrap
            self._write(f"\r{plain(text)[:width]}\x1b[K")
            self._shown = True

    def above(self, text: str) -> None:
        """Print a whole line; the status line moves below it with the next :meth:`show`."""
        text = plain(text)
        self._write(f"\r\x1b[K{text}\n" if self._shown else f"{text}\n")
        self._shown = False

    def end(self) -> None:
        """Leave the last text where it is, and go to the next line."""
        if self._shown:
            self._write("\n")
            self._shown = False

    def _write(self, text: str) -> None:
        self._stream.write(text)
        self._stream.flush()
