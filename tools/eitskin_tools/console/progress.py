"""How far a long piece of work is, on stderr: a bar or a spinner on a terminal, lines elsewhere."""

import sys
from collections.abc import Callable
from time import monotonic
from types import TracebackType
from typing import Any, Final, Self

LINE_S: Final = 5.0
"""Between two lines of a :class:`ProgressBar` where no bar can be drawn."""


class ProgressBar:
    """Counted work: a bar with the time left on a terminal, a line every few seconds elsewhere.

    Args:
        what: Is done.
        unit: What is counted, for the lines.
        lines: Print lines where there is no terminal.
    """

    def __init__(self, what: str, unit: str = "", *, lines: bool = True) -> None:
        self.made = 0
        """How many were done since this began: others may have been there."""
        self._what, self._unit, self._lines = what, unit, lines
        self._bar: Any = None
        self._task: Any = None
        self._there: int | None = None
        self._began = self._last = monotonic()

    def __enter__(self) -> Self:
        if sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

            columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
            self._bar = Progress(
                *columns, console=Console(stderr=True), transient=not self._lines, redirect_stdout=False
            )
            self._bar.start()
            self._task = self._bar.add_task(self._what, total=None)
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def show(self, done: int, total: int) -> None:
        """Show how many are done, of how many."""
        if self._there is None:
            self._there = done
        self.made = done - self._there
        if self._bar is not None:
            self._bar.update(self._task, completed=done, total=total)
            return
        now = monotonic()
        if self._lines and self.made and (now - self._last > LINE_S or done == total):
            self._last = now
            left_s = (now - self._began) * (total - done) / self.made
            text = f"{self._what}: {done} of {total} {self._unit}".rstrip()
            print(f"{text}, {left_s:.0f} s left", file=sys.stderr, flush=True)

    def report(self, text: str, more: str = "") -> None:
        """Show a text beside the bar, or print it with something more as a line."""
        if self._bar is not None:
            self._bar.update(self._task, description=text)
        else:
            print(f"{text} {more}".rstrip(), file=sys.stderr, flush=True)


class Stages:
    """Stages of a piece of work, each with its seconds: a stage ends when the next one begins, or when the work ends.

    Entering returns the function that begins a stage by its name.
    """

    def __init__(self) -> None:
        self._name: str | None = None
        self._began = 0.0
        self._bar: Any = None
        self._task: Any = None

    def __enter__(self) -> Callable[[str], None]:
        if sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

            columns = (SpinnerColumn("line"), TextColumn("{task.description}"), TimeElapsedColumn())
            self._bar = Progress(*columns, console=Console(stderr=True), transient=True)
            self._bar.start()
        return self._show_step

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._end("stopped after " if kind else "")
        if self._bar is not None:
            self._bar.stop()

    def _show_step(self, name: str) -> None:
        self._end("")
        self._name, self._began = name, monotonic()
        if self._bar is not None:
            self._task = self._bar.add_task(name, total=None)
        else:
            print(f"{name} ...", file=sys.stderr, flush=True)

    def _end(self, how: str) -> None:
        if self._name is None:
            return
        text = f"{self._name}: {how}{monotonic() - self._began:.1f} s"
        if self._bar is not None:
            self._bar.remove_task(self._task)
            self._bar.console.print(text, highlight=False)
        else:
            print(text, file=sys.stderr, flush=True)
        self._name = None
