"""Subscribers who come and go without end, none of them hostile: who comes has a frame soon, who stays has all."""

import threading
import time
from contextlib import closing
from functools import partial
from typing import Final

import eitskin

from ..outcome import Effort, Outcome
from ..stream import PATIENCE_S
from ..zmtp import flood
from ..zmtp.peer import Peer
from .ground import defended

LANES: Final = 6
"""Comings at a time, each of which fits into what is let in at once."""

SOON: Final = 400
"""Frames after which who comes has one: 2 s, of which most are for a busy machine. A subscription that was lost is
made anew after 1 s."""


class Newest:
    """Follows the stream in a thread; leave it with ``close``."""

    def __init__(self, endpoint: str) -> None:
        self.number = 0
        """Of the frame that came last."""
        self._over = False
        self._frames = eitskin.subscribe(endpoint, timeout_s=PATIENCE_S)
        self.number = next(self._frames).number
        self._thread = threading.Thread(target=self._follow)
        self._thread.start()

    def _follow(self) -> None:
        while not self._over:
            self.number = next(self._frames).number

    def close(self) -> None:
        """Leave."""
        self._over = True
        self._thread.join()
        self._frames.close()


def comings_and_goings(effort: Effort) -> Outcome:
    """Subscribe in every way, take a frame and leave, again and again; some greet and leave without a word."""
    outcome = Outcome("subscribers.comings")
    times = effort.count(10, 400)
    for what, arguments in (("ipc", ()), ("TCP", ("--publish", "tcp://127.0.0.1:*"))):
        waited: list[int] = []
        again: list[int] = []
        with defended(outcome, what, arguments=arguments) as stream, closing(Newest(stream.frames)) as newest:
            began_s = time.monotonic()
            lane = partial(_lane, stream.frames, times, newest, waited, again)
            flood.side_by_side([lane] * LANES)
            outcome.figures[f"{what}, comings/s"] = round(len(waited) / (time.monotonic() - began_s), 1)
        late = [frames for frames in waited if frames > SOON]
        outcome.note(not late and len(waited) > 0, f"{what}: {len(late)} of {len(waited)} waited {late[:5]} frames")
        outcome.figures[f"{what}, longest wait in frames"] = max(waited, default=-1)
        outcome.figures[f"{what}, connected anew"] = sum(again)
    return outcome


def _lane(endpoint: str, times: int, newest: Newest, waited: list[int], again: list[int]) -> None:
    """Come and go so often; note how many frames had passed at the first frame, and how often it was tried anew."""
    for turn in range(times):
        if turn % 3 == 2:
            Peer(endpoint, patience_s=PATIENCE_S).close()
            continue
        before = newest.number
        try:
            with eitskin.subscribe(endpoint, ("latest", "all")[turn % 2], timeout_s=PATIENCE_S) as frames:
                waited.append(next(frames).number - before)
                again.append(frames.reconnected)
        except eitskin.NoFrame:
            waited.append(newest.number - before)
