"""The device as a process on a pseudo terminal: prints its port, then obeys one JSON object a line.

    python -m tests.attack.device.process '{"port": "/tmp/x/port", "rate_mHz": 200000}'

Commands: ``{"do": NAME, "seed": N, "seconds": S, ...}`` attacks the line for so long and prints one line about it (see
``hostile``); ``{"do": "report"}`` prints what was sent so far, ``{"do": "sent"}`` when each whole frame of it was.
"""

import json
import os
import select
import sys
import time
import tty
from collections import Counter, defaultdict, deque
from contextlib import suppress
from typing import Any

from . import codec
from .device import Device, Options

BACKLOG: int = 1 << 22
"""Bytes that wait for the host; what comes beyond is dropped by the device and counted."""


class Line:
    """A pseudo terminal whose name is a link, so that it can vanish and come back."""

    def __init__(self, link: str) -> None:
        self.link = link
        self.master = self._slave = -1
        self.waiting = bytearray()
        self.pushed = 0
        """Bytes that were written so far, or given up."""
        self.open()

    def open(self) -> None:
        """Appear."""
        self.master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self.master, False)
        os.symlink(os.ttyname(self._slave), self.link)

    def close(self) -> None:
        """Vanish."""
        with suppress(FileNotFoundError):
            os.unlink(self.link)
        for fd in (self.master, self._slave):
            os.close(fd)
        self.master = self._slave = -1
        self.pushed += len(self.waiting)
        self.waiting.clear()

    @property
    def there(self) -> bool:
        """Whether it can be opened."""
        return self.master >= 0

    def push(self) -> None:
        """Write what waits, as far as the host takes it."""
        with suppress(BlockingIOError):
            while self.waiting:
                written = os.write(self.master, self.waiting[:4096])
                self.pushed += written
                del self.waiting[:written]

    def read(self) -> bytes:
        """Return what the host sent, perhaps nothing."""
        try:
            return os.read(self.master, 65536)
        except OSError:  # nothing yet, or nobody has it open
            return b""


class Machine:
    """A device on a line, and what was really sent of it."""

    def __init__(self, options: dict[str, Any]) -> None:
        self.line = Line(options.pop("port"))
        self.device = Device(Options(**options))
        self.host = codec.Collector()
        self.requests: Counter[int] = Counter()
        self._sent = codec.Collector()
        """Reads the line as a host must: the judge of which frames were sent whole."""
        self.scans: dict[int, bytes] = {}
        """Payload of each scan that was made, by its sequence number."""
        self.whole: Counter[int] = Counter()
        self.sent_ns: defaultdict[int, list[tuple[int, int]]] = defaultdict(list)
        """When each of them was made and when it was on the line, once or more."""
        self._under_way: deque[tuple[int, int, int]] = deque()
        """Of what waits to be written, behind how many bytes it ends, its number, and when it was made."""
        self.made = 0
        self.last = self.frozen = b""
        """The newest scan's payload; one that is sent over and over."""
        self.episodes: list[tuple[int, int, list[str]]] = []
        """Number, first sequence number and ways of each episode of damage."""
        self.changed: Any = None
        """What an attack does instead of sending (see ``hostile.Attack``)."""

    def put(self, data: bytes) -> None:
        """Send bytes as they are, and note which frames a host can read of them; without a port they are gone."""
        end = self.line.pushed + len(self.line.waiting) + len(data)
        for payload in self._sent.feed(data):
            if payload[0] == codec.FRAME and len(payload) >= 12:
                sequence = int.from_bytes(payload[8:12], "little")
                if self.scans.get(sequence) == payload:
                    self.whole[sequence] += 1
                    self._under_way.append((end, sequence, time.monotonic_ns()))
        if self.line.there:
            self.line.waiting += data

    def send(self, payload: bytes) -> None:
        """Send a payload, by way of the attack if there is one."""
        if self.changed is None or not self.changed.send(payload):
            self.put(codec.packet(payload))

    def scan(self, frame: codec.Frame) -> None:
        """Send a scan."""
        payload = self.last = frame.payload()
        self.scans[frame.sequence % 2**32] = payload
        self.made += 1
        if len(self.line.waiting) > BACKLOG:
            self.device.dropped += 1
            return
        self.send(payload)

    def restart(self) -> None:
        """Boot again, unasked; the account begins anew, as the numbers do."""
        self.scans.clear()
        self.whole.clear()
        self.sent_ns.clear()
        self._under_way.clear()
        for payload in self.device.boot():
            self.put(codec.packet(payload))

    def step(self) -> None:
        """Wait for what comes next, a request or the end of a scan, and serve it."""
        wait_s = 0.02
        if self.device.streaming:
            wait_s = min(wait_s, max(0.0, self.device.next_s - time.monotonic()))
        reads = [sys.stdin, *([self.line.master] if self.line.there else [])]
        writes = [self.line.master] if self.line.there and self.line.waiting else []
        found, _, _ = select.select(reads, writes, [], wait_s)
        if self.line.there:
            if self.line.master in found:
                for payload in self.host.feed(self.line.read()):
                    self.requests[payload[0]] += 1
                    if self.changed is None or not self.changed.request(payload):
                        for answer in self.device.receive(payload):
                            self.send(answer)
            for frame in self.device.due():
                self.scan(frame)
            if self.changed is not None:
                self.changed.idle()
            self.line.push()
            while self._under_way and self._under_way[0][0] <= self.line.pushed:
                _, sequence, made_ns = self._under_way.popleft()
                self.sent_ns[sequence].append((made_ns, time.monotonic_ns()))
        elif self.changed is not None:
            self.changed.idle()
        if sys.stdin in found:
            self.obey(sys.stdin.readline())

    def obey(self, line: str) -> None:
        """Do what a line on standard input says."""
        if not line:
            raise EOFError
        order = json.loads(line)
        if order["do"] == "report":
            self.tell()
        elif order["do"] == "sent":
            print(json.dumps(list(self.sent_ns.items())), flush=True)
        else:
            from .hostile import begin

            self.changed = begin(self, order)

    def done(self) -> None:
        """End the attack and say so."""
        self.changed = None
        self.tell()

    def tell(self) -> None:
        """Print what was sent: numbers of scans that were made, and how often each was sent whole."""
        held = {
            "next": self.device.sequence,
            "made": self.made,
            "episodes": self.episodes,
            "whole": sorted(self.whole.items()),
            "scans": sorted(self.scans),
            "damaged": self._sent.damaged,
            "requests": {f"0x{kind:02x}": count for kind, count in sorted(self.requests.items())},
            "damaged_requests": self.host.damaged,
        }
        print(json.dumps(held), flush=True)


def main() -> None:
    """Run until standard input ends."""
    machine = Machine(json.loads(sys.argv[1]))
    print(machine.line.link, flush=True)
    try:
        with suppress(EOFError, KeyboardInterrupt):
            while True:
                machine.step()
    finally:
        if machine.line.there:
            machine.line.close()


if __name__ == "__main__":
    main()
