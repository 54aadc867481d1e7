"""Attacks by coming and going: ask for a hundred topics, leave, and come again, without end."""

import random
import time

from ..outcome import Effort, Outcome
from ..stream import Stream
from ..zmtp import flood
from ..zmtp.churn import Churn
from .ground import defended, everywhere, memory_mib, status
from .topics import GROWTH_MIB


def churns(effort: Effort) -> Outcome:
    """Come as often as one process can, greet, ask for much and leave, in every form; and come honestly meanwhile."""
    outcome = Outcome("subscribers.churn")
    rng = random.Random(effort.seed)
    span_s = effort.count(3, 30)
    with everywhere() as places:
        for what, arguments, keys in places:
            with defended(outcome, f"{what}, seed {effort.seed}", keys, arguments) as stream:
                before = memory_mib(stream)
                comings = Churn(stream.frames, span_s, rng)
                with flood.meanwhile(comings.run):
                    began_s = time.monotonic()
                    most, silent_s = _watch(stream, began_s + span_s / 3)
                    came_s = time.monotonic()
                    stream.join(*keys)
                    waited_s = time.monotonic() - came_s
                    found = _watch(stream, began_s + span_s)
                grown = max(most, found[0]) - before
                outcome.figures[f"{what}, comings/s"] = round(comings.made / span_s)
                outcome.figures[f"{what}, MiB grown"] = round(grown, 1)
                outcome.figures[f"{what}, control silent for s"] = round(max(silent_s, found[1]), 2)
                outcome.figures[f"{what}, a newcomer's first frame after s"] = round(waited_s, 1)
                outcome.note(grown < GROWTH_MIB, f"{what}: {comings.made} comings left {grown:.0f} MiB in memory")
    return outcome


def _watch(stream: Stream, until_s: float) -> tuple[float, float]:
    """Return the most memory in MiB until then, and the longest time in seconds that control took to answer."""
    most = longest_s = 0.0
    while True:
        asked_s = time.monotonic()
        status(stream)
        now_s = time.monotonic()
        longest_s = max(longest_s, now_s - asked_s)
        most = max(most, memory_mib(stream))
        if now_s > until_s:
            return most, longest_s
        time.sleep(0.02)
