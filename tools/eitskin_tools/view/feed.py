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
from eitskin_tools.processes.rhythm import Rhythm
from eitskin_tools.view.board import Board
from eitskin_tools.view.messages import frame_message, status_message
from eitskin_tools.view.own_touches import OwnTouches
from eitskin_tools.view.source import Source
from eitskin_tools.view.streams import Streams

REFRESH_HZ: Final = 30.0
"""Pictures a second of a skin, at most."""

TOGETHER_HZ: Final = 120.0
"""Of all skins together: a page has to take them in."""

SILENCE_S: Final = 1.0
"""After so long without a frame the page is told why."""

LINGER_S: Final = 3.0
"""How long to go on when the last page has gone: one that is loaded anew is back at once."""

STATUS_S: Final = 1.0
"""Between two messages that say that all is well."""


def refresh_hz(skins: int) -> float:
    """Return how many pictures a second each of so many skins may have."""
    return min(REFRESH_HZ, TOGETHER_HZ / skins)


class Feed:
    """A thread that posts what a runtime publishes.

    Args:
        source: Which.
        board: Where to post.
        of: Its number among all skins.
        refresh_hz: Pictures a second at most.
        more: What else the status is to say, asked each second.

    Raises:
        EndpointError: ZeroMQ cannot make sense of the endpoint.
    """

    def __init__(
        self,
        source: Source,
        board: Board,
        of: int = 0,
        refresh_hz: float = REFRESH_HZ,
        more: Callable[[], dict[str, Any]] = dict,
    ) -> None:
        self._source, self._board, self._of, self._every_s, self._more = source, board, of, 1.0 / refresh_hz, more
        with eitskin.subscribe(source.endpoint, keys=source.keys) as tried:
            self.endpoint = tried.endpoint
        self._left = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"view-feed-{of}", daemon=True)
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
        touches = OwnTouches(self._source.skin.grid)
        with (
            eitskin.subscribe(self.endpoint, timeout_s=SILENCE_S, patient=True, keys=self._source.keys) as frames,
            Streams(self.endpoint, self._source, self._board, self._of, touches),
        ):
            status_s, rhythm = 0.0, Rhythm()
            due_s = seen_s = time.monotonic()
            while not self._left.is_set():
                due_s = max(due_s + self._every_s, time.monotonic())
                try:
                    frame = touches.listed(frames.next_frame())
                except NoFrame as error:
                    self._say("silent", str(error))
                else:
                    rhythm.heard(frame.number, frame.host_ns["read"])
                    self._board.post("frame", frame_message(frame, self._of, self._source.pose), self._of)
                    self.taken += 1
                    if due_s - status_s >= STATUS_S:
                        status_s = due_s
                        self._say("live", self._mismatch(frame.map.shape))
                now_s = time.monotonic()
                if self._board.pages:
                    seen_s = now_s
                elif now_s - seen_s > LINGER_S:
                    return
                self._left.wait(rhythm.rest_s(max(0.0, due_s - now_s)))

    def _mismatch(self, shape: tuple[int, ...]) -> str:
        """Return what is wrong with the sheet that is drawn; nothing if nothing is."""
        skin = self._source.skin
        if shape == skin.grid.shape:
            return ""
        rows, columns = skin.grid.shape
        return (
            f"the map has {shape[0]} x {shape[1]} pixels, expected {rows} x {columns} of skin {skin.name!r}: "
            "millimetres are wrong; name the runtime's skin with 'eitskin view --skin FILE'"
        )

    def _say(self, state: str, text: str) -> None:
        self._board.post("status", status_message(state, text, self._of, **self._more()), self._of)
