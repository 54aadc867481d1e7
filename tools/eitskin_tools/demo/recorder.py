"""Records every frame's time and map of a stream.

It does nothing with a frame but copy it, so that what it measures is the stream and not itself. Memory is allocated at
the start; of a long run every n-th map is kept, never more than ``MAX_MAPS``.
"""

import gc
import time
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt

import eitskin

STAGES: Final = ("read", "decode", "normalise", "gate", "infer", "pack", "publish")
"""Stamps of the runtime, in order."""

MAX_MAPS: Final = 6000
"""Maps kept: of the paper's skin, 16 MB."""

SILENCE_S: Final = 120.0
"""How long the first frame may take, since device and reference come before it, and any other."""

POLL_S: Final = 0.5
"""Between two looks at the other processes."""


@dataclass(slots=True, eq=False)
class Record:
    """Everything noted about a stream of frames, as arrays of one length, and every ``stride``-th map."""

    sequence: npt.NDArray[np.int64]
    device_us: npt.NDArray[np.int64]
    received_ns: npt.NDArray[np.int64]
    host_ns: npt.NDArray[np.int64]
    """(n, 7) the runtime's stamps, in the order of ``STAGES``."""
    touched: npt.NDArray[np.bool_]
    inferred: npt.NDArray[np.bool_]
    """Whether a solver ran for the frame, and no earlier map stands for it."""
    cloud: npt.NDArray[np.int64]
    maps: npt.NDArray[np.float16]
    """(m, rows, columns) of frames 0, stride, 2 stride, ..."""
    stride: int
    late: int
    """Frames that the subscriber was too slow for."""
    corrupt: int
    withheld: int

    @classmethod
    def empty(cls, capacity: int, shape: tuple[int, int]) -> "Record":
        """Return arrays for the given number of frames and size of maps."""
        stride = max(1, -(-capacity // MAX_MAPS))
        whole = np.zeros(capacity, dtype=np.int64)
        return cls(
            whole, whole.copy(), whole.copy(), np.zeros((capacity, len(STAGES)), dtype=np.int64),
            np.zeros(capacity, dtype=bool), np.zeros(capacity, dtype=bool), whole.copy(),
            np.zeros((-(-capacity // stride), *shape), dtype=np.float16), stride, 0, 0, 0,
        )  # fmt: skip

    def note(self, index: int, frame: Any) -> None:
        """Note one frame."""
        self.sequence[index] = frame.sequence
        self.device_us[index] = frame.device_us
        self.received_ns[index] = frame.received_ns
        for column, stage in enumerate(STAGES):
            self.host_ns[index, column] = frame.host_ns[stage]
        self.touched[index] = frame.touched
        self.inferred[index] = not any(reason.startswith("inference:") for reason in frame.skipped)
        self.cloud[index] = frame.cloud
        if index % self.stride == 0:
            self.maps[index // self.stride] = frame.map
        self.corrupt, self.withheld = frame.counts["corrupt"], frame.counts["withheld"]

    def first(self, count: int) -> "Record":
        """Return the first ``count`` frames."""
        arrays = {one.name: getattr(self, one.name) for one in fields(self)}
        kept: dict[str, Any] = {name: one[:count] for name, one in arrays.items() if isinstance(one, np.ndarray)}
        return replace(self, **{**kept, "maps": self.maps[: -(-count // self.stride)]})


def record(
    endpoint: str, seconds: float, capacity: int, look: Callable[[], None], shown: Callable[[Any], None]
) -> Record:
    """Record a stream and return what was noted; Ctrl-C behind the first frame ends it early.

    Args:
        endpoint: Where the runtime publishes.
        seconds: From the first frame on.
        capacity: Most frames to take.
        look: Called twice a second, to see whether others still run.
        shown: Called with each frame.

    Raises:
        SkinError: No frame came, or the stream went silent.
    """
    found: Record | None = None
    count, heard_s, due_s = 0, time.monotonic(), 0.0
    gc.collect()
    gc.disable()
    try:
        with eitskin.subscribe(endpoint, mode="all", timeout_s=POLL_S) as frames:
            while count < capacity:
                if time.monotonic() >= due_s:
                    look()
                    due_s = time.monotonic() + POLL_S
                try:
                    frame = frames.next_frame()
                except eitskin.NoFrame:
                    if time.monotonic() > heard_s + SILENCE_S:
                        raise
                    continue
                heard_s = time.monotonic()
                if found is None:
                    found = Record.empty(capacity, frame.map.shape)
                    end_ns = frame.received_ns + int(seconds * 1e9)
                if frame.received_ns >= end_ns:
                    break
                found.note(count, frame)
                found.late = frames.lost
                count += 1
                shown(frame)
    except KeyboardInterrupt:
        if found is None:
            raise
    finally:
        gc.enable()
    assert found is not None
    return found.first(count)
