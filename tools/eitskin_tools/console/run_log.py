"""The log of ``eitskin run`` on stderr: lines for people, one JSON object a line, or almost nothing.

Every format has the same events. ``ready`` and errors are written even when quiet, because programs wait for ``ready``.
In systemd's journal each line begins with its level, which the journal removes. A log that cannot be written, as on a
full disk or in a pipe that is not read, does not stop a skin: lines without room are omitted.
"""

import json
import os
import sys
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from datetime import UTC, datetime
from typing import Final, Literal, TextIO

from eitskin_tools.console.terminal import StatusLine, goes_to_journal, prefix, takes_more

UNQUIETED_EVENTS: Final = ("warning", "error", "ready")
"""Events that are said even when quiet."""

FORMATS: Final = ("text", "json")
"""What ``--log-format`` takes."""

WRITE_TIMEOUT_S: Final = 0.2
"""How long a line waits for room."""


def end_unread(kind: type[BaseException] | None, *_: object) -> None:
    """End the process here if it failed and its log is not read: the line with the reason would block."""
    if kind is not None and not takes_more(sys.stderr, WRITE_TIMEOUT_S):
        os._exit(1)


class RunLog:
    """Writes events; may be used from several threads.

    Args:
        stream: Where they go.
        form: One of ``FORMATS``.
        quiet: Leave out all but ``ready``.
        command: Which one says it.
    """

    def __init__(self, stream: TextIO, form: str = "text", *, quiet: bool = False, command: str = "run") -> None:
        self._name = f"eitskin {command}"
        self._form: Literal["text", "json"] = "json" if form == "json" else "text"
        self._quiet = quiet
        self._stream, self._line = stream, StatusLine(stream)
        self._lock = threading.Lock()
        self._journal = goes_to_journal(stream, os.environ)
        self.live = self._line.live and self._form == "text" and not quiet
        """Whether a status is rewritten in place."""

    def say(self, text: str) -> None:
        """Report something that was found or done."""
        if not self._quiet:
            self._put("info", f"{self._name}: {text}", {"text": text})

    def warn(self, text: str) -> None:
        """Report a problem that does not stop the run; written even when quiet."""
        self._put("warning", f"{self._name}: {text}", {"text": text})

    def ready(self, publish: str, control: str) -> None:
        """Report that frames are published from now on."""
        text = f"ready publishing on {publish} control {control}"
        self._put("ready", text, {"publish": publish, "control": control})

    def status(self, text: str, fields: Mapping[str, object]) -> None:
        """Report how the stream is: in place on a terminal, as a line elsewhere."""
        if self.live:
            self._write(self._line.show, text)
        elif not self._quiet:
            self._put("status", f"{self._name}: {text}", fields)

    def failed(self, text: str, stacks: str) -> None:
        """Report why the process ends by itself, and what each of its threads was doing."""
        self._put("error", f"{self._name}: {text}\n{stacks.rstrip()}", {"text": text, "stacks": stacks.splitlines()})

    def event(self, kind: str, text: str, fields: Mapping[str, object]) -> None:
        """Report an event of another log: warnings, errors and ``ready`` also when quiet.

        Args:
            kind: ``info``, ``warning``, ``error``, ``ready`` or ``status``.
            text: For people, in a line.
            fields: The same for programs.
        """
        if not self._quiet or kind in UNQUIETED_EVENTS:
            self._put(kind, text, fields)

    def end(self) -> None:
        """Leave the status where it is."""
        self._write(self._line.end)

    def _put(self, event: str, text: str, fields: Mapping[str, object]) -> None:
        if self._form == "json":
            now = datetime.now(UTC).isoformat(timespec="milliseconds")
            text = json.dumps({"time_utc": now, "event": event, **fields})
        self._write(self._line.above, prefix(event) + text if self._journal else text)

    def _write(self, way: Callable[..., None], *text: str) -> None:
        with self._lock, suppress(OSError):
            if takes_more(self._stream, WRITE_TIMEOUT_S):
                way(*text)
