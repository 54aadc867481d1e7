"""The viewer's own subscriber: takes the newest frame, 30 times a second at most, and only while a page is open.

libzmq drops the frames in between, which are never decoded. Surfaces and events come by streams of their own, and
touches are listed here, so that a page gives the frame loop no work.
"""

import math
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt

import eitskin
from eitskin.errors import Closed, NoFrame
from eitskin.messaging.frame import Frame
from eitskin.touches.surface import Surface
from eitskin.touches.touch import LAYOUT, unpack_touches
from eitskin.touches.watch import TouchWatch
from eitskin_proto.skin.grid import Grid
from eitskin_tools.processes.rhythm import Rhythm
from eitskin_tools.view.board import Board
from eitskin_tools.view.messages import frame_message, state_message, status_message, surface_message
from eitskin_tools.view.source import Source

REFRESH_HZ: Final = 30.0
"""Highest rate of frames to pages, for one skin."""

MAX_TOTAL_HZ: Final = 120.0
"""Highest rate of all skins together, as a page has to draw them."""

SILENCE_S: Final = 1.0
"""After this time without a frame the page says why."""

IDLE_S: Final = 3.0
"""How long to continue after the last page closed: a page that reloads is back at once."""

STATUS_S: Final = 1.0
"""Between two status messages while frames arrive."""


def refresh_hz(skins: int) -> float:
    """Return the highest rate of frames for each of some skins."""
    return min(REFRESH_HZ, MAX_TOTAL_HZ / skins)


class Feed:
    """A thread that posts the frames of a runtime.

    Args:
        source: The runtime.
        board: Where to post.
        of: Number of the skin.
        refresh_hz: Highest rate of frames.
        more: Returns more fields of the status; called each second.

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
        self._subscribed: tuple[Any, ...] = ()
        self._thread = threading.Thread(target=self._run, name=f"view-feed-{of}", daemon=True)
        self.taken = 0
        """Frames posted so far."""

    def start(self) -> None:
        """Start; frames are posted once a page is open."""
        self._thread.start()

    def stop(self) -> None:
        """Have the thread end within 0.1 s."""
        self._left.set()
        self._board.close()
        for one in self._subscribed:
            one.stop()

    def close(self) -> None:
        """End the thread."""
        self.stop()
        if self._thread.is_alive():
            self._thread.join()

    def _run(self) -> None:
        while not self._left.is_set():
            if self._board.wait_for_pages(1.0):
                self._follow()

    def _follow(self) -> None:
        """Post frames and streams until no page is open."""
        touches, keys = TouchLister(self._source.skin.grid), self._source.keys
        with (
            eitskin.subscribe(self.endpoint, timeout_s=SILENCE_S, patient=True, keys=keys) as frames,
            eitskin.subscribe_streams(
                self.endpoint, wire=False, clouds=True, state=True, timeout_s=math.inf, keys=keys
            ) as items,
        ):
            self._subscribed = (frames, items)
            streams = threading.Thread(target=self._post_streams, args=(items, touches), daemon=True)
            streams.start()
            try:
                self._post_frames(frames, touches)
            except Closed:
                pass
            finally:
                items.stop()
                streams.join()

    def _post_frames(self, frames: Any, touches: "TouchLister") -> None:
        status_s, rhythm = 0.0, Rhythm()
        due_s = seen_s = time.monotonic()
        while not self._left.is_set():
            due_s = max(due_s + self._every_s, time.monotonic())
            try:
                frame = touches.listed(frames.next_frame())
            except NoFrame as error:
                self._post_status("silent", str(error))
            else:
                rhythm.add(frame.number, frame.host_ns["read"])
                self._board.post("frame", frame_message(frame, self._of, self._source.pose), self._of)
                self.taken += 1
                if due_s - status_s >= STATUS_S:
                    status_s = due_s
                    self._post_status("live", self._mismatch(frame.map.shape))
            now_s = time.monotonic()
            if self._board.pages:
                seen_s = now_s
            elif now_s - seen_s > IDLE_S:
                return
            self._left.wait(rhythm.pause_s(max(0.0, due_s - now_s)))

    def _post_streams(self, items: Any, touches: "TouchLister") -> None:
        """Post clouds and states until the subscription is stopped."""
        posted = None
        for item in items:
            if isinstance(item, eitskin.SkinState):
                self._board.post("state", state_message(item, self._of), self._of)
            elif posted != (which := (item.run, item.revision)):  # a cloud is sent again every second
                posted = which
                touches.set_surface(item.run, item.revision, item.cloud)
                message = surface_message(item.revision, item.cloud, item.run, self._of, self._source.pose)
                self._board.post("surface", message, self._of)

    def _mismatch(self, shape: tuple[int, ...]) -> str:
        """Return how the map differs from the sheet that is drawn, or ""."""
        skin = self._source.skin
        if shape == skin.grid.shape:
            return ""
        rows, columns = skin.grid.shape
        return (
            f"the map has {shape[0]} x {shape[1]} pixels, expected {rows} x {columns} of skin {skin.name!r}: "
            "positions in mm are wrong; name the runtime's skin with 'eitskin view --skin FILE'"
        )

    def _post_status(self, state: str, text: str) -> None:
        self._board.post("status", status_message(state, text, self._of, **self._more()), self._of)


UNKNOWN_NORMAL: Final = (0.0, 0.0, 0.0)
"""The normal of a touch whose surface is not known yet: the page puts it on the surface that it draws."""


class TouchLister:
    """Lists the touches of one frame after another.

    Args:
        grid: Of the skin; frames with other maps do not change.
    """

    def __init__(self, grid: Grid) -> None:
        self._grid, self._watch = grid, TouchWatch(grid)
        self._flat = Surface(grid.flat_cloud_mm(), grid)
        self._surfaces: dict[tuple[str, int], Surface] = {}
        self._run = ""

    def set_surface(self, run: str, revision: int, cloud_mm: npt.NDArray[np.floating]) -> None:
        """Place touches on a surface if their frame was computed with it; may be called from another thread.

        Args:
            run: Of the runtime.
            revision: As frames name it in ``cloud``.
            cloud_mm: (3, rows, columns) mm.
        """
        if cloud_mm.shape[1:] == self._grid.shape:
            self._surfaces = {(run, revision): Surface(cloud_mm, self._grid)}

    def listed(self, frame: Frame) -> Frame:
        """Return a frame with its own touches or, if it has none, with those found here."""
        if frame.touch_list is not None or frame.map.shape != self._grid.shape or frame.run != self._run:
            self._watch.reset()
            self._run = frame.run
        if frame.touch_list is not None or frame.map.shape != self._grid.shape:
            return frame
        known = self._surfaces.get((frame.run, frame.cloud))
        surface = known or self._flat
        values = frame.map.reshape(-1) if frame.map.any() else None
        which = frame.solver, frame.map_sequence
        raw, events, more = self._watch.update(values, which, surface, frame.device_us, frame.fused)
        found = unpack_touches(raw, LAYOUT.size, events, more)
        if known is None and frame.cloud:
            found = replace(found, touches=tuple(replace(one, normal=UNKNOWN_NORMAL) for one in found.touches))
        return replace(frame, touch_list=found)
