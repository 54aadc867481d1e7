"""Silence, half packets, late and double answers, restarts, ports that vanish, and SIGTERM in the middle of it all."""

import random
import time
from typing import Any, Final

from ..outcome import Effort, Outcome
from ..shutdown.exit_time import MOST_S
from .trial import RECOVERS_S, attack, trial

WAITS: Final = ("--reconnect", "60")


def answers(effort: Effort) -> Outcome:
    """Answers that come late, twice, with wrong tags or never, also while it is greeted."""
    frames = effort.count(100, 600)
    with attack("device.answers", *WAITS) as (running, outcome):
        running.endure(outcome, do="pause", seed=effort.seed, frames=frames)
        running.endure(outcome, do="deaf", frames=frames)
        for kind in ("late", "twice", "tagged")[: effort.count(2, 3)]:
            # Frames between START and its late answer are nobody's, and may be left out.
            running.endure(
                outcome, exact=kind != "late", do="late", kind=kind, restarted=True, frames=frames, seconds=20
            )
        running.endure(outcome, do="mute", seconds=2, frames=10**6)
    return outcome


def restarts(effort: Effort) -> Outcome:
    """Restarts, one or many in a row, and a port that vanishes in the middle of a packet and comes back."""
    with attack("device.restarts", *WAITS) as (running, outcome):
        for _ in range(effort.count(1, 5)):
            running.endure(outcome, do="restart", times=1)
            running.endure(outcome, do="restart", times=effort.count(3, 40), apart_s=0.05, seconds=60)
            running.endure(outcome, do="vanish", seconds=0.05)
            running.endure(outcome, do="vanish", seconds=effort.count(1, 8))
    return outcome


def hangs(effort: Effort) -> Outcome:
    """A device that hangs with its port there for longer than a greeting waits: ``--reconnect`` waits for it."""
    with attack("device.hangs", *WAITS) as (running, outcome):
        for kind in ("mute", "unheard", "deaf")[: effort.count(1, 3)]:
            running.endure(
                outcome, do=kind, restarted=True, seconds=effort.count(8, 20), frames=10**6, within_s=2 * RECOVERS_S
            )
    return outcome


def terminated(effort: Effort) -> Outcome:
    """SIGTERM at a random moment of an attack ends it, with status 0 and no traceback."""
    outcome = Outcome("device.terminated")
    draw = random.Random(effort.seed)
    orders: tuple[dict[str, Any], ...] = (
        {"do": "flood"},
        {"do": "mute"},
        {"do": "torrent"},
        {"do": "vanish", "seconds": 30},
        {"do": "restart", "times": 1000, "apart_s": 0.02},
        {"do": "garbage"},
        {"do": "mute", "restarted": True},
        {"do": "heads", "field": "generation", "values": [77], "share": 1.0},
        {"do": "damage", "seed": effort.seed},
        {"do": "ends"},
    )
    times = []
    for turn in range(effort.count(3, 20)):
        order = orders[turn % len(orders)]
        with trial(*WAITS, learn=False) as running:
            running.device.start(**({"frames": 10**6, "seconds": 60} | order))
            time.sleep(draw.uniform(0, 3.0))  # the moment is what is drawn; nothing is waited for
            took, status = running.ends(), running.stream.runtime.poll()
            said = running.stream.said()
            held = took.own_s <= MOST_S and status == 0 and "Traceback" not in said
            times.append(took)
            outcome.note(held, f"seed {effort.seed}, turn {turn}, {order}: {took}, {status}, {said[-200:]!r}")
    outcome.figures["longest_own_s"] = round(max(one.own_s for one in times), 3)
    outcome.figures["longest_by_the_clock_s"] = round(max(one.raw_s for one in times), 3)
    return outcome
