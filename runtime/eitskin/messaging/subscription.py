"""``for frame in eitskin.subscribe(): frame.map``: frames as they come, newest first or all of them.

``latest`` keeps one frame, the newest, however slow the loop is: a robot that takes 50 ms a frame sees one that is a
frame old, not seconds. ``all`` queues frames for a recorder and counts the gaps when it is too slow even for that.

A subscriber may declare that it needs no unchanged maps; every ``frame.map`` still has one. The runtime saves work if
all its subscribers declare this. Then ``latest`` reads all waiting messages and returns the newest, because libzmq's
own option to keep one message keeps one of all topics.

A subscription to an unused address ends: unless ``timeout_s`` says otherwise, the first frame must come within 5 s.
Later frames may take any time.
"""

from collections.abc import AsyncGenerator
from typing import Any, Final

from eitskin.errors import Closed, StaleFrame
from eitskin.messaging.curve_keys import ClientKeys
from eitskin.messaging.frame import (
    EVERY_FRAME,
    FIRST_BYTE,
    TOUCH_FIRST_BYTE,
    Frame,
    MapMissing,
    patient_topics,
    unpack_frame,
)
from eitskin.messaging.regions import ALWAYS, EVERYWHERE, TOUCHES, UNCHANGED, WHOLE, Region, other_skin
from eitskin.messaging.subscriber import Subscriber
from eitskin_proto.skin.skin import PAPER
from eitskin_proto.skin.skin import Skin as SkinDescription

QUEUE_FRAMES: Final = 2000
"""Frames that wait in mode ``all``: 10 s at 200 frames/s, 12 MB."""


class Subscription(Subscriber[Frame]):
    """An open subscription to a runtime's frames: iterate it, and close it with ``close`` or as a context manager.

    A control loop must notice when frames stop::

        with eitskin.subscribe(maps=False, timeout_s=0.5, max_age_s=0.2) as frames:
            while True:
                try:
                    touches = frames.next_frame().touches
                except (eitskin.NoFrame, eitskin.StaleFrame):
                    ...  # stop the robot; the next call continues as soon as frames come

    One thread may read while any other calls ``stop`` or ``close``; iteration then ends.

    Args:
        endpoint: Where the runtime publishes, ``ipc:///path`` or ``tcp://address:port``; None for the default of
            ``eitskin run``.
        mode: ``latest`` returns the newest frame, for a control loop; ``all`` returns every frame, for a recorder.
        timeout_s: How long to wait for a frame before :class:`eitskin.NoFrame`. None waits 5 s for the first frame and
            without limit for the next ones; ``math.inf`` waits without limit from the start.
        max_age_s: The oldest acceptable frame; an older one raises :class:`eitskin.StaleFrame`.
        region_mm: A rectangle (x0, y0, x1, y1) of the flat sheet; ``frame.map[frames.region.slices]`` are its pixels.
        skin: The runtime's skin description, needed for a region of any but the paper's skin
            (:func:`eitskin_proto.skin.toml.load`).
        skip_unchanged: Accept frames without a map if only noise changed; ``frame.map`` is then the previous map.
        touches: Request the list of touches, ``frame.touches``, in each frame.
        maps: False requests touches without maps, a sixth of the bytes; ``frame.map`` then has shape (0, 0).
        patient: Receive frames after other subscribers, for programs that display or store frames.
        keys: CURVE keys, required for TCP.

    Raises:
        ValueError: A bound is not positive, the mode does not exist, or the region is not on the sheet.
        EndpointError: The endpoint is malformed, needs keys because it is TCP, or has no folder (the default one).
    """

    def __init__(
        self,
        endpoint: str | None = None,
        mode: str = "latest",
        *,
        timeout_s: float | None = None,
        max_age_s: float | None = None,
        region_mm: tuple[float, float, float, float] | None = None,
        skin: SkinDescription | None = None,
        skip_unchanged: bool = False,
        touches: bool = False,
        maps: bool = True,
        patient: bool = False,
        keys: ClientKeys | None = None,
    ) -> None:
        if max_age_s is not None and not max_age_s > 0:
            raise ValueError(f"max_age_s is {max_age_s}, expected more than 0")
        if not maps and (region_mm is not None or skip_unchanged):
            raise ValueError("maps=False receives no maps: leave out region_mm and skip_unchanged")
        grid = (skin or PAPER).grid
        self._grid = None if region_mm is None else grid
        self.region = EVERYWHERE if region_mm is None else Region.from_mm(*region_mm, grid)
        """The requested rectangle, in pixels; ``frame.map[region.slices]``."""
        self._needs_touches, self._skip_unchanged = touches or not maps, skip_unchanged
        first = FIRST_BYTE if maps else TOUCH_FIRST_BYTE
        topics = patient_topics(first) if patient else (first,)
        if maps and (skip_unchanged or touches or patient):  # the frames last, when all that is needed has been said
            needed = (TOUCHES,) if touches else ()
            topics = (WHOLE, UNCHANGED if skip_unchanged else ALWAYS, *needed, *topics)
        elif maps:
            topics = (EVERY_FRAME,)
        self._max_age_s = max_age_s
        self.lost = 0
        """Published frames that this side did not take in time; in mode ``latest`` this is intended."""
        self.mapless = 0
        """Frames dropped because they refer to a map that was not received: just after the start, or after a loss."""
        self.passed_over = 0
        """Frames dropped because they lack the requested touches."""
        self._known: Frame | None = None
        self._run, self._number = "", 0
        super().__init__(
            endpoint, topics, QUEUE_FRAMES, mode=mode, conflate=len(topics) == 1, timeout_s=timeout_s, keys=keys
        )

    def next_frame(self) -> Frame:
        """Wait for the next frame and return it.

        Raises:
            NoFrame: No frame came in time; the text says whether a runtime is there, and what to do.
            StaleFrame: The frame is older than ``max_age_s``.
            MismatchError: A region is requested, and the maps are another skin's.
            Closed: The subscription was stopped or closed.
        """
        return self._next()

    def _wait(self, timeout_s: float | None) -> Frame:
        frame = super()._wait(timeout_s)
        if self._max_age_s is not None and (age_s := frame.age_s) > self._max_age_s:
            raise StaleFrame(f"the newest frame is {age_s:.3f} s old, expected at most {self._max_age_s:g} s")
        return frame

    def _taken(self, message: bytes) -> Frame | None:
        frame = super()._taken(message)
        if frame is not None:
            if frame.run == self._run and frame.number > self._number:
                self.lost += frame.number - self._number - 1
            self._run, self._number = frame.run, frame.number
        return frame

    def _item(self, message: bytes) -> Frame | None:
        if self._newest_only and not self._skip_unchanged and self.waits:
            return None  # a newer one waits
        try:
            frame = unpack_frame(message, self._heard_ns, self._known)
        except MapMissing:
            self.mapless += 1
            return None
        if self._needs_touches and frame.touch_list is None:
            self.passed_over += 1
            return None
        self._known = frame
        if self._grid is not None and frame.map.shape != self._grid.shape:
            raise other_skin(self.endpoint, frame.map.shape, self._grid)
        return frame

    def _why(self, waited_s: float) -> str:
        if self.passed_over and not self.received:
            return f"{self.passed_over} came without touches: the runtime is older than they are"
        return self.silence(waited_s)


subscribe = Subscription
"""Open a :class:`Subscription` with these arguments: ``for frame in eitskin.subscribe(): ...``."""


async def subscribe_async(*args: Any, **options: Any) -> AsyncGenerator[Frame, None]:
    """Yield frames to asyncio: ``async for frame in eitskin.subscribe_async(): ...``.

    A thread waits for the frames, so other tasks run meanwhile. Cancel the task to end it; after a ``break`` use
    ``contextlib.aclosing``, which closes the connection at once. Every other subscription can be awaited the same way:
    ``await asyncio.to_thread(items.next_item)``.

    Args:
        args: As of :class:`Subscription`.
        options: As of :class:`Subscription`.

    Raises:
        SkinError: As :class:`Subscription` and :meth:`Subscription.next_frame` do.
    """
    import asyncio  # noqa: PLC0415 -- it loads more than a subscriber needs

    with Subscription(*args, **options) as frames:
        while True:
            try:
                frame = await asyncio.to_thread(frames.next_frame)
            except Closed:
                return
            yield frame
