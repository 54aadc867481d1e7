"""A page that is served: what is common to one of runtimes and one of a recording."""

import contextlib
import threading
from typing import Any, Self

from eitskin_tools.view.board import Board
from eitskin_tools.view.server import ViewServer


class Served:
    """A page from when it is entered to when it is left, of whatever is posted on its board."""

    def __init__(self) -> None:
        self.board = Board()
        self.stack = contextlib.ExitStack()
        """What ends with it."""

    def serve(self, host: str, port: int, token: str, **more: Any) -> None:
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
        self.stack.close()
        self.server.shutdown()
        self._thread.join()
        self.server.server_close()
