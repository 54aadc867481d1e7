"""One line that is rewritten in place on a terminal, never longer than the terminal is wide, and never obeyed by it."""

import shutil
from typing import TextIO

from eitskin_proto.files.plain import plain


class StatusLine:
    """Owns the last line of a stream while something runs.

    Args:
        stream: Where it goes; nothing is drawn where it is no terminal.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._shown = False
        self.live = stream.isatty()
        """Whether somebody looks on, so that a line can be rewritten."""

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
