"""A page that shows the place to press next, for a screen beside the sheet."""

import threading
from collections.abc import Sequence
from typing import Final, Self

from eitskin_tools.teach.places import Place, draw_grid
from eitskin_tools.view.board import Board
from eitskin_tools.view.server import TYPES, ViewServer

PICTURE: Final = "/place.svg"

HTML: Final = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta http-equiv="refresh" content="1"><title>eitskin teach</title></head>
<body><img src="place.svg" alt="the sheet, with the next place to press in red"></body></html>
"""


class GuidePage:
    """Serves the picture of the next place on this machine; a context.

    Args:
        port: 0 for any that is free.
        size_mm: Of the sheet.
        outline: ``rectangle`` or ``disc``.
        places: All places.

    Raises:
        PortUnavailable: The address cannot be bound.
    """

    def __init__(self, port: int, size_mm: tuple[float, float], outline: str, places: Sequence[Place]) -> None:
        self._sheet = size_mm, outline
        self._places = places
        self._server = ViewServer("127.0.0.1", port, Board())
        self._server.pages = {"/": (TYPES["html"], HTML.encode())}
        self._thread = threading.Thread(target=self._server.serve_forever, name="teach-page", daemon=True)
        self.address = self._server.address
        """The address to open in a browser."""
        self.show(None, ())

    def show(self, following: Place | None, left: Sequence[Place]) -> None:
        """Mark the place to press next, and those that were pressed.

        Args:
            following: The next one; None once all are done.
            left: Places without a press.
        """
        done = [place for place in self._places if place not in left]
        picture = draw_grid(*self._sheet, self._places, done, following)
        self._server.pages[PICTURE] = TYPES["svg"], picture.encode()

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()
