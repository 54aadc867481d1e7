"""Runs a sensor and a reader as two processes and says how old frames were and which of them nobody had sent."""

import hashlib
import json
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from eitskin_proto.errors import SkinError
from eitskin_tools.bench.peer import reader_eitskin
from eitskin_tools.bench.peer.frames import Format, number_of, payload
from eitskin_tools.demo.score import percentiles_us

DRAIN_S: Final = 1.5
"""How long a reader goes on after the last frame, however late the sensor began: flexitac's own timeout is shorter."""


@dataclass(frozen=True, slots=True)
class Reader:
    """A way to read a sensor.

    Args:
        kind: The sensor's format.
        command: Interpreter, script and options; port and seconds go between script and options.
    """

    kind: Format
    command: Sequence[str]
    options: Sequence[str] = ()


def ours() -> Reader:
    """Return eitskin's transport and framing."""
    return Reader("eitskin", (sys.executable, str(reader_eitskin.__file__)))


def theirs(python: Path, method: str) -> Reader:
    """Return flexitac's ``read`` or ``read_latest``."""
    script = Path(__file__).with_name("reader_flexitac.py")
    return Reader("flexitac", (str(python), str(script)), (method,))


def ages(reader: Reader, frames: int, rate_hz: float) -> dict[str, Any]:
    """Return how old intact frames were when the reader returned them, and how many it returned.

    Args:
        reader: Who reads.
        frames: How many are sent.
        rate_hz: How many a second.
    """
    sent_ns, received = _run(reader, frames, rate_hz, flip=False)
    ages_ns = [
        at_ns - sent
        for at_ns, number in ((row[0], number_of(row[2])) for row in received)
        if number < len(sent_ns) and (sent := sent_ns[number]) is not None
    ]
    if not ages_ns:
        raise SkinError(f"the {reader.kind} reader returned not one frame of {frames}")
    seconds = frames / rate_hz
    dropped = sum(sent is None for sent in sent_ns)
    return {
        "sent": frames - dropped,
        "dropped_by_full_line": dropped,
        "returned": len(received),
        "returned_hz": round(len(received) / seconds, 1),
        "age_us": percentiles_us(np.array(ages_ns)),
    }


def corruption(reader: Reader, frames: int, rate_hz: float) -> dict[str, int]:
    """Return what became of frames of which each has one bit inverted.

    Args:
        reader: Who reads.
        frames: How many are sent.
        rate_hz: How many a second.
    """
    sent_ns, received = _run(reader, frames, rate_hz, flip=True)
    known = {hashlib.sha256(payload(number)).hexdigest() for number in range(frames)}
    return {
        "sent": sum(sent is not None for sent in sent_ns),
        "returned": len(received),
        "corrupt_accepted": sum(row[1] not in known for row in received),
    }


def _run(reader: Reader, frames: int, rate_hz: float, *, flip: bool) -> tuple[list[int | None], list[list[Any]]]:
    """Return when each frame was sent and what the reader printed."""
    options = ["--frames", str(frames), "--rate", str(rate_hz), *(["--flip"] if flip else [])]
    sensor = subprocess.Popen(
        [sys.executable, "-m", "eitskin_tools.bench.peer.sensor", reader.kind, *options],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        assert sensor.stdin is not None
        assert sensor.stdout is not None
        port = sensor.stdout.readline().strip()
        seconds = frames / rate_hz + DRAIN_S
        with subprocess.Popen(
            [*reader.command, port, str(seconds), *reader.options], stdout=subprocess.PIPE, text=True
        ) as process:
            assert process.stdout is not None
            if process.stdout.readline().strip() != "ready":
                raise SkinError(f"the {reader.kind} reader did not start; its error is above")
            sensor.stdin.write("go\n")
            sensor.stdin.flush()
            received = json.loads(process.stdout.read())
        sent_ns = json.loads(sensor.stdout.readline())
        sensor.communicate("done\n")
    finally:
        if sensor.poll() is None:
            sensor.kill()
            sensor.wait()
    return sent_ns, received
