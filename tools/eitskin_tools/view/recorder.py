"""The record button: ``eitskin record`` as a process of its own for each skin, started and ended for the page."""

import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from eitskin_proto.errors import SkinError
from eitskin_tools.processes.children import Child
from eitskin_tools.view.source import Source


class Recorder:
    """Starts and ends recordings of all skins that are looked at; a context.

    Args:
        endpoints: Where each skin's runtime publishes.
        sources: The skins.
        folder: Where recordings go; None if nothing is to be recorded.
    """

    def __init__(self, endpoints: Sequence[str], sources: Sequence[Source], folder: Path | None) -> None:
        self._skins = list(zip(endpoints, sources, strict=True))
        self._folder = folder
        self._children: dict[str, Child] = {}
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
        """Return what the page is told: whether there can be recordings, which are made, and what went wrong."""
        running = self._children
        if ended := [file for file, child in running.items() if child.status is not None]:
            self._said = "; ".join(f"{file} ended: {running[file].last_words()}" for file in ended)
            self._children = {file: child for file, child in running.items() if file not in ended}
        recording = ", ".join(self._children)
        return {"can_record": self._folder is not None, "recording": recording, "recorder": self._said}

    def _start(self) -> str:
        if self._folder is None:
            return "this viewer cannot record"
        if any(child.status is None for child in self._children.values()):
            return f"{', '.join(self._children)} is being recorded already"
        stamp, made = time.strftime("eitskin-%Y%m%d-%H%M%S"), dict[str, Child]()
        try:
            for endpoint, source in self._skins:
                file = f"{stamp}{f'-{source.name}' if source.name else ''}.mcap"
                words = ["record", endpoint, "--out", str(self._folder / file), "--quiet", *source.record_options]
                made[file] = Child(file, "eitskin_tools.cli", words, Path(self._logs.name))
        except (OSError, SkinError) as error:
            for child in made.values():
                child.stop()
            return f"the recording cannot be started: {error}"
        self._children, self._said = made, ""
        return ""

    def _stop(self) -> str:
        children, self._children = self._children, {}
        if not children:
            return "nothing is being recorded"
        for child in children.values():
            child.stop()
        return "; ".join(f"{file} ended: {one.last_words()}" for file, one in children.items() if one.status != 0)

    def close(self) -> None:
        """End what is being recorded; closing twice is fine."""
        if self._closed:
            return
        self._closed = True
        self.stop()
        self._starter.shutdown()
        self._logs.cleanup()
