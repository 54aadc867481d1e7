"""Attacks on what comes over the line. What was sent whole is published once, as it was measured; nothing else is.

Every stream is opened on a device in this process, captures its reference, is attacked, and is then left alone. A
frame's content follows from its sequence number, so the gate's value says whether a frame holds what was measured.
"""

import math
import random
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from typing import Final

import numpy as np

from eitskin.errors import PortLost, SkinError
from eitskin.messaging.frame import Frame as Published
from eitskin.skin import Skin

from ..outcome import Effort, Outcome
from ..stream import TINY
from .damage import WAYS, Reader, foreign, packet
from .line import FLAT, HELLO, PATTERNS, Line

REFERENCE: Final = 20
HONEST: Final = 80
"""Scans before and after an attack that are as they should be: all of them are published."""

Send = Callable[[Line, bytes], bytes]
"""What goes on the line in place of a scan's payload."""


@dataclass
class Seen:
    """What was sent, and what became of it."""

    made: dict[int, bytes] = field(default_factory=dict)
    whole: list[int] = field(default_factory=list)
    """Sequence numbers of the frames that a host can read, as often as they were sent."""
    published: list[Published] = field(default_factory=list)
    damaged: int = 0
    corrupt: int = 0
    error: str = ""

    def wrong(self, exact: bool, content: bool) -> list[str]:
        """Return what did not hold.

        Args:
            exact: Whether just what was sent whole must be published, and all damage counted.
            content: Whether what is published must be what was measured.
        """
        found = [self.error] if self.error else []
        sequences = [frame.sequence % 2**32 for frame in self.published]
        expected = list(dict.fromkeys(self.whole))
        if exact and sequences != expected:
            missing, extra = set(expected) - set(sequences), set(sequences) - set(expected)
            found.append(f"missing {sorted(missing)[:5]}, never sent whole {sorted(extra)[:5]}, or not in order")
        if exact and self.corrupt != self.damaged:
            found.append(f"{self.corrupt} counted as corrupt, {self.damaged} sent damaged")
        if sequences[-HONEST // 2 :] != self.whole[-HONEST // 2 :]:  # before that a pattern may come again too soon
            found.append("after the attack frames were missing")
        for frame in self.published:
            if not (np.isfinite(frame.map).all() and math.isfinite(frame.gate_logit)):
                found.append(f"frame {frame.sequence} holds what is not finite")
            elif content and frame.gate_logit != honest_logits()[frame.sequence % PATTERNS]:
                found.append(f"frame {frame.sequence}: gate {frame.gate_logit}")
        return found[:3]


@cache
def honest_logits() -> dict[int, float]:
    """Return the gate's value of every pattern."""
    seen = stream(lambda _, payload: packet(payload), PATTERNS)
    return {frame.sequence % PATTERNS: frame.gate_logit for frame in seen.published}


def stream(send: Send, scans: int, line: Line | None = None) -> Seen:
    """Attack a stream for so many scans; return what came of those, and of the honest ones around them."""
    seen, reader, captured = Seen(), Reader(), False
    first, last = REFERENCE + HONEST, REFERENCE + HONEST + scans

    def account(line: Line, number: int) -> bytes:
        if not first <= number < last:
            payload = line.payload()
            data = b"\0" * (number == last) + packet(payload)
        else:
            payload = line.payload()
            data = send(line, payload)
        seen.made[int.from_bytes(payload[8:12], "little")] = payload
        for found in reader.feed(data):
            sequence = int.from_bytes(found[8:12], "little")
            if captured and seen.made.get(sequence) == found:
                seen.whole.append(sequence)
        return data

    line = line or Line(account)
    line.send, line.clocked, line.scans_left = account, False, last + HONEST
    try:
        with Skin(line, bundle=TINY, skip_unchanged=False) as skin:
            skin.capture_reference(REFERENCE)
            captured = True
            with suppress(PortLost):  # when all is sent
                seen.published.extend(skin.frames())
            seen.corrupt = skin.device.deframer.corrupt
    except SkinError as error:
        seen.error = f"{type(error).__name__}: {error}"
    seen.damaged = reader.damaged
    return seen


def _note(outcome: Outcome, what: str, seen: Seen, *, exact: bool = True, content: bool = True) -> None:
    wrong = seen.wrong(exact, content)
    outcome.note(not wrong, f"{what}: {'; '.join(wrong)}")
    outcome.figures["frames"] = outcome.figures.get("frames", 0) + len(seen.published)


def damage(effort: Effort) -> Outcome:
    """Damage packets in one to three ways, four scans of eight; each eight have a seed of their own."""
    outcome = Outcome("device.damage")
    for part in range(effort.count(3, 80)):
        _note(outcome, f"seed {effort.seed}/{part}", stream(_damaging(f"{effort.seed}/{part}"), 400))
    return outcome


def _damaging(seed: str) -> Send:
    episodes: dict[int, tuple[random.Random, list[str]]] = {}

    def send(line: Line, payload: bytes) -> bytes:
        episode, at = divmod(line.scans - REFERENCE - HONEST, 8)
        if episode not in episodes:
            draw = random.Random(f"{seed}/{episode}")
            episodes[episode] = draw, draw.sample(list(WAYS), draw.choice((1, 1, 2, 3)))
        draw, ways = episodes[episode]
        data = packet(payload)
        for way in ways * (at < 4):
            if draw.random() < 0.6:
                data = WAYS[way](draw, data) or b"\0"
        return data

    return send


def foreign_packets(effort: Effort) -> Outcome:
    """Put intact packets that are no frames of this device before every frame."""
    outcome = Outcome("device.foreign")
    hello = HELLO.pack()
    for part in range(effort.count(2, 40)):
        draw = random.Random(f"{effort.seed}/{part}")

        def send(_: Line, payload: bytes, draw: random.Random = draw) -> bytes:
            others = [foreign(draw, hello, payload) for _ in range(draw.randrange(4))]
            return b"".join(map(packet, [*others, payload]))

        _note(outcome, f"seed {effort.seed}/{part}", stream(send, 400))
    return outcome


HEADS: Final = ((1, 2), (1, 64), (1, 240), (16, 1), (16, 15), (18, 7), (2, 3), (4, 9))
"""Bytes of a frame's head, and what they become: flags, drives, frames dropped, sample width, generation."""

ROWS: Final = {
    "saturated": np.full(104, 2**31 - 1), "lowest": np.full(104, -(2**31)), "zero": np.zeros(104),
    "one": np.ones(104), "turned": -FLAT,
}  # fmt: skip
"""Counts that no sheet gives."""


def heads(effort: Effort) -> Outcome:
    """Change heads and rows of whole frames: the scan is as it was, or withheld, and its numbers stay finite."""
    outcome = Outcome("device.heads")
    for part in range(effort.count(1, 20)):
        seed = f"{effort.seed}/{part}"
        draw = random.Random(seed)
        _note(outcome, f"heads, seed {seed}", stream(_heading(draw), 300), exact=False)
        for name in (*ROWS, "garbage"):
            seen = stream(_absurd(name, draw), 40)
            _note(outcome, f"rows {name}, seed {seed}", seen, exact=False, content=False)
    return outcome


def _heading(draw: random.Random) -> Send:
    def send(_: Line, payload: bytes) -> bytes:
        held = bytearray(payload)
        if draw.random() < 0.1:
            at, value = draw.choice(HEADS)
            held[at] = value
        return packet(bytes(held))

    return send


def _absurd(name: str, draw: random.Random) -> Send:
    def send(line: Line, _: bytes) -> bytes:
        line.sequence -= 1
        counts = ROWS[name] if name in ROWS else [draw.randrange(-(2**31), 2**31) for _ in range(104)]
        return packet(line.payload(counts=np.array(counts).astype(np.int32)))

    return send
