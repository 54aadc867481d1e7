"""Attacks by connecting faster than anybody looks, where descriptors are many and where they are few."""

import os
import random
import signal
import tempfile
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any

from ..outcome import Effort, Outcome
from ..stream import Stream, attacked
from ..zmtp import flood
from ..zmtp.peer import Peer
from .ground import TOUCHED, defended, ends, everywhere, stoppable_skin

MANY_TOPICS = [b"t%d" % index for index in range(600)]

AT_ONCE = 1500
"""Connections while nobody looks."""


def connect_floods(effort: Effort) -> Outcome:
    """Connect as fast as it goes, beside a subscriber of 600 topics; and while the device is silent; then SIGTERM."""
    outcome = Outcome("subscribers.connections")
    rng = random.Random(effort.seed)
    with everywhere() as places:
        for what, arguments, keys in places:
            for _ in range(effort.count(1, 7)):
                with (
                    defended(outcome, f"{what}, seed {effort.seed}", keys, arguments) as stream,
                    _many_topics(stream, keys),
                ):
                    made = flood.connect(stream.frames, effort.count(2, 5), rng)
                    outcome.figures[f"{what}, connections"] = made + outcome.figures.get(f"{what}, connections", 0)
                with (
                    stoppable_skin(**TOUCHED) as (port, skin),
                    attacked(*arguments, port=port) as stream,
                ):
                    stream.join(*keys)
                    with _many_topics(stream, keys):
                        os.kill(skin, signal.SIGSTOP)
                        flood.connect(stream.frames, 0.4, rng, AT_ONCE, AT_ONCE)
                        ends(stream, outcome, f"{what}, the device silent")
    return outcome


def few_descriptors(effort: Effort) -> Outcome:
    """Use up the files that a runtime may open, while it publishes and while its reference is captured."""
    outcome = Outcome("subscribers.descriptors")
    rng = random.Random(effort.seed)
    for files in (64, 128, 256)[: effort.count(1, 3)]:
        for _ in range(effort.count(1, 6)):
            _tcp_beside_ipc(files, outcome, rng, effort.count(2, 8))
    for files in (64, 1024, 256)[: effort.count(2, 3)]:
        for what, arguments in (("ipc", ()), ("TCP", ("--publish", "tcp://127.0.0.1:*"))):
            for _ in range(effort.count(1, 4)):
                with defended(outcome, f"{files} files, {what}", arguments=arguments, files=files) as stream:
                    flood.connect(stream.frames, effort.count(1, 5), rng, 1500)
        for _ in range(effort.count(1, 4)):
            _during_capture(files, outcome, rng)
    return outcome


def _tcp_beside_ipc(files: int, outcome: Outcome, rng: random.Random, span_s: float) -> None:
    """Flood frames on TCP and, at once, control on ipc, where libzmq aborts if a connection finds no descriptor."""
    what, where = f"{files} files, TCP beside ipc", ("--publish", "tcp://127.0.0.1:*")
    with defended(outcome, what, arguments=where, files=files) as stream:
        flood.side_by_side(
            [
                lambda: flood.connect(stream.frames, span_s, rng, 1500),
                lambda: flood.connect(stream.frames, span_s, rng, 1500),
                lambda: flood.connect(stream.control, span_s, rng, 40),
            ]
        )


def _during_capture(files: int, outcome: Outcome, rng: random.Random) -> None:
    """Flood the publishing and the control socket from the first instant on."""
    with tempfile.TemporaryDirectory(prefix="a") as name:
        folder = Path(name)
        over = threading.Event()

        def flooded(path: Path) -> None:
            while not over.is_set():
                flood.connect(f"ipc://{path}", 0.2, rng, 1500)

        where = ["--publish", f"ipc://{folder}/f", "--control", f"ipc://{folder}/c"]
        options: dict[str, Any] = {**TOUCHED, "touches": []}
        with flood.meanwhile(lambda: flooded(folder / "f")), flood.meanwhile(lambda: flooded(folder / "c")):
            try:
                with attacked("--reference-frames", "300", files=files, endpoints=where, **options) as stream:
                    over.set()
                    found = stream.join().leave()
                    outcome.frames_lost += found["lost"]
                    alive = stream.runtime.poll() is None
                    outcome.note(alive and found["frames"] > 0, f"{files} files, capture: {found}")
            except RuntimeError as error:
                outcome.note(False, f"{files} files, capture: {error}")
            finally:
                over.set()


@contextmanager
def _many_topics(stream: Stream, keys: tuple[str, ...]) -> Iterator[None]:
    """Hold a connection that has 600 topics, as far as it gets; with keys there is none."""
    if keys:
        yield
        return
    with closing(Peer(stream.frames)) as peer:
        with suppress(OSError):
            peer.subscribe(*MANY_TOPICS)
        yield
