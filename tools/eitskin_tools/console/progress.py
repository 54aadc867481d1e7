"""How far a long piece of work is, on stderr: a line kept up to date on a terminal, a line now and then elsewhere."""

import sys
from collections.abc import Callable
from time import monotonic
from types import TracebackType
from typing import Final, Self

from eitskin_tools.console.terminal import StatusLine

LINE_S: Final = 5.0
"""Between two lines elsewhere than on a terminal."""

REDRAW_S: Final = 0.2
"""Between two texts on a terminal."""


class ProgressBar:
    """Counted work, with the time left.

    Args:
        what: Is done.
        unit: What is counted.
        lines: Print lines where there is no terminal.
    """

    def __init__(self, what: str, unit: str = "", *, lines: bool = True) -> None:
        self.made = 0
        """How many were done since this began: others may have been there."""
        self._what, self._unit = what, unit
        self._line = StatusLine(sys.stderr)
        self._shown = lines or self._line.live
        self._every_s = REDRAW_S if self._line.live else LINE_S
        self._there: int | None = None
        self._began = self._last = monotonic()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._line.end()

    def show(self, done: int, total: int) -> None:
        """Show how many are done, of how many."""
        if self._there is None:
            self._there = done
        self.made = done - self._there
        now = monotonic()
        if self._shown and self.made and (now - self._last > self._every_s or done == total):
            self._last = now
            left_s = (now - self._began) * (total - done) / self.made
            text = f"{self._what}: {done} of {total} {self._unit}".rstrip()
            put = self._line.show if self._line.live else self._line.above
            put(f"{text}, {left_s:.0f} s left")

    def report(self, text: str) -> None:
        """Print a line."""
        self._line.above(text)


class Stages:
    """Stages of a piece of work, each with its seconds: a stage ends when the next one begins, or when the work ends.

    Entering returns the function that begins a stage by its name.
    """

    def __init__(self) -> None:
        self._line = StatusLine(sys.stderr)
        self._name: str | None = None
        self._began = 0.0

    def __enter__(self) -> Callable[[str], None]:
        return self._show_step

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._end("stopped after " if kind else "")

    def _show_step(self, name: str) -> None:
        self._end("")
        self._name, self._began = name, monotonic()
        put = self._line.show if self._line.live else self._line.above
        put(f"{name} ...")

    def _end(self, how: str) -> None:
        if self._name is not None:
            self._line.above(f"{self._name}: {how}{monotonic() - self._began:.1f} s")
            self._name = None
