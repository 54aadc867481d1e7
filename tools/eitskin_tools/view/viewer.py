"""Everything that ``eitskin view`` runs, as one context: what it looks at, the server, and what they share."""

import contextlib
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Self

from eitskin.robot.pose import Pose
from eitskin_tools.view.board import Board
from eitskin_tools.view.feed import Feed, refresh_hz
from eitskin_tools.view.film.overview import Overlooking, Overview
from eitskin_tools.view.film.parts import PART_S, Film
from eitskin_tools.view.messages import skin_message, status_message
from eitskin_tools.view.recorder import Recorder
from eitskin_tools.view.server import ViewServer
from eitskin_tools.view.source import Source


class _Served:
    """A page from when it is entered to when it is left, of whatever is posted on its board."""

    def __init__(self) -> None:
        self.board = Board()
        self._stack = contextlib.ExitStack()

    def _serve(self, host: str, port: int, token: str, **more: Any) -> None:
        """Bind the address.

        Raises:
            PortTaken: It cannot be bound.
            ValueError: It can be reached from other machines, and there is no token.
        """
        self.server = ViewServer(host, port, self.board, token, **more)
        self.address = self.server.address
        """What to type into a browser."""
        self._thread = threading.Thread(target=self.server.serve_forever, name="view-server", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self.board.closed:
            return
        self.board.close()
        self._stack.close()
        self.server.shutdown()
        self._thread.join()
        self.server.server_close()


class Viewer(_Served):
    """Serves the page of one runtime or of several.

    Args:
        sources: The skins.
        host: Address to serve on.
        port: 0 for any that is free.
        token: What a page must know; empty only on loopback.
        recordings: Folder for what the page has recorded; None if it is not to record.

    Raises:
        PortTaken: The address cannot be bound.
        EndpointError: ZeroMQ cannot make sense of an endpoint.
        ValueError: The address can be reached from other machines, and there is no token.
    """

    def __init__(
        self,
        sources: Sequence[Source],
        *,
        host: str = "127.0.0.1",
        port: int = 0,
        token: str = "",
        recordings: Path | None = None,
    ) -> None:
        super().__init__()
        rate_hz = refresh_hz(len(sources))
        self.feeds = [Feed(one, self.board, of, rate_hz, self._about) for of, one in enumerate(sources)]
        for of, (one, feed) in enumerate(zip(sources, self.feeds, strict=True)):
            about = {"name": one.name, "skins": len(sources), "endpoint": feed.endpoint}
            self.board.post("skin", skin_message(one.skin, of, one.pose, about), of)
        self._recorder = Recorder([feed.endpoint for feed in self.feeds], sources, recordings)
        self._stack.callback(self._recorder.close)
        for feed in self.feeds:
            self._stack.callback(feed.close)
        try:
            self._serve(host, port, token, recorder=self._recorder)
        except BaseException:
            self._recorder.close()
            raise

    def _about(self) -> dict[str, Any]:
        return self._recorder.about()

    def __enter__(self) -> Self:
        for feed in self.feeds:
            feed.start()
        return super().__enter__()


class Projector(_Served):
    """Serves the page of a recording.

    Args:
        film: The recording.
        host: Address to serve on.
        port: 0 for any that is free.
        token: What a page must know; empty only on loopback.

    Raises:
        PortTaken: The address cannot be bound.
        ValueError: It can be reached from other machines, and there is no token.
    """

    def __init__(self, film: Film, *, host: str = "127.0.0.1", port: int = 0, token: str = "") -> None:
        super().__init__()
        self._film = film
        about = {
            "name": "", "skins": 1, "file": film.path.name, "seconds": film.seconds, "parts": film.parts,
            "part_s": PART_S, "begin_ms": film.first_ns / 1e6,
        }  # fmt: skip
        self.board.post("skin", skin_message(film.skin, 0, Pose(), about))
        self.board.post("status", status_message("live", film.ending))
        self._serve(host, port, token, film=film)

    def __enter__(self) -> Self:
        overview = Overview(self._film.seconds, self._film.first_ns)
        self._stack.enter_context(
            Overlooking(self._film.path, overview, lambda message: self.board.post("overview", message))
        )
        return super().__enter__()
