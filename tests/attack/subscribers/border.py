"""Attacks at the border: clients that hold connections, crawl, die or use up files cost no frame."""

import random
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager, suppress

from eitskin.messaging.curve_keys import make_keys

from ..outcome import Effort, Outcome
from ..stream import ROOT, Stream, attacked, virtual_skin
from ..zmtp.peer import GREETING, Peer, attempt, connected, packed, ready
from .ground import TOUCHED, defended, ends, status

TOPICS = (b"", b"\xde", b"\xde\x00", b"eitskin/region/whole", b"eitskin/unchanged", b"eitskin/always")

OPENINGS = (b"", GREETING[:10], GREETING, GREETING + ready("SUB"), GREETING + ready("SUB") + packed(b"\x01x"))
"""What a connection says before it says nothing more."""

HELD = 300
"""Connections that are held at a time: more than are served."""


def held(effort: Effort) -> Outcome:
    """Hold more connections than are served, silent or half greeted; crawl; die amid a frame; with few files too."""
    outcome = Outcome("subscribers.held")
    rng = random.Random(effort.seed)
    for files in (None, 256, 128)[: effort.count(2, 3)]:
        for what, attack in (("held", _hold), ("crawling", _crawl), ("dying", _die)):
            with defended(outcome, f"{what}, {files or 'many'} files, seed {effort.seed}", files=files) as stream:
                for _ in range(effort.count(1, 10)):
                    attack(stream, rng)
                _wait_for_frames(stream, effort.count(100, 1000))
    return outcome


def _hold(stream: Stream, rng: random.Random) -> None:
    with ExitStack() as stack:
        for _ in range(HELD):
            with suppress(OSError):
                one = stack.enter_context(connected(stream.frames, 0.02))
                one.send(rng.choice(OPENINGS))
        _wait_for_frames(stream, 100)


def _crawl(stream: Stream, rng: random.Random) -> None:
    """Subscribe to everything, and read a byte now and then."""
    with ExitStack() as stack:
        crawlers = [stack.enter_context(closing(Peer(stream.frames))) for _ in range(8)]
        for one in crawlers:
            one.subscribe(*TOPICS)
        for _ in range(100):
            for one in crawlers:
                one.stream.recv(1)
            time.sleep(0.01 * rng.random())


def _die(stream: Stream, rng: random.Random) -> None:
    """Be killed while frames come."""
    program = "import eitskin, sys\nfor frame in eitskin.subscribe(sys.argv[1], 'all', timeout_s=60): print(flush=True)"
    for _ in range(2):
        with subprocess.Popen(
            [sys.executable, "-c", program, stream.frames], stdout=subprocess.PIPE, cwd=ROOT
        ) as process:
            assert process.stdout is not None
            process.stdout.readline()
            time.sleep(0.1 * rng.random())
            process.kill()


def without_keys(effort: Effort) -> Outcome:
    """Connect by TCP without a key, as fast as it goes, and hold; beside a subscriber that has one; then SIGTERM."""
    outcome = Outcome("subscribers.without-keys")
    rng = random.Random(effort.seed)
    with tempfile.TemporaryDirectory(prefix="k") as folder:
        make_keys(folder)
        keys = (f"{folder}/server.key", f"{folder}/client.key_secret")
        tcp = ("--publish", "tcp://127.0.0.1:*", "--curve-keys", folder)
        for what in ("many files", "1024 files"):
            files = None if what == "many files" else 1024
            with defended(outcome, f"{what}, seed {effort.seed}", keys, tcp, files=files) as stream:
                made = _connect(stream.frames, effort.count(2, 20), rng)
            outcome.figures[f"{what}, connections"] = made
        with virtual_skin(**TOUCHED) as port, attacked(*tcp, port=port) as stream:
            stream.join(*keys)
            with _meanwhile(lambda: _connect(stream.frames, 1.0, rng)):
                time.sleep(0.5)
                ends(stream, outcome, "amid a flood")
    return outcome


def _connect(endpoint: str, span_s: float, rng: random.Random) -> int:
    """Connect again and again, hold the newest and say anything; return how often."""
    mine: list[socket.socket] = []
    made, end_s = 0, time.monotonic() + span_s
    while time.monotonic() < end_s:
        if (stream := attempt(endpoint)) is None:
            time.sleep(0.02)
            continue
        made += 1
        mine.append(stream)
        with suppress(OSError):
            stream.send(rng.choice(OPENINGS))
        if len(mine) > HELD:
            mine.pop(0).close()
    for stream in mine:
        stream.close()
    return made


@contextmanager
def _meanwhile(work: Callable[[], object]) -> Iterator[None]:
    """Do something in a thread beside the body."""
    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield
    finally:
        thread.join()


def _wait_for_frames(stream: Stream, number: int) -> None:
    first = status(stream)["frames"]
    while status(stream)["frames"] < first + number:
        time.sleep(0.05)
