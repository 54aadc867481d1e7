"""What every attack on subscribers stands on: a stream with an honest subscriber, and what must be true afterwards."""

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import eitskin

from ..outcome import Outcome
from ..shutdown.moments import MOST_S
from ..stream import PATIENCE_S, Stream, attacked

TOUCHED = {"rate_hz": 200.0, "touches": [[1.0, 1e9, 0.3]]}
"""What the virtual skin does: every frame is touched, and so computed."""

ENOUGH = 100
"""Frames after an attack, by which it shows who still gets them."""


def status(stream: Stream) -> dict[str, Any]:
    """Return the runtime's counters."""
    return eitskin.request(stream.control, "status", timeout_s=PATIENCE_S)


@contextmanager
def defended(
    outcome: Outcome, what: str, keys: Sequence[str] = (), arguments: Sequence[str] = (), **options: Any
) -> Iterator[Stream]:
    """Run a stream with an honest subscriber, and note whether it was served all the while, and a newcomer after it.

    Args:
        outcome: Where it is noted.
        what: Is attacked.
        keys: Files of the honest subscriber's keys.
        arguments: Further options of ``eitskin run``.
        options: Of :func:`attacked` and of the virtual skin.
    """
    with attacked(*arguments, **{**TOUCHED, **options}) as stream:
        honest = stream.join(*keys)
        before = status(stream)
        yield stream
        if stream.runtime.poll() is not None:
            outcome.note(False, f"{what}: the runtime ended with {stream.runtime.returncode}: {stream.said()[-200:]}")
            return
        after = later = status(stream)
        while later["frames"] < after["frames"] + ENOUGH:
            later = status(stream)
        computed, published = (later[name] - before[name] for name in ("frames", "published"))
        stream.join(*keys)
        found = [one.leave() for one in stream.honest]
        outcome.frames_lost += sum(one["lost"] for one in found)
        served = abs(published - computed) <= 1 and found[0]["frames"] >= published
        outcome.note(
            served and not any(one["lost"] for one in found) and honest is stream.honest[0],
            f"{what}: {computed} frames computed, {published} published, subscribers {found}",
        )


def ends(stream: Stream, outcome: Outcome, what: str) -> None:
    """Note whether SIGTERM ends a runtime."""
    began_s = time.monotonic()
    stream.runtime.terminate()
    code = stream.runtime.wait(PATIENCE_S)
    took_s = time.monotonic() - began_s
    outcome.figures["slowest_end_s"] = round(max(outcome.figures.get("slowest_end_s", 0.0), took_s), 3)
    outcome.note(took_s <= MOST_S and code == 0, f"{what}: ended with {code} after {took_s:.1f} s")
