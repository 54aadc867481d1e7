"""A line on stderr for every stage of a long piece of work, with its seconds; a spinner beside it on a terminal."""

import sys
from collections.abc import Callable
from time import monotonic
from types import TracebackType
from typing import Any


class Stages:
    """Tells stages one after another: each ends when the next begins, or when the work does.

    Entering gives the function that is told a stage's name.
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
        return self._tell

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._end("stopped after " if kind else "")
        if self._bar is not None:
            self._bar.stop()

    def _tell(self, name: str) -> None:
        self._end("")
        self._name, self._began = name, monotonic()
        if self._bar is not None:
            self._task = self._bar.add_task(name, total=None)

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
