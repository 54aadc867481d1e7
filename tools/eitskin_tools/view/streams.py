"""The surfaces and the state that a runtime tells of on request, handed on to the board from a thread of its own."""

import threading
from contextlib import suppress

import eitskin
from eitskin.errors import NoFrame
from eitskin_tools.view.board import Board
from eitskin_tools.view.messages import state_message, surface_message
from eitskin_tools.view.own_touches import OwnTouches
from eitskin_tools.view.source import Source


class Streams:
    """Follows clouds and state from when it is entered to when it is left.

    Args:
        endpoint: Where the runtime publishes.
        source: Which runtime.
        board: Where to post.
        of: Its number among all skins.
        touches: Lists them, and is told of surfaces too.
    """

    def __init__(self, endpoint: str, source: Source, board: Board, of: int, touches: OwnTouches) -> None:
        self._endpoint, self._source, self._board, self._of, self._touches = endpoint, source, board, of, touches
        self._posted = ("", -1)
        self._left = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"view-streams-{of}", daemon=True)

    def _run(self) -> None:
        while not self._left.is_set():  # a connection that something else had answered is made anew
            with (
                suppress(NoFrame),
                eitskin.subscribe_streams(
                    self._endpoint, wire=False, clouds=True, state=True, timeout_s=2.0, keys=self._source.keys
                ) as items,
            ):
                while not self._left.is_set():
                    self._post(items.next_item())

    def _post(self, item: object) -> None:
        if isinstance(item, eitskin.CloudInUse):
            if self._posted != (which := (item.run, item.revision)):  # it is told again every second
                self._posted = which
                self._touches.use(item.run, item.revision, item.cloud)
                message = surface_message(item.revision, item.cloud, item.run, self._of, self._source.pose)
                self._board.post("surface", message, self._of)
        elif isinstance(item, eitskin.SkinState):
            self._board.post("state", state_message(item, self._of), self._of)

    def __enter__(self) -> None:
        self._thread.start()

    def __exit__(self, *_: object) -> None:
        self._left.set()
        self._thread.join()
