"""Clients of the control socket that send what no client should, all at once, beside one who asks and wants answers.

They leave the delimiter out, send parts without end, ask for references that take long, vanish before their answer, or
never read one. The honest client must get its own answer to every question, subscribers every frame; and at the end,
with a reference still being captured, SIGTERM ends the runtime.
"""

import random
import signal
import threading
from contextlib import suppress
from typing import Any

import msgpack
import zmq

from ..outcome import Effort, Outcome
from ..stream import PATIENCE_S, Stream, attacked

Draw = random.Random

WAITS: bytes = msgpack.packb({"command": "reference", "frames": 10_000})
STATUS: bytes = msgpack.packb({"command": "status"})


def malformed(draw: Draw) -> list[bytes]:
    """Return parts that are no request, or one in an envelope that nobody uses."""
    parts = [draw.randbytes(draw.randrange(40)) for _ in range(draw.choice([1, 1, 2, 3, 5, 20, 200]))]
    if draw.random() < 0.5:
        parts.insert(draw.randrange(len(parts) + 1), b"")
    if draw.random() < 0.3:
        parts.append(draw.choice([STATUS, WAITS, STATUS[:-1], msgpack.packb([1]), draw.randbytes(20_000)]))
    return parts


def rude(endpoint: str, draw: Draw, over: threading.Event) -> None:
    """Send malformed messages from one client after another, reading answers now and then."""
    context: Any = zmq.Context()
    while not over.is_set():
        socket = context.socket(draw.choice([zmq.DEALER, zmq.DEALER, zmq.ROUTER, zmq.REQ]))
        socket.connect(endpoint)
        with suppress(zmq.ZMQError):
            for _ in range(draw.randrange(1, 20)):
                socket.send_multipart(malformed(draw), zmq.NOBLOCK)
                if draw.random() < 0.3 and socket.poll(20):
                    socket.recv_multipart()
        socket.close(draw.choice([0, 50]))  # some vanish with what they wanted to say, some after it
    context.destroy(0)


def impatient(endpoint: str, draw: Draw, over: threading.Event) -> None:
    """Ask for references from many clients that never read."""
    context: Any = zmq.Context()
    sockets: list[Any] = []
    while not over.wait(0.01):
        socket = context.socket(zmq.DEALER)
        socket.connect(endpoint)
        for _ in range(draw.randrange(1, 8)):
            socket.send_multipart([b"", draw.choice([WAITS, WAITS, STATUS])], zmq.NOBLOCK)
        sockets.append(socket)
        if len(sockets) > 20:
            sockets.pop(draw.randrange(len(sockets))).close(0)
    context.destroy(0)


def honest(outcome: Outcome, stream: Stream, questions: int, draw: Draw, what: str) -> None:
    """Ask as an honest client; every answer must be the one to the question."""
    context: Any = zmq.Context()
    socket = context.socket(zmq.REQ)
    socket.connect(stream.control)
    for number in range(questions):
        name = f"no-command-{draw.randrange(10**9)}"  # the answer names it
        socket.send([STATUS, msgpack.packb({"command": name})][number % 2])
        if not socket.poll(PATIENCE_S * 1000):
            outcome.note(False, f"{what}: question {number} was not answered within {PATIENCE_S:g} s")
            break
        found = msgpack.unpackb(socket.recv())
        held = name in found.get("error", "") if number % 2 else "frames" in found
        outcome.note(held, f"{what}: question {number} got somebody else's answer: {found}")
    context.destroy(0)


def hostile_requests(effort: Effort) -> Outcome:
    """Attack the control socket of a stream."""
    outcome = Outcome("control.requests")
    with attacked(rate_hz=200.0) as stream:
        subscriber = stream.join()
        for attackers in ((rude, rude), (impatient, rude)):
            over = threading.Event()
            threads = [
                threading.Thread(target=attacker, args=(stream.control, Draw(f"{effort.seed}/{number}"), over))
                for number, attacker in enumerate(attackers)
            ]
            for thread in threads:
                thread.start()
            what = f"{attackers[0].__name__}, seed {effort.seed}"
            honest(outcome, stream, effort.count(100, 3000), Draw(effort.seed), what)
            over.set()
            for thread in threads:
                thread.join()
        found = subscriber.leave()
        outcome.frames_lost = found["lost"]
        outcome.figures |= {"frames": found["frames"], "longest_silence_s": found["longest_silence_s"]}
        stream.runtime.send_signal(signal.SIGTERM)
        status = stream.runtime.wait(PATIENCE_S)
        outcome.note(status == 0, f"SIGTERM while a reference is pending: status {status}")
    return outcome
