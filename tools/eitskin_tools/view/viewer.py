"""What ``eitskin view`` runs for live skins, as one context: feeds, recorder and server."""

import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Self

from eitskin_proto.errors import SkinError
from eitskin_tools.processes.children import Child
from eitskin_tools.view.feed import Feed, refresh_hz
from eitskin_tools.view.messages import skin_message
from eitskin_tools.view.server import PageServer
from eitskin_tools.view.source import Source


class Viewer(PageServer):
    """Serves the page of one runtime or of several.

    Args:
        sources: The skins.
        host: Address to serve on.
        port: 0 for any that is free.
        recordings: Folder for recordings started on the page; None if the page cannot record.
        allowed: Further host names that a request may state.

    Raises:
        PortUnavailable: The address cannot be bound.
        EndpointError: ZeroMQ cannot make sense of an endpoint.
    """

    def __init__(
        self,
        sources: Sequence[Source],
        *,
        host: str = "127.0.0.1",
        port: int = 0,
        recordings: Path | None = None,
        allowed: Sequence[str] = (),
    ) -> None:
        super().__init__()
        rate_hz = refresh_hz(len(sources))
        self.feeds = [Feed(one, self.board, of, rate_hz, self._about) for of, one in enumerate(sources)]
        for of, (one, feed) in enumerate(zip(sources, self.feeds, strict=True)):
            about = {"name": one.name, "skins": len(sources), "endpoint": feed.endpoint}
            self.board.post("skin", skin_message(one.skin, of, one.pose, about), of)
        self._recorder = Recorder([feed.endpoint for feed in self.feeds], sources, recordings)
        self.stack.callback(self._recorder.close)
        for feed in self.feeds:
            self.stack.callback(feed.close)
        for feed in self.feeds:
            self.stack.callback(feed.stop)  # all at once, before the first is waited for
        try:
            self.serve(host, port, allowed, recorder=self._recorder)
        except BaseException:
            self._recorder.close()
            raise

    def _about(self) -> dict[str, Any]:
        return self._recorder.about()

    def __enter__(self) -> Self:
        for feed in self.feeds:
            feed.start()
        return super().__enter__()


class Recorder:
    """Starts and stops recordings of all skins on the page; a context.

    Args:
        endpoints: Where each skin's runtime publishes.
        sources: The skins.
        folder: Where recordings go; None if the page cannot record.
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
        """Start, and return "" or why not."""
        return str(self._starter.submit(self._start).result())

    def stop(self) -> str:
        """Stop, and return "" or why not."""
        return str(self._starter.submit(self._stop).result())

    def about(self) -> dict[str, Any]:
        """Return for the page whether it can record, what it records, and what went wrong."""
        running = self._children
        if ended := [file for file, child in running.items() if child.status is not None]:
            self._said = "; ".join(f"{file} ended: {running[file].last_words()}" for file in ended)
            self._children = {file: child for file, child in running.items() if file not in ended}
        recording = ", ".join(self._children)
        return {"can_record": self._folder is not None, "recording": recording, "recorder": self._said}

    def _start(self) -> str:
        if self._folder is None:
            return "this viewer cannot record: its folder cannot be written"
        if any(child.status is None for child in self._children.values()):
            return f"already recording {', '.join(self._children)}"
        stamp, made = time.strftime("eitskin-%Y%m%d-%H%M%S"), dict[str, Child]()
        try:
            for endpoint, source in self._skins:
                file = f"{stamp}{f'-{source.name}' if source.name else ''}.mcap"
                words = ["record", endpoint, "--out", str(self._folder / file), "--quiet", *source.record_options]
                made[file] = Child(file, "eitskin_tools.cli", words, Path(self._logs.name))
        except (OSError, SkinError) as error:
            for child in made.values():
                child.stop()
            return f"the recording could not start: {error}"
        self._children, self._said = made, ""
        return ""

    def _stop(self) -> str:
        children, self._children = self._children, {}
        if not children:
            return "no recording is running"
        for child in children.values():
            child.stop()
        return "; ".join(f"{file} ended: {one.last_words()}" for file, one in children.items() if one.status != 0)

    def close(self) -> None:
        """Stop all recordings; closing twice is fine."""
        if self._closed:
            return
        self._closed = True
        self.stop()
        self._starter.shutdown()
        self._logs.cleanup()
