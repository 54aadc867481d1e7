"""Attacks on the bytes: damage, floods, and intact packets that are no frames. What was sent whole is published.

Every episode of damage has a seed of its own; ``damage`` names the first that failed, and
``{"do": "damage", "seed": S, "only": N}`` is that episode over and over.
"""

from ..outcome import Effort, Outcome
from .trial import attack


def damage(effort: Effort) -> Outcome:
    """Episodes of damage: what is not whole is never published, what is always, and both are counted."""
    episodes = effort.count(60, 4000)
    with attack("device.damage", rate_mHz=400_000) as (running, outcome):
        frames = 8 * min(episodes, 500)
        for part in range(-(-episodes // 500)):
            said = running.endure(outcome, do="damage", seed=effort.seed * 100 + part, frames=frames, seconds=300)
        outcome.figures["episodes"] = len(said["episodes"])
    return outcome


def floods(effort: Effort) -> Outcome:
    """Bytes without an end, ends without bytes, noise; nothing gets through, then everything again.

    Without ``--reconnect`` a flood of seconds ends the runtime with a line that says so.
    """
    with attack("device.floods", "--reconnect", "60") as (running, outcome):
        for kind in ("flood", "ends", "garbage"):
            seconds = effort.count(1, 8)
            running.endure(outcome, uncounted=2000, do=kind, seed=effort.seed, seconds=seconds, frames=10**6)
    return outcome


def foreign(effort: Effort) -> Outcome:
    """Intact packets of every type and length between the frames; nothing happens."""
    frames = effort.count(80, 1200)
    with attack("device.foreign") as (running, outcome):
        for kind in ("lengths", "foreign", "torrent", "greeting"):
            running.endure(outcome, do=kind, seed=effort.seed, frames=frames, seconds=120)
        for maker in ("unknown", "misshapen", "answer", "event", "greeting", "request", "frame_like") * effort.long:
            running.endure(outcome, do="foreign", makers=[maker], seed=effort.seed, frames=frames, seconds=120)
    return outcome
