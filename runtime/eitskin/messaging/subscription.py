"""``for frame in eitskin.subscribe(): frame.map``: frames as they come, newest first or all of them.

``latest`` keeps one frame, the newest, however slow the loop is: a robot that takes 50 ms a frame sees one that is a
frame old, not seconds. ``all`` queues frames for a recorder and counts the gaps when it is too slow even for that.

A subscriber may say that it does without maps that have not changed; it still finds one in every ``frame.map``. The
runtime does less if all its subscribers say so. Then ``latest`` reads all that waits and
returns the newest: libzmq's own way of keeping one message would keep only one of the topics as well.

Nobody waits for ever on an address where nobody is: unless told otherwise, the first frame must come within
``FIRST_FRAME_S``. Once one has come, the next may take as long as it likes.
"""

import math
import time
from typing import Final, Self

import zmq

from eitskin.errors import FrameError, NoFrame, StaleFrame
from eitskin.messaging.curve_keys import ClientKeys
from eitskin.messaging.endpoints import default_publish
from eitskin.messaging.frame import Frame, MapMissing
from eitskin.messaging.received.subscriber import LONGEST_WAIT_MS, Subscriber
from eitskin.messaging.received.wishes import NotAsked, Wishes
from eitskin.messaging.regions import other_skin
from eitskin_proto.skin.skin import Skin as SkinDescription

MODES: Final = ("latest", "all")

QUEUE_FRAMES: Final = 2000
"""Frames that wait in mode ``all``: 10 s at 200 frames/s, 12 MB."""

FIRST_FRAME_S: Final = 5.0
"""How long the first frame may take where no time was named; a runtime that is there sends one within 0.1 s."""


class Subscription(Subscriber):
    """An open subscription: iterate it, or call ``next_frame``; leave it with ``close`` or as a context manager.

    Args:
        endpoint: Where the runtime publishes; None takes the one of ``eitskin run``.
        mode: ``latest`` or ``all``.
        timeout_s: How long to wait for a frame; None waits 5 s for the first and then for ever; ``math.inf`` waits for
            ever from the start.
        max_age_s: Oldest frame that is good enough; None takes any.
        region_mm: A rectangle (x0, y0, x1, y1) of the flat sheet, whose pixels are ``region``.
        skin: The runtime's, for ``region_mm``; None for the paper's.
        skip_unchanged: Do without maps that have not changed; ``frame.map`` is then the one from before.
        touches: Each frame has its list of touches; ``maps=False`` for these alone, a sixth of the bytes.
        patient: Be served after the others.
        keys: CURVE keys, which TCP needs.

    Raises:
        ValueError: A bound is not positive, the mode does not exist, or the region is not on the sheet.
        EndpointError: ZeroMQ cannot make sense of the endpoint, or there is no folder for the default one.
    """

    def __init__(
        self,
        endpoint: str | None = None,
        *,
        mode: str = "latest",
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
        if mode not in MODES:
            raise ValueError(f"mode {mode!r} does not exist; expected one of {', '.join(MODES)}")
        for name, value in (("timeout_s", timeout_s), ("max_age_s", max_age_s)):
            if value is not None and not value > 0:
                raise ValueError(f"{name} is {value}, expected more than 0")
        self._wishes = wishes = Wishes.of(
            region_mm, skin, skip_unchanged=skip_unchanged, touches=touches, maps=maps, patient=patient
        )
        self.region = wishes.region
        """What this side needs, in pixels; ``frame.map[region.slices]``."""
        self._timeout_ms = _milliseconds(math.inf if timeout_s is None else timeout_s)
        self._first_ms = _milliseconds(FIRST_FRAME_S) if timeout_s is None else self._timeout_ms
        self._waits_ms = -1
        """What the socket waits at most, as it was told last. It waits by itself: a ``poll`` would delay frames."""
        self._max_age_s = max_age_s
        self.received = 0
        """Frames taken so far."""
        self.lost = 0
        """Frames published but not taken, because this side was too slow; in mode ``latest`` that is intended."""
        self.mapless = 0
        """Frames without a map whose map had not come either: just after the start, or after a loss."""
        self.passed_over = 0
        """Frames without the touches that were asked for."""
        self._known: Frame | None = None
        self._newest_only = mode == "latest" and len(wishes.topics) > 1
        self._run = ""
        self._number = 0
        super().__init__(
            default_publish() if endpoint is None else endpoint, wishes.topics, QUEUE_FRAMES,
            newest=mode == "latest" and not self._newest_only, keys=keys,
        )  # fmt: skip

    def next_frame(self) -> Frame:
        """Return the next frame, waiting for it.

        Raises:
            NoFrame: None came in time; the text says whether anybody is there, and what to do.
            StaleFrame: One came, but it is older than ``max_age_s``.
            MismatchError: A region is needed, and the maps are another skin's.
        """
        timeout_ms = self._timeout_ms if self.received else self._first_ms
        deadline_ns = time.perf_counter_ns() + timeout_ms * 1_000_000
        left_ms = timeout_ms
        while True:
            waits_ms = LONGEST_WAIT_MS if left_ms < 0 else min(left_ms, LONGEST_WAIT_MS)
            if waits_ms != self._waits_ms:
                self._waits_ms = waits_ms
                self._socket.setsockopt(zmq.RCVTIMEO, waits_ms)
            try:
                frame = self._take()
            except zmq.Again:
                self._look_at_connection()
                if left_ms == waits_ms:
                    why = f"{self.passed_over} came without touches: the runtime is older than they are"
                    if self.received or not self.passed_over:
                        why = self.silence(timeout_ms / 1000)
                    raise NoFrame(f"no frame from {self.endpoint} within {timeout_ms / 1000:g} s: {why}") from None
                frame = None
            if frame is None:
                if left_ms >= 0:
                    left_ms = max(0, (deadline_ns - time.perf_counter_ns()) // 1_000_000)
                continue
            age_s = frame.age_s
            if self._max_age_s is not None and age_s > self._max_age_s:
                raise StaleFrame(f"the newest frame is {age_s:.3f} s old, expected at most {self._max_age_s:g} s")
            return frame

    def _take(self) -> Frame | None:
        """Return the frame of the next message, or of the newest one that waits; None if there is none in it."""
        frame = None
        while True:
            message = self._recv()
            if self._newest_only and not self._wishes.each and self.waits:
                continue
            try:
                frame = self._wishes.frame(message, self._heard_ns, self._known)
            except MapMissing:
                self.mapless += 1
            except NotAsked:
                self.passed_over += 1
            except FrameError as error:
                self._reject(error)
            else:
                self._known, self._unusable = frame, (0, "")
                if (grid := self._wishes.grid) is not None and frame.map.shape != grid.shape:
                    raise other_skin(self.endpoint, frame.map.shape, grid)
            if not self._newest_only or not self.waits:
                if frame is not None:
                    self._count(frame)
                return frame

    def _count(self, frame: Frame) -> None:
        if frame.run == self._run and frame.number > self._number:
            self.lost += frame.number - self._number - 1
        self._run, self._number = frame.run, frame.number
        self.received += 1

    __next__ = next_frame

    def __iter__(self) -> Self:
        return self


def _milliseconds(timeout_s: float) -> int:
    """Return what libzmq takes; -1 for ever."""
    return -1 if math.isinf(timeout_s) else max(1, round(timeout_s * 1000))


def subscribe(
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
) -> Subscription:
    """Return an open subscription to a runtime's frames, to be iterated.

    In a control loop, which must know when it is blind::

        with eitskin.subscribe(maps=False, timeout_s=0.5, max_age_s=0.2) as frames:
            while True:
                try:
                    touches = frames.next_frame().touches
                except (eitskin.NoFrame, eitskin.StaleFrame):
                    ...  # stop; asking again goes on as soon as frames come

    Args:
        endpoint: Where the runtime publishes: ``ipc:///path`` or ``tcp://address:port``; None takes the one on which
            ``eitskin run`` publishes unless told otherwise.
        mode: ``latest`` for a control loop, ``all`` for a recorder.
        timeout_s: How long to wait for a frame before :class:`eitskin.NoFrame`. None waits 5 s for the first, and then
            for ever; ``math.inf`` waits for ever from the start, for a runtime that is started later.
        max_age_s: Oldest frame that is good enough; an older one raises :class:`eitskin.StaleFrame`.
        region_mm: A rectangle (x0, y0, x1, y1) of the flat sheet: ``frame.map[frames.region.slices]`` are its pixels.
        skin: The runtime's, which a region needs unless it is the paper's (:func:`eitskin_proto.skin.toml.load`).
        skip_unchanged: Do without maps that have not changed beyond noise; ``frame.map`` is then the one from before.
        touches: Each frame has its list of touches, ``frame.touches``.
        maps: False for touches alone, a sixth of the bytes; ``frame.map`` is then (0, 0).
        patient: Be served after the others: for what shows or stores frames, and moves nothing.
        keys: CURVE keys, which TCP needs.

    Raises:
        ValueError: A bound is not positive, the mode does not exist, or the region is not on the sheet.
        EndpointError: ZeroMQ cannot make sense of the endpoint, or there is no folder for the default one.
    """
    return Subscription(
        endpoint,
        mode=mode,
        timeout_s=timeout_s,
        max_age_s=max_age_s,
        region_mm=region_mm,
        skin=skin,
        skip_unchanged=skip_unchanged,
        touches=touches,
        maps=maps,
        patient=patient,
        keys=keys,
    )
