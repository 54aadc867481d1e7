"""Makes what computes some regions, beside the frame loop: one thread, one union at a time, the newest wish wins.

Regions come with subscribers, whoever they are, so a subscriber that comes and goes all the time must not keep a core
busy: after each union the thread rests.
"""

import threading
from typing import Final

from eitskin.errors import BundleError
from eitskin.messaging.regions import WHOLE, Regions
from eitskin.pipeline.frame_pipeline import Pipeline

REST_S: Final = 0.5
"""Between two unions."""


class RegionWorker:
    """Gives a pipeline the engines of its regions.

    Args:
        pipeline: Takes them over between two frames.
    """

    def __init__(self, pipeline: Pipeline) -> None:
        self._pipeline = pipeline
        self._lock = threading.Lock()
        self._wanted: Regions = (WHOLE,)
        self._running = False
        self.made = 0
        """Unions made so far."""
        self.failure = ""
        """Why the last wish could not be met; the whole sheet is computed then."""

    def want(self, regions: Regions) -> None:
        """Wish for other regions; returns at once."""
        with self._lock:
            if regions == self._wanted:
                return
            self._wanted = regions
            if not self._running:
                self._running = True
                threading.Thread(target=self._make, name="eitskin-regions", daemon=True).start()

    def _make(self) -> None:
        made: Regions | None = None
        while True:
            with self._lock:
                wanted = self._wanted
                if wanted == made:
                    self._running = False
                    return
            try:
                self._pipeline.use_regions(wanted)
                self.failure = ""
            except (BundleError, MemoryError) as error:
                self._pipeline.use_regions((WHOLE,))
                self.failure = str(error)
            made = wanted
            self.made += 1
            threading.Event().wait(REST_S)
