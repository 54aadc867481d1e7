"""A crowd of honest subscribers in one process, each with a connection of its own; says what each of them missed.

    python -m tests.attack.subscribers.crowd ENDPOINT NUMBER

Prints ``subscribed`` once every one has a frame; at SIGTERM one JSON object: members, fewest and most frames of a
member since then, lost (gaps in the frames' numbers, of all), ended (connections that the other side ended), the span
in seconds over which frames were counted, and the longest silence of any. One process reads for all, so on a busy
machine it is late itself; before it says how far the last is behind, it reads on until all have what the first had when
it was told to stop.
"""

import json
import selectors
import signal
import struct
import sys
import time
from typing import Any, Final

from ..zmtp.peer import Peer

NUMBER = b"\xa1n\xcf"
"""How MessagePack begins the key ``n`` and its uint64."""

CATCHES_UP_S: Final = 30.0
"""For how long members are read to what the first one had."""


class Member:
    """One subscriber."""

    def __init__(self, endpoint: str) -> None:
        self.peer = Peer(endpoint, patience_s=60)
        self.peer.subscribe(b"")
        self.frames = self.before = self.lost = self.last = 0
        self.heard_s = 0.0
        self.silent_s = 0.0

    def take(self) -> None:
        """Count what has arrived."""
        now_s = time.monotonic()
        for message in self.peer.taken():
            at = message.index(NUMBER, 0, 100) + len(NUMBER)
            (number,) = struct.unpack_from(">Q", message, at)
            if self.frames:
                self.lost += number - self.last - 1
                self.silent_s = max(self.silent_s, now_s - self.heard_s)
            self.frames += 1
            self.last, self.heard_s = number, now_s


def main() -> None:
    """Subscribe until told to stop."""
    endpoint, number = sys.argv[1], int(sys.argv[2])
    stopping, told, ended = False, False, 0

    def stop(*_: Any) -> None:
        nonlocal stopping
        stopping = True

    signal.signal(signal.SIGTERM, stop)
    began_s = time.monotonic()
    members: list[Member] = []
    joined_s = 0.0
    with selectors.DefaultSelector() as waiting:
        while not stopping:
            if len(members) < number:  # those who are there go on reading meanwhile, as processes of their own would
                members.append(Member(endpoint))
                waiting.register(members[-1].peer, selectors.EVENT_READ, members[-1])
                joined_s = time.monotonic() - began_s
            for key, _ in waiting.select(0.0 if len(members) < number else 0.1):
                try:
                    key.data.take()
                except OSError:
                    ended += 1
                    waiting.unregister(key.fileobj)
            if not told and len(members) == number and all(member.frames for member in members):
                told, began_s = True, time.monotonic()
                for member in members:
                    member.before = member.frames
                print("subscribed", flush=True)
        span_s = time.monotonic() - began_s
        counts = [member.frames - member.before for member in members]
        had, until_s = max(member.last for member in members), time.monotonic() + CATCHES_UP_S
        while min(member.last for member in members) < had and waiting.get_map() and time.monotonic() < until_s:
            for key, _ in waiting.select(0.1):
                try:
                    key.data.take()
                except OSError:
                    ended += 1
                    waiting.unregister(key.fileobj)
                else:
                    if key.data.last >= had:
                        waiting.unregister(key.fileobj)
    print(
        json.dumps(
            {
                "members": number,
                "fewest": min(counts),
                "most": max(counts),
                "lost": sum(member.lost for member in members),
                "behind": max(0, had - min(member.last for member in members)),
                "ended": ended,
                "joined_s": round(joined_s, 2),
                "span_s": round(span_s, 2),
                "longest_silence_s": round(max(member.silent_s for member in members), 3),
            }
        ),
        flush=True,
    )


if __name__ == "__main__":
    main()
