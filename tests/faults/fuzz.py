"""Mutated frames through both decoders: nothing damaged may be accepted, nothing intact may be lost, both must agree.

``python -m tests.faults.fuzz [--frames N] [--seed S]`` sends N frames, each with its own sequence
number; about half of them are mutated: flips, drops, inserts, truncation, repeats, splices with the next one. A frame
is intact if its bytes and the delimiter before it are. A tenth as many payloads are damaged before the check is put on,
so that the decoders behind it are reached, too. Then libFuzzer, where clang is installed, bends the whole C device's
input for a bounded time, guided by what it covers, under the address and undefined-behaviour sanitizers; the same is
done without guidance by ``make -C firmware_proto check`` on every machine. One JSON line comes last; exit status 1 if
anything was wrong.
"""

import argparse
import json
import random
import re
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from typing import Final

import numpy as np
from tests.emulator.device_core import OK, CoreDeframer, library
from tests.emulator.firmware import FOLDER

from eitskin_proto.errors import ProtocolError
from eitskin_proto.wire import framing, messages
from eitskin_proto.wire.frames import Frame, FrameView, frame_bytes
from eitskin_proto.wire.scan_rows import row_count

BATCH: Final = 500
"""Frames in one stretch of the stream."""


def _flip(rng: random.Random, packet: bytearray, _: bytes) -> None:
    for _i in range(rng.choice((1, 1, 2, 3, 8))):
        bit = rng.randrange(8 * len(packet))
        packet[bit // 8] ^= 1 << bit % 8


def _drop(rng: random.Random, packet: bytearray, _: bytes) -> None:
    at = rng.randrange(len(packet))
    del packet[at : at + rng.choice((1, 1, 2, 5, 40))]


def _insert(rng: random.Random, packet: bytearray, _: bytes) -> None:
    at = rng.randrange(len(packet) + 1)
    packet[at:at] = rng.randbytes(rng.choice((1, 1, 2, 5, 40)))


def _truncate(rng: random.Random, packet: bytearray, _: bytes) -> None:
    del packet[rng.randrange(len(packet)) :]


def _repeat(rng: random.Random, packet: bytearray, _: bytes) -> None:
    at = rng.randrange(len(packet))
    packet[at:at] = packet[at : at + rng.randrange(1, 20)]


def _splice(rng: random.Random, packet: bytearray, following: bytes) -> None:
    packet[rng.randrange(len(packet)) :] = following[rng.randrange(len(following)) :]


MUTATIONS: Final[tuple[Callable[[random.Random, bytearray, bytes], None], ...]] = (
    _flip, _flip, _drop, _insert, _truncate, _repeat, _splice,
)  # fmt: skip
"""What may happen to a packet; flips twice as often."""


def _payloads(rng: random.Random, first: int, count: int) -> list[bytes]:
    """Return frames of changing shape, each with its own sequence number."""
    made = []
    for sequence in range(first, first + count):
        drives, width = rng.choice(((0xFFFF, 3), (0xFFFF, 2), (0x0111, 3), (0x0001, 4)))
        rows = row_count(False, drives)
        body = rng.randbytes(rows * width) + bytes((rows + 7) // 8)
        empty = Frame(
            sequence, 5000 * sequence % 2**32, np.zeros(rows, dtype=np.int32), sample_bytes=width, drives=drives
        )
        made.append(empty.pack()[: frame_bytes(rows, width) - len(body)] + body)
    return made


def stream(frames: int, seed: int) -> dict[str, int]:
    """Send frames, half of them mutated, through both receivers and return what became of them."""
    rng = random.Random(seed)
    figures: Counter[str] = Counter()
    python, core, view = framing.Deframer(), CoreDeframer(framing.MAX_PAYLOAD), FrameView()
    python.feed(b"\0")
    core.feed(b"\0")
    for first in range(0, frames, BATCH):
        payloads = _payloads(rng, first, min(BATCH, frames - first))
        packets = [framing.encode(payload) for payload in payloads]
        pieces, intact, clean = [], [], True
        for number, packet in enumerate(packets):
            piece = bytearray(packet)
            if rng.random() < 0.5:
                rng.choice(MUTATIONS)(rng, piece, packets[(number + 1) % len(packets)])
            if clean and piece == packet:
                intact.append(payloads[number])
            figures["mutated"] += piece != packet
            clean = (piece[-1] == 0) if piece else clean
            pieces.append(bytes(piece))
        data = b"".join(pieces) + b"\0"  # the batches do not touch each other
        received = python.feed(data)
        figures["disagreements"] += received != core.feed(data)
        sent, got = set(payloads), set(received)
        figures["sent"] += len(payloads)
        figures["intact"] += len(intact)
        figures["accepted"] += len(received)
        figures["accepted_damaged"] += len(got - sent)
        figures["lost_intact"] += len(set(intact) - got)
        for payload in received:
            view.load(payload)
            figures["disagreements"] += library().eit_message_check(payload, len(payload)) != OK
    figures["canary"] = int(core.canary != b"\xa5" * 16)
    figures["disagreements"] += (python.packets, python.corrupt) != (core.packets, core.corrupt)
    return dict(figures)


def behind_the_check(count: int, seed: int) -> dict[str, int]:
    """Give damaged payloads with a right check to both message decoders and return how often they disagree."""
    rng = random.Random(seed)
    figures: Counter[str] = Counter(payloads=count, accepted=0, disagreements=0)
    hello = messages.Hello(
        firmware_version=(1, 0, 0), hardware_id=1, serial_number="S1", configuration_digest=1, generation=1,
        configuration_name="paper", rate_mHz=1, rows=104, sample_bytes=3, volts_per_count=1e-6,
    )  # fmt: skip
    begin = messages.ConfigBegin(token=1, size=64, digest=1, hardware_id=1, revision=1, name="paper", format=1)
    write = messages.ConfigWrite(token=1, offset=0, data=bytes(range(32)))
    seeds = [hello.pack(), begin.pack(), write.pack(), messages.Start().pack(), messages.Ack(request=1).pack()]
    for _ in range(count):
        payload = bytearray(rng.choice(seeds) if rng.random() < 0.5 else _payloads(rng, 7, 1)[0])
        rng.choice(MUTATIONS)(rng, payload, rng.choice(seeds))
        raw = bytes(payload)
        try:
            messages.unpack(raw)
            accepted = True
        except ProtocolError:
            accepted = False
        figures["accepted"] += accepted
        figures["disagreements"] += accepted != (library().eit_message_check(raw, len(raw)) == OK)
    return dict(figures)


def guided(seconds: int) -> dict[str, int | str]:
    """Let libFuzzer bend the C device's input for some seconds; return the figures, or why it could not be done."""
    if seconds <= 0 or shutil.which("clang") is None:
        return {"not_run": "no seconds were asked for" if seconds <= 0 else "clang not found: apt-get install clang"}
    done = subprocess.run(
        ["make", "-s", "-C", str(FOLDER), "libfuzzer", f"FUZZ_SECONDS={seconds}"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    said = done.stdout + done.stderr
    runs = re.search(r"Done (\d+) runs in (\d+) second", said)
    covered = re.findall(r"cov: (\d+)", said)
    if done.returncode != 0 or runs is None:
        print(said[-3000:], file=sys.stderr)
    return {
        "executions": int(runs[1]) if runs else 0,
        "seconds": int(runs[2]) if runs else 0,
        "covered_edges": int(covered[-1]) if covered else 0,
        "crashes": int(done.returncode != 0),
    }


def main(argv: list[str] | None = None) -> int:
    """Run it and print the figures."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--frames", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--guided-seconds", type=int, default=60, help="of libFuzzer; 0 for none (default 60)")
    arguments = parser.parse_args(argv)
    frames = stream(arguments.frames, arguments.seed)
    sealed = behind_the_check(max(1, arguments.frames // 10), arguments.seed)
    wrong = sum(frames[key] for key in ("accepted_damaged", "lost_intact", "disagreements", "canary"))
    wrong += sealed["disagreements"]
    libfuzzer = guided(arguments.guided_seconds)
    wrong += int(libfuzzer.get("crashes", 0))
    figures = {"stream": frames, "behind_the_check": sealed, "libfuzzer": libfuzzer}
    print(json.dumps({"fuzz": figures, "wrong": wrong}))
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
