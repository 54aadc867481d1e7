"""A subscriber that remembers what was published, frame by frame; from section 7 of SPEC.md alone.

It needs libzmq and MessagePack and nothing of the project, so that what it says about a frame is not what the project's
own subscriber made of it.
"""

import math
import struct
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Self

import msgpack
import zmq

from ..pace import Waits

CELLS = 30 * 45


@dataclass
class Seen:
    """What is remembered of a published frame."""

    n: int
    sequence: int
    device_us: int
    touched: bool
    logit: float
    peak: float
    finite: bool
    """Whether every number in it is, but for those on drift, which may be unknown."""
    events: list[str]
    counts: dict[str, int]
    skipped: list[str]
    published_ns: int
    """By the host's clock."""


def _finite(value: Any, key: str = "") -> bool:
    if isinstance(value, float):
        return key.startswith("drift") or math.isfinite(value)
    if isinstance(value, dict):
        return all(_finite(inner, name) for name, inner in value.items())
    return all(map(_finite, value)) if isinstance(value, list) else True


def seen(message: bytes) -> Seen:
    """Return what is remembered of a message; raise if it is no frame by SPEC.md."""
    held = msgpack.unpackb(message)
    if held["v"] != 1 or len(message) > 16384 or len(held["map"]) != 4 * CELLS or held["shape"] != [30, 45]:
        raise ValueError("no frame of version 1")
    cells = struct.unpack(f"<{CELLS}f", held["map"])
    finite = _finite({**held, "map": None}) and all(map(math.isfinite, cells))
    where = (held["n"], held["seq"], held["device_us"], held["touched"], held["gate_logit"])
    return Seen(*where, max(cells), finite, held["events"], held["counts"], held["skipped"], held["host_ns"]["publish"])


class Witness:
    """Subscribes to everything, in a thread, until closed; looks at the runtime's process at every frame."""

    def __init__(self, endpoint: str, process: int) -> None:
        self.waits = Waits(process)
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.SUB)
        self._socket.set_hwm(0)
        self._socket.setsockopt(zmq.LINGER, 0)
        self._socket.setsockopt(zmq.RCVTIMEO, 50)
        self._socket.subscribe(b"")
        self._socket.connect(endpoint)
        self._changed = threading.Condition()
        self._closing = False
        self.frames: list[Seen] = []
        self.broken: list[str] = []
        """Messages that were no frames."""
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._closing = True
        self._thread.join()
        self._socket.close()
        self._context.term()

    @property
    def lost(self) -> int:
        """Published frames that it did not get: gaps in ``n``."""
        numbers = [frame.n for frame in self.frames]
        return sum(b - a - 1 for a, b in pairwise(numbers))

    def wait(self, reached: Callable[[list[Seen]], bool], timeout_s: float) -> bool:
        """Wait until ``reached(frames)``; return whether it came to that."""
        with self._changed:
            return self._changed.wait_for(lambda: reached(self.frames), timeout_s)

    def _listen(self) -> None:
        while not self._closing:
            try:
                message = self._socket.recv()
            except zmq.Again:
                continue
            self.waits.look(time.monotonic_ns())
            with self._changed:
                try:
                    self.frames.append(seen(message))
                except Exception as error:  # whatever is wrong with it is what is looked for
                    self.broken.append(f"{type(error).__name__}: {error}")
                self._changed.notify_all()
