"""The person at the terminal: lines out, lines in, without waiting for either."""

import os
import select
import sys
from typing import Final

from eitskin_proto.files.plain import plain
from eitskin_tools.console.status_line import StatusLine

LONGEST: Final = 4096
"""Bytes of a line that are kept."""


class Terminal:
    """Tells on standard output, and takes typed lines from standard input; at its end, none come any more."""

    def __init__(self) -> None:
        self._line = StatusLine(sys.stdout)
        self._input = sys.stdin.fileno()
        self._typed = b""
        self._open = True

    def tell(self, text: str) -> None:
        """Print a line."""
        self._line.above(plain(text))

    def show(self, text: str) -> None:
        """Show how it is going in the last line; nothing where nobody looks on."""
        self._line.show(text)

    def answer(self) -> str | None:
        """Return a line that was typed, or None."""
        while self._open and select.select([self._input], [], [], 0.0)[0]:
            more = os.read(self._input, LONGEST)
            self._open = bool(more)
            self._typed = (self._typed + more)[-LONGEST:]
        line, end, rest = self._typed.partition(b"\n")
        if not end and (self._open or not line):
            return None
        self._typed = rest
        return line.decode(errors="replace").strip()

    @property
    def left(self) -> bool:
        """Whether nothing will be typed any more: standard input is at its end, and every line was taken."""
        return not self._open and not self._typed

    def end(self) -> None:
        """Leave the last line."""
        self._line.end()
