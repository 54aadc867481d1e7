"""Many sequences, and the shortest form of one that fails."""

import random
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from tests.faults.requests.player import Player, Verdict
from tests.faults.requests.steps import Step, draw

Fresh = Callable[[int], Any]
"""Makes a fresh device; the number is a seed."""


@dataclass
class Figures:
    """Of many sequences."""

    sequences: int = 0
    with_confirmed: int = 0
    """Sequences in which something was confirmed."""
    requests: int = 0
    cuts: int = 0
    """Power cuts after which it went on."""
    images: int = 0
    """States of storage that were booted: torn and whole, at every change."""
    breaches: int = 0
    """Sequences with a moment that left no bootable confirmed configuration."""
    differing: int = 0
    """Sequences with an answer or a boot that is not SPEC.md's."""
    seconds: float = 0.0
    seed: int = 0
    lost: list[str] = field(default_factory=list)
    """The first few that broke the promise or SPEC.md, each with its number and its shortest form."""

    def as_dict(self) -> dict[str, Any]:
        """Return it for one JSON object."""
        return {**self.__dict__, "seconds": round(self.seconds, 1)}


def sequence(seed: int, number: int) -> list[Step]:
    """Return the sequence of this number."""
    return draw(random.Random(seed * 1_000_003 + number))


def play(fresh: Fresh, steps: list[Step], seed: int = 1) -> tuple[Verdict, Any]:
    """Play a sequence on a fresh device; return what came of it, and the device, switched off."""
    line = fresh(seed)
    try:
        return Player(line).play(steps), line
    finally:
        line.close()


def shorten(fails: Callable[[list[Step]], bool], steps: list[Step]) -> list[Step]:
    """Return the shortest part of a failing sequence that still fails: no step of it can be left out."""
    size = len(steps)
    while size:
        at = 0
        while at < len(steps):
            part = steps[:at] + steps[at + size :]
            if fails(part):
                steps = part
            else:
                at += size
        size = size // 2 if size > 1 else 0
    return steps


def search(fresh: Fresh, count: int, seed: int = 0, keep: int = 3) -> Figures:
    """Play sequences and return the figures.

    Args:
        fresh: Makes a fresh device.
        count: How many.
        seed: Of all of them; the same seed plays the same sequences.
        keep: How many failing ones are shortened and told.
    """
    figures, began_s = Figures(seed=seed), time.perf_counter()
    for number in range(count):
        steps = sequence(seed, number)
        verdict, line = play(fresh, steps, number)
        figures.sequences += 1
        figures.with_confirmed += verdict.confirmed
        figures.requests += verdict.requests
        figures.cuts += verdict.cuts
        figures.images += line.images
        figures.breaches += bool(verdict.lost)
        figures.differing += bool(verdict.differs)
        for kind in ("lost", "differs"):
            if getattr(verdict, kind) and len(figures.lost) < keep:
                figures.lost.append(_described(fresh, kind, steps, seed, number))
    figures.seconds = time.perf_counter() - began_s
    return figures


def _described(fresh: Fresh, kind: str, steps: list[Step], seed: int, number: int) -> str:
    def what(part: list[Step]) -> str:
        return str(getattr(play(fresh, part, number)[0], kind))

    said = what(steps)
    if not said:
        return f"seed {seed}, sequence {number}: failed once and not again: {steps}"
    short = shorten(lambda part: bool(what(part)), steps)
    return f"seed {seed}, sequence {number}: {what(short) or said}; shortest: {short}"
