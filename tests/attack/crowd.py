"""Honest subscribers in one process, each with a connection of its own; says what they got when it is ended.

    python -m tests.attack.crowd ENDPOINT NUMBER [SERVER.key CLIENT.key_secret]

Prints ``subscribed`` once each has a frame. At SIGTERM it reads until all have what the first one has, and prints a
JSON object: the fewest frames of one, lost (gaps in the frames' numbers, of all), how far the last is behind the first,
and the longest silence of any in seconds.
"""

import json
import signal
import struct
import sys
import time
from typing import Any, Final

import zmq

from eitskin.messaging.curve_keys import load_client_keys

NUMBER: Final = b"\xa1n\xcf"
"""How MessagePack begins the key ``n`` and its uint64."""

CATCHES_UP_S: Final = 30.0


class Member:
    """One subscriber."""

    def __init__(self, socket: Any) -> None:
        self.socket = socket
        self.frames = self.lost = self.last = 0
        self.heard_s = self.silent_s = 0.0

    def take(self) -> None:
        """Count one message."""
        message, now_s = self.socket.recv(), time.monotonic()
        (number,) = struct.unpack_from(">Q", message, message.index(NUMBER, 0, 100) + len(NUMBER))
        if self.frames:
            self.lost += number - self.last - 1
            self.silent_s = max(self.silent_s, now_s - self.heard_s)
        self.frames += 1
        self.last, self.heard_s = number, now_s


def main() -> None:
    """Subscribe until SIGTERM."""
    endpoint, number, *files = sys.argv[1:]
    stopping: list[int] = []
    signal.signal(signal.SIGTERM, lambda *_: stopping.append(1))
    context: Any = zmq.Context()
    members: dict[Any, Member] = {}
    poller = zmq.Poller()
    for _ in range(int(number)):
        socket = context.socket(zmq.SUB)
        if files:
            load_client_keys(*files).apply(socket)
        socket.rcvhwm = 0  # a process that reads for many is late itself, and loses nothing
        socket.subscribe(b"")
        socket.connect(endpoint)
        poller.register(socket, zmq.POLLIN)
        members[socket] = Member(socket)

    def read() -> None:
        for socket, _ in poller.poll(100):
            members[socket].take()

    waits = True
    while not stopping:
        read()
        if waits and all(member.frames for member in members.values()):
            waits = False
            print("subscribed", flush=True)
    had, until_s = max(member.last for member in members.values()), time.monotonic() + CATCHES_UP_S
    while min(member.last for member in members.values()) < had and time.monotonic() < until_s:
        read()
    found = {
        "frames": min(member.frames for member in members.values()),
        "lost": sum(member.lost for member in members.values()),
        "behind": max(0, had - min(member.last for member in members.values())),
        "longest_silence_s": round(max(member.silent_s for member in members.values()), 3),
    }
    context.destroy(0)
    print(json.dumps(found), flush=True)


if __name__ == "__main__":
    main()
