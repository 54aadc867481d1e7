"""Attacks on a Subscription: messages too large for any frame, and hosts that are no ZMTP at all."""

import random
import socket
import struct
import tempfile
import time
from contextlib import closing

import eitskin
from eitskin.messaging.frame_packer import FramePacker
from eitskin_proto.skin.skin import PAPER

from ..outcome import Effort, Outcome
from ..zmtp.host import Host
from ..zmtp.peer import GREETING, packed

NO_GREETING = b"HTTP/1.1 400 Bad Request\r\n\r\n" + bytes(64)


def giant_messages(effort: Effort) -> Outcome:
    """Send a subscriber what is larger than any frame; it must count it or leave, and take the next good frame."""
    outcome = Outcome("subscribers.giants")
    rng = random.Random(effort.seed)
    sizes = [20_000, 16_385, 65_536, 65_537, 1_000_000]
    sizes += [rng.randrange(16_385, 4_000_000) for _ in range(effort.count(0, 30))]
    for mode in ("latest", "all"):
        for size in sizes:
            giant = b"\xde\x00" + bytes(size - 2)  # as frames begin: the rest is not even handed to who takes frames
            _one(outcome, mode, packed(giant), f"{size} bytes in mode {mode}", counted=size <= 65_536)
        header = struct.pack(">BQ", 2, 1 << 62)
        _one(outcome, mode, header, f"2^62 bytes announced in mode {mode}", counted=False)
        _one(outcome, mode, b"", f"no ZMTP in mode {mode}", counted=False, greeting=NO_GREETING)
    return outcome


def _one(outcome: Outcome, mode: str, evil: bytes, what: str, *, counted: bool, greeting: bytes = GREETING) -> None:
    packer = FramePacker(configuration="paper/1", bundle="b", serial_number="s", run="r", shape=PAPER.grid.shape)
    packer.put_texts("vd2t", (), ())
    good = packed(bytes(packer.message()))

    def serve(stream: socket.socket) -> None:
        if host.served == 1:
            stream.sendall(evil)
        while True:
            stream.sendall(good)
            time.sleep(0.01)

    with tempfile.TemporaryDirectory(prefix="a") as folder:
        host = Host(f"{folder}/f", serve, greeting)
        with closing(host), eitskin.subscribe(f"ipc://{folder}/f", mode, timeout_s=60) as frames:
            began_s = time.monotonic()
            try:
                frames.next_frame()
                served = frames.rejected > 0 or not counted or mode == "latest"  # where only the newest is kept
            except eitskin.NoFrame:
                served = False
            spent_s = time.monotonic() - began_s
        outcome.note(served, f"{what}: {frames.received} frames, {frames.rejected} rejected after {spent_s:.1f} s")
        outcome.figures["longest_deaf_s"] = max(outcome.figures.get("longest_deaf_s", 0.0), round(spent_s, 2))
