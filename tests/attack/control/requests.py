"""Clients of the control socket that send what no client should, all at once, beside one who asks and wants answers.

They leave the delimiter out, send parts without end, ask for references that take long, vanish before their answer, or
never read one. The honest client must get its own answer to every question, subscribers every frame; and at the end,
with a reference still being captured, SIGTERM ends the runtime within a second of its own.
"""

import random
import signal
import threading
import time
from collections.abc import Callable
from typing import Any

import msgpack
import zmq

import eitskin

from ..outcome import Effort, Outcome
from ..pace import ENOUGH
from ..shutdown.exit_time import MOST_S, end
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
        for _ in range(draw.randrange(1, 20)):
            try:
                socket.send_multipart(malformed(draw), zmq.NOBLOCK)
                if draw.random() < 0.3 and socket.poll(20):
                    socket.recv_multipart()
            except zmq.ZMQError:
                break
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


def answers(outcome: Outcome, endpoint: str, questions: int, draw: Draw, what: str) -> None:
    """Ask as an honest client; every answer must be the one to the question."""
    context: Any = zmq.Context()
    socket = context.socket(zmq.REQ)
    socket.connect(endpoint)
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


def _under(
    attackers: list[Callable[[str, Draw, threading.Event], None]], stream: Stream, outcome: Outcome, effort: Effort
) -> None:
    over = threading.Event()
    threads = [
        threading.Thread(target=attacker, args=(stream.control, Draw(f"{effort.seed}/{number}"), over))
        for number, attacker in enumerate(attackers)
    ]
    for thread in threads:
        thread.start()
    first = _frames(stream)
    name = attackers[0].__name__
    answers(outcome, stream.control, effort.count(100, 3000), Draw(effort.seed), f"{name}, seed {effort.seed}")
    while _frames(stream) < first + 2 * ENOUGH:
        time.sleep(0.05)
    over.set()
    for thread in threads:
        thread.join()


def _frames(stream: Stream) -> int:
    return int(eitskin.request(stream.control, "status", timeout_s=PATIENCE_S)["frames"])


def hostile_requests(effort: Effort) -> Outcome:
    """Attack the control socket of a stream."""
    outcome = Outcome("control.requests")
    with attacked(rate_hz=200.0) as stream:
        honest = stream.join()
        for attackers in ([rude, rude], [impatient, rude]):
            _under(attackers, stream, outcome, effort)
        found = honest.leave()
        outcome.frames_lost = found["lost"]
        outcome.note_pace(found["pace"], "while requests came")
        outcome.figures |= {"frames": found["frames"], "longest_silence_s": found["longest_silence_s"]}
        took = end(stream.runtime.pid, signal.SIGTERM)
        held = took is not None and took.own_s <= MOST_S and stream.runtime.wait(PATIENCE_S) == 0
        outcome.note(held, f"SIGTERM while a reference is pending: {took}, status {stream.runtime.poll()}")
        outcome.figures["exit_own_s"] = None if took is None else round(took.own_s, 3)
    return outcome
