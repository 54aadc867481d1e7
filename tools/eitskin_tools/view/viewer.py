"""Everything that ``eitskin view`` runs in front of runtimes, as one context: feeds, recorder and server."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Self

from eitskin_tools.view.feed import Feed, refresh_hz
from eitskin_tools.view.messages import skin_message
from eitskin_tools.view.recorder import Recorder
from eitskin_tools.view.served import Served
from eitskin_tools.view.source import Source


class Viewer(Served):
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
        self.stack.callback(self._recorder.close)
        for feed in self.feeds:
            self.stack.callback(feed.close)
        try:
            self.serve(host, port, token, recorder=self._recorder)
        except BaseException:
            self._recorder.close()
            raise

    def _about(self) -> dict[str, Any]:
        return self._recorder.about()

    def __enter__(self) -> Self:
        for feed in self.feeds:
            feed.start()
        return super().__enter__()
