"""Everything that ``eitskin view`` runs, as one context: the feed, the server, and what they share."""

import threading
from pathlib import Path
from typing import Any, Self

from eitskin.messaging.curve_keys import ClientKeys
from eitskin_proto.skin.skin import Skin
from eitskin_tools.pictures.draw import palette
from eitskin_tools.view.board import Board
from eitskin_tools.view.feed import REFRESH_HZ, Feed
from eitskin_tools.view.messages import skin_message
from eitskin_tools.view.recorder import Recorder
from eitskin_tools.view.server import ViewServer


class Viewer:
    """Serves a runtime's page from when it is entered to when it is left.

    Args:
        endpoint: Where the runtime publishes; None for the default.
        skin: The runtime's.
        host: Address to serve on.
        port: 0 for any that is free.
        token: What a page must know; empty only on loopback.
        keys: CURVE keys.
        recordings: Folder for what the page has recorded; None if it is not to record.
        record_options: Of ``eitskin record``, besides.
        file: Name of the recording that is played; empty for a skin.

    Raises:
        PortTaken: The address cannot be bound.
        EndpointError: ZeroMQ cannot make sense of the endpoint.
        ValueError: The address can be reached from other machines, and there is no token.
    """

    def __init__(
        self,
        endpoint: str | None,
        skin: Skin,
        *,
        host: str = "127.0.0.1",
        port: int = 0,
        token: str = "",
        keys: ClientKeys | None = None,
        recordings: Path | None = None,
        record_options: tuple[str, ...] = (),
        file: str = "",
    ) -> None:
        self.board = Board()
        self.feed = Feed(endpoint, self.board, skin, keys, self._about)
        self.endpoint = self.feed.endpoint
        about: dict[str, Any] = {"refresh_hz": REFRESH_HZ, "endpoint": self.endpoint, "file": file}
        self.board.post("skin", skin_message(skin, palette(), about))
        self._recorder = Recorder(self.endpoint, recordings, record_options)
        try:
            self.server = ViewServer(host, port, self.board, token, self._recorder)
        except BaseException:
            self._recorder.close()
            raise
        self.address = self.server.address
        """What to type into a browser."""
        self._thread = threading.Thread(target=self.server.serve_forever, name="view-server", daemon=True)

    def _about(self) -> dict[str, Any]:
        return self._recorder.about()

    def __enter__(self) -> Self:
        self.feed.start()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.feed.close()
        self.server.shutdown()
        self._thread.join()
        self.server.server_close()
        self._recorder.close()
