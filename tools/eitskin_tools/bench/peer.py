"""``eitskin bench peer``: another tactile library's reader beside ours, on the same payloads, rate and kind of port.

The peer is flexitac 0.3.1, read by its own package in a virtual environment of its own. Ages count from the moment
before the sensor's write to the moment at which a reader returns the frame: ``read()`` and ``read_latest()`` as
flexitac's users call them, ours as far as an intact payload. Ours is also measured to the end, a subscriber in a third
process with a map inferred on the way ("stream"). The rows take turns in one run. Then 1000 frames with one inverted
bit each: how many come back as if they had been sent like that.

Both formats carry the same payload of 12 x 32 bytes, numbered, with contents that follow from the number. flexitac puts
a marker of two bytes before it; eitskin a CRC-32C behind it, stuffed (SPEC.md). No byte reaches the marker's first one,
so that a marker inside a payload, which a real sensor may send, does not count against the format.
"""

import argparse
import hashlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from eitskin.acquisition.serial_port import SerialPort
from eitskin_proto.errors import SkinError
from eitskin_proto.wire.framing import Deframer, encode
from eitskin_tools.bench.frame import stream
from eitskin_tools.bench.harness import Row, machine, report, say
from eitskin_tools.demo.score import percentiles_us
from eitskin_tools.errors import UsageError
from eitskin_tools.virtual_skin.pty import PtyPort

Format = Literal["flexitac", "eitskin"]

PAYLOAD_BYTES: Final = 12 * 32
"""flexitac's default: 12 rows and 32 columns of one byte."""

MARKER: Final = b"\xaa\x55"
"""Begins a flexitac frame (flexitac 0.3.1, sensor.py)."""

NUMBER_BASE: Final = 100
"""The number stands in the first four bytes as digits of this base."""

PACKAGE: Final = "flexitac==0.3.1"
"""What is compared with, pinned: another version may have another format."""

DRAIN_S: Final = 1.5
"""How long a reader goes on after the last frame, however late the sensor began: flexitac's own timeout is shorter."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--frames", type=int, default=2000, metavar="N", help="frames of each reader (default 2000)")
    parser.add_argument("--rate", type=float, default=100.0, metavar="HZ", help="frames a second (default 100)")
    parser.add_argument("--flipped", type=int, default=1000, metavar="N", help="frames with one flipped bit each")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Measure and report."""
    if arguments.frames < 100 or arguments.flipped < 1 or not arguments.rate > 0:
        raise UsageError("--frames must be at least 100, --flipped at least 1 and --rate above 0")
    theirs = str(peer_python()), str(Path(__file__).with_name("peer_flexitac.py"))
    readers = {
        "flexitac read()": Reader("flexitac", theirs, ("read",)),
        "flexitac read_latest()": Reader("flexitac", theirs, ("read_latest",)),
        "eitskin": OURS,
    }
    rows: list[Row] = []
    for name, reader in readers.items():
        say("peer", f"{name}, {arguments.frames} frames at {arguments.rate:g} Hz")
        found = ages(reader, arguments.frames, arguments.rate)
        rows.append({"what": name, **found, **corruption(reader, arguments.flipped, arguments.rate)})
    whole = stream(arguments.rate, arguments.frames, None)
    sent, returned = whole["frames"] + whole["lost"], whole["frames"]
    age = {f"age_us_{name}": value for name, value in whole["latency_us"].items()}
    rows.append({"what": "eitskin, stream to a subscriber", "sent": sent, "returned": returned, **age})
    summary = {
        row["what"]: {"age_p50_us": row["age_us_p50"], "corrupt_accepted": row.get("corrupt_accepted")} for row in rows
    }
    return report(arguments, rows, summary, peer=PACKAGE, rate_hz=arguments.rate, machine=machine())


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


OURS: Final = Reader("eitskin", (sys.executable, "-m", "eitskin_tools.bench.peer"))
"""Eitskin's transport and framing."""


def ages(reader: Reader, frames: int, rate_hz: float) -> Row:
    """Return the ages of intact frames when the reader returned them, and their number.

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
    dropped = sum(sent is None for sent in sent_ns)
    return {
        "sent": frames - dropped,
        "dropped_by_full_line": dropped,
        "returned": len(received),
        **{f"age_us_{name}": value for name, value in percentiles_us(np.array(ages_ns)).items()},
    }


def corruption(reader: Reader, frames: int, rate_hz: float) -> dict[str, int]:
    """Return how the reader handled frames with one inverted bit each.

    Args:
        reader: Who reads.
        frames: How many are sent.
        rate_hz: How many a second.
    """
    sent_ns, received = _run(reader, frames, rate_hz, flip=True)
    known = {hashlib.sha256(payload(number)).hexdigest() for number in range(frames)}
    return {
        "flipped_sent": sum(sent is not None for sent in sent_ns),
        "corrupt_accepted": sum(row[1] not in known for row in received),
    }


def _run(reader: Reader, frames: int, rate_hz: float, *, flip: bool) -> tuple[list[int | None], list[list[Any]]]:
    """Return when each frame was sent and what the reader printed."""
    seconds = str(frames / rate_hz + DRAIN_S)
    with PtyPort() as port:
        command = [*reader.command, str(port.path), seconds, *reader.options]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            if process.stdout.readline().strip() != "ready":
                raise SkinError(f"the {reader.kind} reader did not start; its error is above")
            packets = [on_the_wire(number, reader.kind) for number in range(frames)]
            sent_ns = _send(port, [flipped(one, n) for n, one in enumerate(packets)] if flip else packets, rate_hz)
            return sent_ns, json.loads(process.stdout.read())


def _send(port: PtyPort, packets: Sequence[bytes], rate_hz: float) -> list[int | None]:
    """Send packets at a rate and return when each went out; one that the line has no room for is dropped, None."""
    sent_ns: list[int | None] = []
    start = time.perf_counter()
    for number, packet in enumerate(packets):
        time.sleep(max(start + number / rate_hz - time.perf_counter(), 0.0))
        now = time.perf_counter_ns()
        sent_ns.append(now if port.write(packet) else None)
    while port.unsent:
        port.flush()
        time.sleep(0.001)
    return sent_ns


def peer_python() -> Path:
    """Return the interpreter of an environment that has the package, made in the user's cache if it is not there.

    Raises:
        SkinError: It cannot be made or the package cannot be installed.
    """
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    where = Path(base) / "eitskin" / f"peer-{PACKAGE.replace('==', '-')}"
    python, done = where / "bin" / "python", where / "installed"
    if done.exists() and python.exists():
        return python
    for command in (
        [sys.executable, "-m", "venv", "--clear", str(where)],
        [str(python), "-m", "pip", "--disable-pip-version-check", "--quiet", "install", PACKAGE],
    ):
        result = subprocess.run(command, capture_output=True, text=True, check=False)
        if result.returncode:
            last = (result.stderr.strip().splitlines() or ["no output"])[-1]
            raise SkinError(
                f"{PACKAGE} cannot be installed into {where} ({last}); this benchmark needs a package index"
            )
    done.touch()
    return python


def payload(number: int) -> bytes:
    """Return the 384 bytes of a frame."""
    contents = np.random.default_rng(number).integers(0, MARKER[0], PAYLOAD_BYTES, dtype=np.uint8)
    for place in range(4):
        contents[place] = number // NUMBER_BASE**place % NUMBER_BASE
    return contents.tobytes()


def number_of(contents: Sequence[int]) -> int:
    """Return the number that the first four bytes say."""
    return sum(digit * NUMBER_BASE**place for place, digit in enumerate(contents[:4]))


def on_the_wire(number: int, kind: Format) -> bytes:
    """Return a frame as one of the formats sends it."""
    contents = payload(number)
    return MARKER + contents if kind == "flexitac" else encode(contents)


def flipped(frame: bytes, seed: int) -> bytes:
    """Return a frame with one random bit inverted."""
    bit = int(np.random.default_rng([seed, 1]).integers(8 * len(frame)))
    changed = bytearray(frame)
    changed[bit // 8] ^= 1 << bit % 8
    return bytes(changed)


def read(port: str, seconds: float) -> None:
    """Read with our transport and framing until the time is over; print what ``peer_flexitac.py`` prints."""
    found = []
    line, deframer = SerialPort(port), Deframer()
    try:
        print("ready", flush=True)
        end = time.perf_counter() + seconds
        while (left := end - time.perf_counter()) > 0:
            payloads = deframer.feed(line.read(left))
            now = time.perf_counter_ns()
            found += [[now, hashlib.sha256(raw).hexdigest(), list(raw[:4])] for raw in payloads]
    finally:
        line.close()
    print(json.dumps(found))


if __name__ == "__main__":
    read(sys.argv[1], float(sys.argv[2]))
