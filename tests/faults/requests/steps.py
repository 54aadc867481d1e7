"""Steps of a sequence: drawn at random, resolved against what the device said last, and made into bytes.

A step is a tuple of plain values, so that a sequence can be printed, shortened and played again. Its arguments are
symbols ("the running generation", "the next chunk") that keep their meaning when steps before it are taken out.
"""

import random
import struct
from dataclasses import dataclass
from typing import Any, Final

from tests.faults.requests.specification import HARDWARE_ID, Request, digest_of

from eitskin_proto.wire import config_toml

BLOBS: Final = {name: config_toml.named(name).to_blob() for name in config_toml.NAMED}
NAMES: Final = tuple(BLOBS)
FACTORY: Final = BLOBS["paper"]

Step = tuple[Any, ...]

TYPES: Final = {"hello": 0x01, "start": 0x02, "stop": 0x03, "begin": 0x11, "write": 0x12, "verify": 0x13,
                "commit": 0x14, "confirm": 0x15, "rollback": 0x16, "abort": 0x17, "restart": 0x18}  # fmt: skip
FORMATS: Final = {"hello": "<4sBB", "start": "<I", "stop": "<", "begin": "<IHIIIBB16s", "write": "<IH",
                  "verify": "<I", "commit": "<II", "confirm": "<II", "rollback": "<II", "abort": "<I",
                  "restart": "<I"}  # fmt: skip


@dataclass(slots=True)
class Known:
    """What a host knows of the device: what it said last, and what was sent."""

    generation: int = 0
    digest: int = digest_of(FACTORY)
    wanted: str = "paper"
    """What the last BEGIN announced."""
    written: int = 0
    """Bytes that the device said it has."""


def draw(rng: random.Random) -> list[Step]:
    """Return a random sequence: whole and broken flashes, single requests, power cuts, boots, waits."""
    steps: list[Step] = []
    for _ in range(rng.randint(3, 12)):
        chance = rng.random()
        if rng.random() < 0.25:
            steps.append(("cut", rng.randint(1, rng.choice((3, 25, 50))), rng.randint(0, 40)))
        if chance < 0.42:
            steps += _flash(rng)
        elif chance < 0.6:
            steps += [("rollback", _token(rng), rng.random() < 0.95)]
            steps += [("restart", _token(rng))] if rng.random() < 0.5 else []
        elif chance < 0.68:
            steps.append(("power",))
        elif chance < 0.72:
            steps.append(("wait", rng.choice((11, 31))))
        else:
            steps += [_single(rng) for _ in range(rng.randint(1, 3))]
    return steps


def _token(rng: random.Random) -> int:
    return rng.choice((5, 5, 5, 5, 5, 5, 5, 5, 6, 0))


def _flash(rng: random.Random) -> list[Step]:
    name, token = rng.choice(NAMES), _token(rng)
    chunk = rng.choice((32, 32, 32, 16))
    steps: list[Step] = [("begin", token, name, "good")]
    steps += [("write", token, "next", chunk)] * (64 // chunk)
    steps += [("verify", token), ("commit", token, name), ("restart", token), ("confirm", True, True)]
    end = len(steps) if rng.random() < 0.8 else rng.randint(1, len(steps))
    return [step for step in steps[:end] if rng.random() < 0.99]


def _single(rng: random.Random) -> Step:
    made: Step = rng.choice((
        ("hello",), ("start",), ("stop",), ("stop",),
        ("begin", _token(rng), rng.choice(NAMES), rng.choice(("good", "good", "hardware", "size", "format", "lower"))),
        ("write", _token(rng), rng.choice(("next", "same", "gap", "bent")), rng.choice((0, 4, 16, 30, 32))),
        ("verify", _token(rng)), ("commit", _token(rng), rng.choice(NAMES)),
        ("confirm", rng.random() < 0.8, rng.random() < 0.8), ("rollback", _token(rng), rng.random() < 0.8),
        ("abort", _token(rng)), ("restart", _token(rng)),
        ("power",),
    ))  # fmt: skip
    return made


def resolve(step: Step, known: Known) -> Request:
    """Return the request that a step means now: its name and its fields in the order of SPEC.md."""
    match step:
        case ("begin", token, name, kind):
            blob = BLOBS[name]
            known.wanted, known.written = name, 0
            return ("begin", token, 65 if kind == "size" else 64, digest_of(blob), HARDWARE_ID ^ (kind == "hardware"),
                    0 if kind == "lower" else 1, 2 if kind == "format" else 1, 0, blob[16:32])  # fmt: skip
        case ("write", token, where, length):
            at = known.written + {"gap": 4, "same": -length}.get(where, 0)
            at = max(0, at)
            data = BLOBS[known.wanted][at : at + length]
            if where == "bent" and data:
                data = data[:-1] + bytes([data[-1] ^ 0x10])
            return ("write", token, at, data)
        case ("commit", token, name):
            return ("commit", token, digest_of(BLOBS[name]))
        case ("confirm", generation, digest):
            return ("confirm", known.generation + (not generation), known.digest ^ (not digest))
        case ("rollback", token, generation):
            return ("rollback", token, known.generation + (not generation))
        case _:
            return step


def payload(request: Request, tag: int) -> bytes:
    """Return the bytes of a request, without the packet around them."""
    name, *fields = request
    head = bytes([TYPES[name], tag])
    if name == "hello":
        return head + struct.pack("<4sBB", b"EITS", 1, 0)
    if name == "start":
        return head + struct.pack("<I", 0)
    if name == "write":
        token, offset, data = fields
        return head + struct.pack("<IH", token, offset) + bytes(data)
    return head + struct.pack(FORMATS[name], *fields)
