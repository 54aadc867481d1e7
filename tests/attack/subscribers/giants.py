"""Attacks on subscribers of every kind: messages too large for any of them, and hosts that are no ZMTP at all."""

import random
import socket
import struct
import tempfile
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from typing import Any

import eitskin
from eitskin.messaging.frame_message import FramePacker
from eitskin.messaging.streams.envelope import FIRST_BYTE, WIRE
from eitskin.messaging.streams.envelope import packed as enveloped
from eitskin.messaging.streams.verified import COUNTS, TOPIC, pack_head, pack_verdict
from eitskin_proto.skin.skin import PAPER

from ..outcome import Effort, Outcome
from ..zmtp.host import FRAMES, Host
from ..zmtp.peer import GREETING, packed

NO_GREETING = b"HTTP/1.1 400 Bad Request\r\n\r\n" + bytes(64)


@dataclass(frozen=True)
class Kind:
    """One kind of subscriber."""

    what: str
    subscribe: Callable[..., Any]
    topics: tuple[bytes, ...]
    good: bytes
    """A message that it takes; a giant begins with the same topic."""
    counts: bool = True
    """Whether it sees every message, and so counts those that are none."""


def _kinds() -> list[Kind]:
    packer = FramePacker(configuration="paper/1", bundle="b", serial_number="s", run="r", shape=PAPER.grid.shape)
    packer.put_texts("vd2t", (), ())
    frame = bytes(packer.message())
    wire = eitskin.WireFrame(payload=b"\x80", seq=1, read_ns=1, device_us=1).body()
    verdict = pack_head(1, "r", dict.fromkeys(COUNTS, 0)) + pack_verdict(1, 1, 0, "ready", "", (1, 1, 0, 0))
    only = partial(eitskin.subscribe_verified, frames=False)
    return [
        Kind("latest", partial(eitskin.subscribe, mode="latest"), FRAMES, frame, counts=False),
        Kind("all", partial(eitskin.subscribe, mode="all"), FRAMES, frame),
        Kind("streams", eitskin.subscribe_streams, (FIRST_BYTE,), *enveloped(WIRE, 1, "r", wire)),
        Kind("verified latest", partial(only, mode="latest"), (TOPIC,), verdict),
        Kind("verified all", partial(only, mode="all"), (TOPIC,), verdict),
    ]


def giant_messages(effort: Effort) -> Outcome:
    """Send a subscriber what is larger than any message; it must count it or leave, and take the next good one."""
    outcome = Outcome("subscribers.giants")
    rng = random.Random(effort.seed)
    sizes = [20_000, 16_385, 65_536, 65_537, 1_000_000]
    sizes += [rng.randrange(16_385, 4_000_000) for _ in range(effort.count(0, 30))]
    for kind in _kinds():
        topic = next(topic for topic in kind.topics if kind.good.startswith(topic))  # else it is not even handed on
        for size in sizes:
            giant = topic + bytes(size - len(topic))
            _one(outcome, kind, packed(giant), f"{size} bytes to {kind.what}", counted=size <= 65_536)
        header = struct.pack(">BQ", 2, 1 << 62)
        _one(outcome, kind, header, f"2^62 bytes announced to {kind.what}", counted=False)
        _one(outcome, kind, b"", f"no ZMTP to {kind.what}", counted=False, greeting=NO_GREETING)
    return outcome


def _one(outcome: Outcome, kind: Kind, evil: bytes, what: str, *, counted: bool, greeting: bytes = GREETING) -> None:
    good = packed(kind.good)

    def serve(stream: socket.socket) -> None:
        if host.served == 1:
            stream.sendall(evil)
        while True:
            stream.sendall(good)
            time.sleep(0.01)

    with tempfile.TemporaryDirectory(prefix="a") as folder:
        host = Host(f"{folder}/f", serve, greeting, kind.topics)
        with closing(host), kind.subscribe(f"ipc://{folder}/f", timeout_s=60) as found:
            began_s = time.monotonic()
            try:
                next(found)
                served = found.rejected > 0 or not (counted and kind.counts)
            except eitskin.NoFrame:
                served = False
            spent_s = time.monotonic() - began_s
        outcome.note(served, f"{what}: {found.received} taken, {found.rejected} rejected after {spent_s:.1f} s")
        outcome.figures["longest_deaf_s"] = max(outcome.figures.get("longest_deaf_s", 0.0), round(spent_s, 2))
