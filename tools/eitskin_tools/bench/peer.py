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
    python = peer_python()
    readers = {
        "flexitac read()": theirs(python, "read"),
        "flexitac read_latest()": theirs(python, "read_latest"),
        "eitskin": ours(),
    }
    rows: dict[str, Row] = {}
    for name, reader in readers.items():
        say("peer", f"{name}, {arguments.frames} frames at {arguments.rate:g} Hz")
        rows[name] = {
            **ages(reader, arguments.frames, arguments.rate),
            "flipped": corruption(reader, arguments.flipped, arguments.rate),
        }
    whole = stream(arguments.rate, arguments.frames, None)
    rows["eitskin, stream to a subscriber"] = {
        "sent": whole["frames"] + whole["lost"],
        "returned": whole["frames"],
        "returned_hz": whole["rate_hz"],
        "age_us": whole["latency_us"],
    }
    more = {"peer": PACKAGE, "rate_hz": arguments.rate, "machine": machine()}
    return report(arguments, flat_rows(rows), summary(rows), **more)


def flat_rows(readers: dict[str, Row]) -> list[Row]:
    """Return a row for each reader, with what each of its parts holds beside the rest."""
    found = []
    for name, row in readers.items():
        flat = {"what": name}
        for key, value in row.items():
            flat |= {f"{key}_{part}": one for part, one in value.items()} if isinstance(value, dict) else {key: value}
        found.append(flat)
    return found


def summary(readers: dict[str, Row]) -> Row:
    """Return, by reader, the median age of its frames and how many damaged ones it took for intact."""
    return {
        name: {
            "age_p50_us": row["age_us"]["p50"],
            "corrupt_accepted": row["flipped"]["corrupt_accepted"] if "flipped" in row else None,
        }
        for name, row in readers.items()
    }


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
    return Reader("eitskin", (sys.executable, "-m", __name__, "reader"))


def theirs(python: Path, method: str) -> Reader:
    """Return flexitac's ``read`` or ``read_latest``."""
    script = Path(__file__).with_name("peer_flexitac.py")
    return Reader("flexitac", (str(python), str(script)), (method,))


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
    """Return how the reader handled frames with one inverted bit each.

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
        [sys.executable, "-m", __name__, "sensor", reader.kind, *options],
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


def cache_folder() -> Path:
    """Return where the environment is kept."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "eitskin" / f"peer-{PACKAGE.replace('==', '-')}"


def peer_python(folder: Path | None = None) -> Path:
    """Return the interpreter of an environment that has the package, made if it is not there.

    Args:
        folder: Of the environment; None takes :func:`cache_folder`.

    Raises:
        SkinError: It cannot be made or the package cannot be installed.
    """
    where = folder or cache_folder()
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


def send(words: Sequence[str]) -> None:
    """Print a port, wait for a line, send frames at a rate, and print when each went out.

    Frames that the line has no room for are dropped whole, as a sensor's would be, and have no time.
    """
    parser = argparse.ArgumentParser(description="Send numbered frames on a pseudo-terminal.")
    parser.add_argument("kind", choices=["flexitac", "eitskin"])
    parser.add_argument("--frames", type=int, required=True)
    parser.add_argument("--rate", type=float, required=True)
    parser.add_argument("--flip", action="store_true", help="invert one bit of every frame")
    arguments = parser.parse_args(words)
    frames = [on_the_wire(number, arguments.kind) for number in range(arguments.frames)]
    if arguments.flip:
        frames = [flipped(frame, number) for number, frame in enumerate(frames)]
    sent_ns: list[int | None] = []
    with PtyPort() as port:
        print(port.path, flush=True)
        sys.stdin.readline()
        start = time.perf_counter()
        for number, frame in enumerate(frames):
            time.sleep(max(start + number / arguments.rate - time.perf_counter(), 0.0))
            now = time.perf_counter_ns()
            sent_ns.append(now if port.write(frame) else None)
        while port.unsent:
            port.flush()
            time.sleep(0.001)
        print(json.dumps(sent_ns), flush=True)
        sys.stdin.readline()  # the port stays until the reader is done


if __name__ == "__main__":
    if sys.argv[1] == "sensor":
        send(sys.argv[2:])
    else:
        read(sys.argv[2], float(sys.argv[3]))
