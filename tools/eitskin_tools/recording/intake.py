"""Two subscriptions into one queue: what was measured, and what was published of it.

Each has a thread of its own that does nothing but take messages from its socket; whoever writes them may be held up by
the disk for a while. All of them rest between whiles and then take what has come: a recording is in no hurry, and each
waking of a thread takes time from the frame loop where cores are few. They wake when a frame is through, and have done
before the next one comes.
"""

import threading
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from queue import Empty, SimpleQueue
from typing import Any, Final

from eitskin.errors import NoFrame
from eitskin.messaging.frame import Frame
from eitskin.messaging.streams.measured import WireFrame
from eitskin_proto.errors import SkinError
from eitskin_tools.processes.rhythm import Rhythm

MOST_WAITING: Final = 20_000
"""Messages that wait for the disk: half a minute at 200 frames/s; more would be memory without end."""

REST_S: Final = 0.02
"""How long threads rest, at least, where they have taken what there was: 4 frames come meanwhile at 200 frames/s."""


def heard(rhythm: Rhythm, found: object) -> None:
    """Have a rhythm take note of a frame, whatever stream it is of."""
    match found:
        case Frame():
            rhythm.heard(found.number, found.host_ns["read"])
        case WireFrame():
            rhythm.heard(found.n, found.read_ns)


class Intake:
    """Takes from subscriptions until it is closed.

    Args:
        sources: Each makes a subscription that ends its waiting with :class:`eitskin.NoFrame` now and then.
    """

    def __init__(self, sources: Iterable[Callable[[], Any]]) -> None:
        self._queue: SimpleQueue[object] = SimpleQueue()
        self._rhythm = Rhythm()
        self._closing = threading.Event()
        self.dropped = 0
        """Messages that were not taken because the disk was too slow."""
        self.silent: SkinError | None = None
        """Why nothing comes, as the last source to wait in vain said it; None once something came since."""
        self.unusable: SkinError | None = None
        """The same of a source to which something comes that it cannot use: of another version, say."""
        self._threads = [
            threading.Thread(target=self._take, args=(source,), name=f"record-{number}", daemon=True)
            for number, source in enumerate(sources)
        ]
        for thread in self._threads:
            thread.start()

    def _take(self, source: Callable[[], Any]) -> None:
        try:
            subscription = source()
        except Exception as error:
            self._queue.put(error)
            return
        rhythm, rejected = Rhythm(), 0
        try:
            while not self._closing.is_set():
                try:
                    for found in subscription:
                        self.silent = self.unusable = None
                        if self._queue.qsize() < MOST_WAITING:
                            self._queue.put(found)
                        else:
                            self.dropped += 1
                        heard(rhythm, found)
                        if not subscription.waits:
                            self._rhythm = rhythm
                            self._closing.wait(rhythm.rest_s(REST_S))
                        if self._closing.is_set():
                            return
                except NoFrame as error:
                    self.silent = error
                    if subscription.rejected > rejected:
                        self.unusable, rejected = error, subscription.rejected
        except Exception as error:
            self._queue.put(error)
        finally:
            subscription.close()

    def next(self, timeout_s: float) -> object | None:
        """Return what came next; None if nothing came in time.

        Raises:
            SkinError: A subscription failed.
        """
        if self._queue.empty():
            time.sleep(min(self._rhythm.rest_s(REST_S), timeout_s))
        with suppress(Empty):
            found = self._queue.get(timeout=timeout_s)
            if isinstance(found, Exception):
                raise found
            return found
        return None

    def close(self) -> None:
        """End the subscriptions, and wait for their threads."""
        self._closing.set()
        for thread in self._threads:
            thread.join(5.0)
