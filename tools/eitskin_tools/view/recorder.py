"""The record button: ``eitskin record`` as a process of its own, started and ended for the page."""

import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from eitskin_proto.errors import SkinError
from eitskin_tools.processes.children import Child


class Recorder:
    """Starts and ends recordings of one runtime; a context.

    Args:
        endpoint: Where the runtime publishes.
        folder: Where recordings go; None if nothing is to be recorded.
        options: Of ``eitskin record``, besides.
    """

    def __init__(self, endpoint: str, folder: Path | None, options: tuple[str, ...] = ()) -> None:
        self._endpoint, self._folder, self._options = endpoint, folder, options
        self._child: Child | None = None
        self._file = ""
        self._said = ""
        self._closed = False
        # One thread for all of them: the kernel ends a process together with the thread that started it.
        self._starter = ThreadPoolExecutor(1, "view-recorder")
        self._logs = tempfile.TemporaryDirectory(prefix="eitskin-view-")

    def start(self) -> str:
        """Begin; return "" or why not."""
        return str(self._starter.submit(self._start).result())

    def stop(self) -> str:
        """End; return "" or why not."""
        return str(self._starter.submit(self._stop).result())

    def about(self) -> dict[str, Any]:
        """Return what the page is told: whether there can be recordings, which one is made, and what went wrong."""
        child = self._child
        if child is not None and child.status is not None:
            self._child, self._said = None, f"the recording ended: {child.last_words()}"
        on = self._child is not None
        return {"can_record": self._folder is not None, "recording": self._file if on else "", "recorder": self._said}

    def _start(self) -> str:
        if self._folder is None:
            return "this viewer cannot record"
        if self._child is not None and self._child.status is None:
            return f"{self._file} is being recorded already"
        path = self._folder / time.strftime("eitskin-%Y%m%d-%H%M%S.mcap")
        words = ["record", self._endpoint, "--out", str(path), "--quiet", *self._options]
        try:
            self._child = Child("record", "eitskin_tools.cli", words, Path(self._logs.name))
        except (OSError, SkinError) as error:
            return f"the recording cannot be started: {error}"
        self._file, self._said = path.name, ""
        return ""

    def _stop(self) -> str:
        child, self._child = self._child, None
        if child is None:
            return "nothing is being recorded"
        child.stop()
        return "" if child.status == 0 else f"the recording ended: {child.last_words()}"

    def close(self) -> None:
        """End what is being recorded; closing twice is fine."""
        if self._closed:
            return
        self._closed = True
        self.stop()
        self._starter.shutdown()
        self._logs.cleanup()
