"""Makes what computes some regions, beside the frame loop: one thread, one union at a time, the newest wish wins.

Regions come with subscribers, whoever they are, so a subscriber that comes and goes all the time must not keep a core
busy: after each union the thread rests.

Making a union runs C++ code that must not be left behind by an interpreter that ends: it would abort the process. So
the thread is no daemon, which the interpreter waits for, and ``close`` ends it after the union in hand, which cannot be
interrupted.
"""

import threading
from contextlib import suppress
from typing import Final

from eitskin.messaging.regions import Regions
from eitskin.pipeline.frame_pipeline import Pipeline

REST_S: Final = 0.5
"""Between two unions."""

CLOSING_S: Final = 0.2
"""How long ``close`` waits for the union in hand, of which some tens of milliseconds are left."""


class RegionWorker:
    """Gives a pipeline the engines of its regions; release it with ``close``.

    Args:
        pipeline: Takes them over between two frames.
    """

    def __init__(self, pipeline: Pipeline) -> None:
        self._pipeline = pipeline
        self._lock = threading.Lock()
        self._wanted: Regions = pipeline.whole
        self._thread: threading.Thread | None = None
        self._closing = threading.Event()
        self.made = 0
        """Unions made so far."""

    def want(self, regions: Regions) -> None:
        """Wish for other regions; returns at once. Where the system has no thread left, all are computed."""
        with self._lock:
            if regions == self._wanted or self._closing.is_set():
                return
            if self._thread is None:
                thread = threading.Thread(target=self._make, name="eitskin-regions", daemon=False)
                try:
                    thread.start()
                except RuntimeError:  # no frame may fail for a wish
                    regions = self._pipeline.whole
                    self._pipeline.use_regions(regions)
                else:
                    self._thread = thread
            self._wanted = regions

    def _make(self) -> None:
        made: Regions | None = None
        while True:
            with self._lock:
                wanted = self._wanted
                if wanted == made or self._closing.is_set():
                    self._thread = None
                    return
            try:
                self._pipeline.use_regions(wanted)
            except Exception:  # this thread must hear the next wish; every frame says what it shows
                with suppress(Exception):
                    self._pipeline.use_regions(self._pipeline.whole)
            made = wanted
            self.made += 1
            self._closing.wait(REST_S)

    def close(self) -> None:
        """Make no more unions, and wait a moment for the one in hand; closing twice is fine."""
        self._closing.set()
        with self._lock:
            thread = self._thread
        if thread is not None:
            thread.join(CLOSING_S)
