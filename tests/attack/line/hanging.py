"""Devices that send no frame that can be used, each in another way: greeted seldom, named, and given up in time."""

import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from unittest.mock import patch

import numpy as np

from eitskin.acquisition import device as devices
from eitskin.errors import BadReference, HandshakeError, PortLost, SkinError
from eitskin.skin import Skin
from eitskin_proto.wire.codes import EventCode, FrameFlag
from eitskin_proto.wire.framing import encode

from ..outcome import Effort, Outcome
from ..stream import TINY
from .line import FLAT, HELLO, Line

HONEST_SCANS = 40
"""First a reference, and some frames."""


@dataclass(frozen=True)
class Case:
    """What a device does after its honest scans, and what must be said of it."""

    send: Callable[[Line, int], bytes]
    trouble: tuple[str, ...]
    """What status may say meanwhile."""
    ends: str = ""
    """In the error that ends the stream; "" where it must go on."""
    hello: dict[str, object] | None = None
    """What HELLO says from then on."""
    mute: bool = False


def _nothing(line: Line, number: int) -> bytes:
    return b""


def _wide(line: Line, number: int) -> bytes:
    return line.frame(counts=np.tile(np.rint(FLAT).astype(np.int32), 2), flags=FrameFlag.FULL)


CASES: dict[str, Case] = {
    "hangs": Case(_nothing, ("silent",), "did not answer", mute=True),
    "answers and sends nothing": Case(_nothing, ("silent",), "sent no frame"),
    "FRONT_END_FAILED": Case(
        lambda line, n: line.event(EventCode.FRONT_END_FAILED), ("front_end_failed",), "front end does not answer"
    ),
    "events": Case(lambda line, n: line.event(EventCode.OVERRUN), ("silent",), "sent no frame"),
    "a status of its own": Case(lambda line, n: encode(b"\x90" + bytes(20)), ("silent",), "sent no frame"),
    "noise": Case(lambda line, n: line.rng.bytes(300), ("silent",), "lying line"),
    "another generation": Case(lambda line, n: line.frame(generation=9), ("configuration",), "another generation"),
    "another table": Case(_wide, ("malformed",), "withheld as malformed"),
    "another width": Case(
        lambda line, n: line.frame(sample_bytes=3, counts=np.zeros(104, dtype=np.int32)), ("malformed",), "malformed"
    ),
    "the same scan": Case(lambda line, n: line.frame(sequence=7), ("duplicate",), "withheld as duplicate"),
    "turned sign": Case(_nothing, ("silent",), "volts_per_count", {"volts_per_count": -1e-9}),
    "another scale": Case(_nothing, ("silent",), "volts_per_count", {"volts_per_count": 2e-9}),
    "rate 0": Case(_nothing, ("silent",), "rate_mHz", {"rate_mHz": 0}),
    "another device": Case(_nothing, ("silent",), "LIAR-2", {"serial_number": "LIAR-2"}),
    "no signal": Case(lambda line, n: line.frame(counts=np.zeros(104, dtype=np.int32)), ("no_signal",)),
}


@dataclass
class Seen:
    """What became of a stream."""

    error: str = ""
    lasted_s: float = 0.0
    published: int = 0
    greeted: int = 0
    troubles: tuple[str, ...] = ()


def watch(case: Case, longest_s: float) -> Seen:
    """Let a device turn bad after its honest scans, and return what is seen until the stream ends, or so long."""
    began_s = [0.0]
    line = Line(lambda line, number: line.frame() if number < HONEST_SCANS else case.send(line, number))
    seen, troubles = Seen(), set[str]()
    with Skin(line, bundle=TINY) as skin:
        skin.capture_reference(20)
        over = threading.Event()

        def turn(here: Line) -> None:
            if here.scans >= HONEST_SCANS and not began_s[0]:
                began_s[0] = time.monotonic()
                here.mute, here.hello = case.mute, replace(HELLO, **(case.hello or {}))  # type: ignore[arg-type]

        def look() -> None:
            while not over.wait(0.02):
                troubles.add(skin.status()["trouble"])
                if began_s[0] and time.monotonic() - began_s[0] > longest_s:
                    skin.stop()

        line.hooks.append(turn)
        looking = threading.Thread(target=look)
        looking.start()
        greeted = line.greeted
        try:
            for frame in skin.frames():
                if began_s[0] and frame.sequence > HONEST_SCANS:
                    seen.published += 1
        except (HandshakeError, BadReference, PortLost) as error:
            seen.error = str(error)
        finally:
            over.set()
            looking.join()
        seen.lasted_s = time.monotonic() - began_s[0]
        seen.greeted = line.greeted - greeted
    seen.troubles = tuple(sorted(troubles - {""}))
    return seen


def hanging(effort: Effort) -> Outcome:
    """Let every device turn bad, all at once: a thread each."""
    outcome = Outcome("front-end.hanging")
    scale = 1.0 if effort.long else 0.5

    def attempt(name: str) -> Seen:
        try:
            return watch(CASES[name], 15.0 * scale)
        except SkinError as error:
            return Seen(f"before it hung: {error}")

    with (
        patch.object(devices, "SILENCE_S", devices.SILENCE_S * scale),
        patch.object(devices, "HANDSHAKE_S", devices.HANDSHAKE_S * scale),
        ThreadPoolExecutor(len(CASES)) as pool,
    ):
        found = dict(zip(CASES, pool.map(attempt, CASES), strict=True))
    for name, seen in found.items():
        wrong = _wrong(name, seen, scale)
        outcome.note(not wrong, f"{name}: {'; '.join(wrong)}")
        outcome.figures[name] = f"{seen.lasted_s:.1f} s, greeted {seen.greeted}, {', '.join(seen.troubles)}"
    return outcome


def _wrong(name: str, seen: Seen, scale: float) -> list[str]:
    """Return what did not hold of a stream whose device turned bad."""
    case, found = CASES[name], []
    if seen.published > (name == "frozen"):  # the first of equal frames is none yet
        found.append(f"{seen.published} published")
    if not (case.ends in seen.error and bool(case.ends) == bool(seen.error)):
        found.append(f"ended with {seen.error or 'nothing'}")
    if not seen.troubles or not set(seen.troubles) <= {*case.trouble, "silent"}:
        found.append(f"status said {seen.troubles}")
    if seen.greeted > 3.0 * seen.lasted_s / scale + 8:
        found.append(f"greeted {seen.greeted} times in {seen.lasted_s:.1f} s")
    return found
