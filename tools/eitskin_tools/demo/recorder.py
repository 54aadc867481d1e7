"""The subscriber's process: records every frame's time and map, and writes one file at the end.

It does nothing with a frame but copy it, so that what it measures is the stream and not itself. Memory is allocated at
the start; of a long run every n-th map is kept, never more than ``MAX_MAPS``.
"""

import argparse
import gc
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

import eitskin
from eitskin_tools.processes.signals import Stopped, raise_stopped_on_signals

STAGES: Final = ("read", "decode", "normalise", "gate", "infer", "pack", "publish")
"""Stamps of the runtime, in order."""

MAX_MAPS: Final = 6000
"""Maps kept: of the paper's skin, 16 MB."""

SILENCE_S: Final = 60.0
"""How long the first frame may take, since device, reference and runtime come before it, and any other."""


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

    def save(self, path: Path, count: int) -> None:
        """Write the first ``count`` frames."""
        np.savez(
            path, sequence=self.sequence[:count], device_us=self.device_us[:count],
            received_ns=self.received_ns[:count], host_ns=self.host_ns[:count],
            touched=self.touched[:count], inferred=self.inferred[:count],
            cloud=self.cloud[:count], maps=self.maps[: -(-count // self.stride)],
            scalars=np.array([self.stride, self.late, self.corrupt, self.withheld]),
        )  # fmt: skip

    @classmethod
    def load(cls, path: Path) -> "Record":
        """Return what was saved."""
        with np.load(path, allow_pickle=False) as file:
            stride, late, corrupt, withheld = (int(value) for value in file["scalars"])
            return cls(
                file["sequence"], file["device_us"], file["received_ns"], file["host_ns"], file["touched"],
                file["inferred"], file["cloud"], file["maps"], stride, late, corrupt, withheld,
            )  # fmt: skip


def record(endpoint: str, seconds: float, capacity: int, path: Path) -> int:
    """Record a stream and return how many frames there were.

    Args:
        endpoint: Where the runtime publishes.
        seconds: From the first frame on.
        capacity: Most frames to take.
        path: File to write.

    Raises:
        SkinError: No frame came, or the stream went silent.
    """
    found: Record | None = None
    count = 0
    gc.collect()
    gc.disable()
    with eitskin.subscribe(endpoint, mode="all", timeout_s=SILENCE_S) as frames:
        try:
            first = frames.next_frame()
            found = Record.empty(capacity, first.map.shape)
            found.note(0, first)
            count = 1
            print("first", flush=True)
            end_ns = int(found.received_ns[0]) + int(seconds * 1e9)
            while count < capacity:
                frame = frames.next_frame()
                if frame.received_ns >= end_ns:
                    break
                found.note(count, frame)
                count += 1
        except Stopped:
            pass
        if found is None:
            raise Stopped
        found.late = frames.lost
    found.save(path, count)
    return count


def main() -> int:
    """Run the subscriber's process."""
    parser = argparse.ArgumentParser(description="Record a stream of frames.")
    parser.add_argument("endpoint")
    parser.add_argument("path", type=Path)
    parser.add_argument("--seconds", type=float, required=True)
    parser.add_argument("--capacity", type=int, required=True)
    arguments = parser.parse_args()
    raise_stopped_on_signals()
    try:
        count = record(arguments.endpoint, arguments.seconds, arguments.capacity, arguments.path)
    except eitskin.SkinError as error:
        print(f"{error}", file=sys.stderr)
        return 1
    except Stopped:
        return 1
    return 0 if count else 1


if __name__ == "__main__":
    sys.exit(main())
