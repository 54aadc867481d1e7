"""Frames of the comparison: 12 x 32 bytes, numbered, with contents that follow from the number.

Both formats carry the same payload. flexitac 0.3.1 puts a marker of two bytes before it; eitskin a CRC-32C behind it,
stuffed (SPEC.md). No byte reaches the marker's first one, so that a marker inside a payload, which a real sensor may
send, does not count against the format.
"""

from collections.abc import Sequence
from typing import Final, Literal

import numpy as np

from eitskin_proto.wire.framing import encode

Format = Literal["flexitac", "eitskin"]

PAYLOAD_BYTES: Final = 12 * 32
"""flexitac's default: 12 rows and 32 columns of one byte."""

MARKER: Final = b"\xaa\x55"
"""Begins a flexitac frame (flexitac 0.3.1, sensor.py)."""

BASE: Final = 100
"""The number stands in the first four bytes as digits of this base."""


def payload(number: int) -> bytes:
    """Return the 384 bytes of a frame."""
    contents = np.random.default_rng(number).integers(0, MARKER[0], PAYLOAD_BYTES, dtype=np.uint8)
    for place in range(4):
        contents[place] = number // BASE**place % BASE
    return contents.tobytes()


def number_of(contents: Sequence[int]) -> int:
    """Return the number that the first four bytes say."""
    return sum(digit * BASE**place for place, digit in enumerate(contents[:4]))


def on_the_wire(number: int, kind: Format) -> bytes:
    """Return a frame as one of the formats sends it."""
    contents = payload(number)
    return MARKER + contents if kind == "flexitac" else encode(contents)


def flipped(frame: bytes, seed: int) -> bytes:
    """Return a frame with one random bit inverted."""
    bit = int(np.random.default_rng([seed, 1]).integers(8 * len(frame)))
    changed = bytearray(frame)
    changed[bit // 8] ^= 1 << bit % 8
    return bytes(changed)
