"""Who waits for a stream: ``eitskin replay --wait`` for subscribers, ``eitskin record`` for what it can use."""

import threading
import time

from eitskin.errors import NoFrame
from eitskin_tools.recording.recorder import SubscriptionQueue


class Unusable:
    """A subscription to which messages come that it cannot use, and one that it can once that was seen."""

    def __init__(self) -> None:
        self.rejected, self.waits, self.closed = 0, False, False
        self.seen = threading.Event()

    def __iter__(self) -> "Unusable":
        return self

    def __next__(self) -> object:
        if self.rejected:
            self.seen.wait(60.0)
            return "usable"
        self.rejected += 1
        raise NoFrame(f"{self.rejected} of version 4, expected 3")

    def close(self) -> None:
        self.closed = True


def test_a_recorder_tells_what_cannot_be_used_from_silence() -> None:
    source = Unusable()
    intake = SubscriptionQueue([lambda: source])
    try:
        end_s = time.monotonic() + 60.0
        while intake.unusable is None and time.monotonic() < end_s:
            time.sleep(0.001)
        assert "of version 4, expected 3" in str(intake.unusable)
        source.seen.set()
        assert intake.next(60.0) == "usable"
        assert intake.unusable is None
    finally:
        intake.close()
    assert source.closed
