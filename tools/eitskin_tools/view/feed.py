"""The viewer's own subscriber: takes the newest frame, 30 times a second at most, and only while somebody looks on.

Frames in between are dropped by libzmq and never decoded; surfaces and what happened come by streams of their own
(:mod:`eitskin_tools.view.streams`), and touches are listed here (:mod:`eitskin_tools.view.own_touches`): what the frame
loop has to do does not depend on who looks on.
"""

import threading
import time
from collections.abc import Callable
from typing import Any, Final

import eitskin
from eitskin.errors import NoFrame
from eitskin.messaging.curve_keys import ClientKeys
from eitskin_proto.skin.skin import Skin
from eitskin_tools.view.board import Board
from eitskin_tools.view.messages import frame_message, status_message
from eitskin_tools.view.own_touches import OwnTouches
from eitskin_tools.view.streams import Streams

REFRESH_HZ: Final = 30.0
"""Pictures a second at most."""

SILENCE_S: Final = 1.0
"""After so long without a frame the page is told why."""

LINGER_S: Final = 3.0
"""How long to go on when the last page has gone: one that is loaded anew is back at once."""

STATUS_S: Final = 1.0
"""Between two messages that say that all is well."""


class Feed:
    """A thread that posts what a runtime publishes.

    Args:
        endpoint: Where the runtime publishes; None for the default.
        board: Where to post.
        skin: What the maps are expected to be of.
        keys: CURVE keys.
        more: What else the status is to say, asked each second.

    Raises:
        EndpointError: ZeroMQ cannot make sense of the endpoint.
    """

    def __init__(
        self,
        endpoint: str | None,
        board: Board,
        skin: Skin,
        keys: ClientKeys | None = None,
        more: Callable[[], dict[str, Any]] = dict,
    ) -> None:
        self._board, self._skin, self._keys, self._more = board, skin, keys, more
        with eitskin.subscribe(endpoint, keys=keys) as tried:
            self.endpoint = tried.endpoint
        self._left = threading.Event()
        self._thread = threading.Thread(target=self._run, name="view-feed", daemon=True)
        self.taken = 0
        """Frames that pages were given."""

    def start(self) -> None:
        """Begin to look whether somebody looks on."""
        self._thread.start()

    def close(self) -> None:
        """End the thread."""
        self._left.set()
        self._board.close()
        if self._thread.is_alive():
            self._thread.join()

    def _run(self) -> None:
        while not self._left.is_set():
            if self._board.wait_for_pages(1.0):
                self._follow()

    def _follow(self) -> None:
        """Post frames until nobody looks on."""
        touches = OwnTouches(self._skin.grid)
        with (
            eitskin.subscribe(self.endpoint, timeout_s=SILENCE_S, keys=self._keys) as frames,
            Streams(self.endpoint, self._board, self._keys, touches),
        ):
            status_s, seen_s = 0.0, time.monotonic()
            while not self._left.is_set():
                due_s = time.monotonic() + 1.0 / REFRESH_HZ
                try:
                    frame = touches.listed(frames.next_frame())
                except NoFrame as error:
                    self._say("silent", str(error))
                else:
                    self._board.post("frame", frame_message(frame))
                    self.taken += 1
                    if due_s - status_s >= STATUS_S:
                        status_s = due_s
                        self._say("live", self._mismatch(frame.map.shape))
                now_s = time.monotonic()
                if self._board.pages:
                    seen_s = now_s
                elif now_s - seen_s > LINGER_S:
                    return
                self._left.wait(max(0.0, due_s - now_s))

    def _mismatch(self, shape: tuple[int, ...]) -> str:
        """Return what is wrong with the sheet that is drawn; nothing if nothing is."""
        if shape == self._skin.grid.shape:
            return ""
        rows, columns = self._skin.grid.shape
        return (
            f"the map has {shape[0]} x {shape[1]} pixels, expected {rows} x {columns} of skin {self._skin.name!r}: "
            "millimetres are wrong; name the runtime's skin with 'eitskin view --skin FILE'"
        )

    def _say(self, state: str, text: str) -> None:
        self._board.post("status", status_message(state, text, **self._more()))
