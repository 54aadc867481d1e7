"""Well-formed recordings that no recorder writes: small files whose records ask for endless time or memory."""

import json
import random
import struct
import zlib
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, Final

import msgpack
import numpy as np
import zstandard

from eitskin_tools.recording.layout import TOPICS
from eitskin_tools.recording.reader import MAGIC, Recording

IDS: Final = {topic: number for number, topic in TOPICS.items()}
WIRE, CLOUD, STATE, CONDITIONS, FRAME, MAP = (
    IDS[f"/eitskin/{name}"] for name in ("wire", "cloud", "state", "conditions", "frame", "map")
)
FOOTER: Final = b"\2" + struct.pack("<QQQI", 20, 0, 0, 0) + MAGIC
LARGEST: Final = 7 << 20
LAST_NS: Final = 1 << 62


def record(opcode: int, content: bytes) -> bytes:
    """Return a record."""
    return struct.pack("<BQ", opcode, len(content)) + content


def text(value: str) -> bytes:
    """Return a text as records hold it."""
    return struct.pack("<I", len(value.encode())) + value.encode()


def message(channel: int, log_ns: int, data: bytes, sequence: int = 0) -> bytes:
    """Return a message."""
    return record(5, struct.pack("<HIQQ", channel, sequence, log_ns, log_ns) + data)


def chunk(inner: bytes, size: int | None = None) -> bytes:
    """Return a chunk, which says that it is of all times, and another size if that is given."""
    data = zstandard.compress(inner)
    head = struct.pack("<QQQI", 0, LAST_NS, len(inner) if size is None else size, zlib.crc32(inner))
    return record(6, head + text("zstd") + struct.pack("<Q", len(data)) + data)


def chunks(messages: Iterable[bytes], most: int = 1 << 20) -> Iterator[bytes]:
    """Yield messages in chunks of so many bytes."""
    waiting: list[bytes] = []
    for one in messages:
        waiting.append(one)
        if len(waiting) * len(one) > most:
            yield chunk(b"".join(waiting))
            waiting = []
    yield chunk(b"".join(waiting))


def index(channel: int, entries: int = 1) -> bytes:
    """Return the index of a channel behind a chunk."""
    return record(7, struct.pack("<HI", channel, 16 * entries) + bytes(16 * entries))


class Honest:
    """The parts of an honest recording, to be put together in other ways.

    Args:
        path: Of the recording.
    """

    def __init__(self, path: Path) -> None:
        found = Recording(path)
        self.rows = [(IDS[one.topic], one.log_ns, one.data, one.sequence) for one in found.entries()]
        self.first_ns = self.rows[0][1]
        self.body = chunk(b"".join(message(*row) for row in self.rows))
        pairs = b"".join(text(key) + text(value) for key, value in found.head.items())
        head = record(12, text("eitskin") + struct.pack("<I", len(pairs)) + pairs)
        self._head = MAGIC + record(1, text("") + text("")) + head
        self._head += b"".join(self.attachment(name, data) for name, data in found.attached.items())

    @staticmethod
    def attachment(name: str, data: bytes) -> bytes:
        """Return an attachment."""
        return record(9, bytes(16) + text(name) + text("") + struct.pack("<Q", len(data)) + data + bytes(4))

    def of(self, channel: int) -> bytes:
        """Return the first message of a channel."""
        return next(data for found, _, data, _ in self.rows if found == channel)

    def frames(self, count: int, step_ns: int, **fields: Callable[[int], Any]) -> Iterator[bytes]:
        """Yield frames of the wire that are all alike but for some fields."""
        whole = msgpack.unpackb(self.of(WIRE))
        for k in range(count):
            changed = {name: value(k) for name, value in fields.items()}
            yield message(WIRE, self.first_ns + k * step_ns, msgpack.packb({**whole, **changed}), k)

    def file(self, *parts: bytes, end: bytes = FOOTER) -> bytes:
        """Return a file with the honest head."""
        return self._head + b"".join(parts) + end


def nothings(honest: Honest, rng: random.Random) -> bytes:
    """Records without content, by the million."""
    unit = rng.choice((record(3, b""), message(99, 0, b""), message(WIRE, honest.first_ns, b""),
                       message(FRAME, honest.first_ns, b"{}")))  # fmt: skip
    return honest.file(*[chunk(unit * (LARGEST // len(unit)))] * rng.choice((1, 30, 300)), honest.body)


def equal_frames(honest: Honest, rng: random.Random) -> bytes:
    """Frames that are all alike, at one time or nearly so."""
    count, step_ns = rng.choice((3000, 20_000)), rng.choice((0, 1, 1000))
    far = message(WIRE, honest.first_ns + 10**18, honest.of(WIRE))
    numbered = {"seq": lambda k: k, "frame": lambda k: k} if rng.random() < 0.5 else {}
    frames = honest.frames(count, step_ns, **numbered)
    return honest.file(honest.body, *chunks(frames, rng.choice((1 << 18, LARGEST))), chunk(far))


def changing(honest: Honest, rng: random.Random) -> bytes:
    """Each frame under other conditions, of another cloud and other electrodes, or under conditions that are not there.

    Chunks of nothing around them could hold those.
    """
    clouds, conditions = msgpack.unpackb(honest.of(CLOUD)), msgpack.unpackb(honest.of(CONDITIONS))
    many, known = rng.choice((2, 50, 300)), rng.random() < 0.5
    noisy = np.random.default_rng(many).normal(np.frombuffer(clouds["cloud"], "<f4"), 0.05, (many, 3 * 30 * 45))
    lasting = [
        message(CLOUD, honest.first_ns, msgpack.packb(
            {**clouds, "revision": k, "why": "given", "cloud": own.astype("<f4").tobytes()}))
        for k, own in enumerate(noisy)
    ] + [
        message(CONDITIONS, honest.first_ns, msgpack.packb(
            {**conditions, "revision": k, "cloud": k, "electrodes": [[k % 16, "excluded", None]]}))
        for k in range(many)
    ]  # fmt: skip
    other = (lambda k: k % many) if known else (lambda k: 1000 + k)
    empty = chunk(message(99, 0, bytes(200)) * 2000) + index(CONDITIONS) + index(CLOUD)
    frames = honest.frames(800, 5_000_000, seq=lambda k: k, conditions=other, touched=lambda k: True)
    found = [one + index(WIRE) for one in chunks(frames, 1 << 18)]
    return honest.file(*[one + index(CLOUD) for one in chunks(lasting)], *[empty] * 40, *found)


def disordered(honest: Honest, rng: random.Random) -> bytes:
    """Messages out of order, backwards, or centuries apart, a chunk each."""
    rows, gap_ns = list(honest.rows), rng.choice((0, 10**9, 10**16))
    rng.shuffle(rows)
    times = [honest.first_ns + k * gap_ns if gap_ns else rng.randrange(LAST_NS) for k in range(len(rows))]
    return honest.file(*[chunk(message(row[0], at, *row[2:])) for row, at in zip(rows, times, strict=True)])


def nested(honest: Honest, rng: random.Random) -> bytes:
    """A chunk in a chunk, or one that claims to be larger or smaller than it is."""
    claims = rng.choice((None, 100, 1 << 40, (1 << 64) - 1))
    inner = chunk(bytes(LARGEST)) if claims is None else bytes(LARGEST)
    return honest.file(chunk(inner * rng.choice((1, 1000) if claims is None else (1,)), claims), honest.body)


def crowded(honest: Honest, rng: random.Random) -> bytes:
    """Many chunks of all times, each with an index that names every channel."""
    one = chunk(rng.choice((b"", message(*honest.rows[-1])))) + b"".join(map(index, TOPICS))
    return honest.file(honest.body, *[one] * rng.choice((100, 500)))


def lying(honest: Honest, rng: random.Random) -> bytes:
    """A summary, lengths and indices that lie."""
    huge = rng.choice(((1 << 40), (1 << 63) - 1, (1 << 64) - 1))
    places = record(8, struct.pack("<QQQQ", 0, huge, huge, huge) + bytes(12) + bytes(8) + text("zstd") + bytes(16))
    end = record(2, struct.pack("<QQI", huge, 8, 7)) + MAGIC
    junk = b"".join(index(rng.randrange(9), rng.choice((0, 1, 4000))) for _ in range(50))
    tail = rng.choice((places * 1000 + end, struct.pack("<BQ", 6, huge), record(200, b"") * 30_000, b"\5" * 10**6))
    return honest.file(junk, honest.body, junk, end=tail)


def bombs(honest: Honest, rng: random.Random) -> bytes:
    """Messages that are small when packed, and large or deep when read."""
    data = rng.choice((
        b'{"a":[' + b"[]," * 10**6 + b"0]}", b'{"a":' + b"[" * 10**6, b'{"events":[' + b'"a",' * 15_000 + b'""]}',
        b"\xdd" + struct.pack(">I", 10**6) + b"\x80" * 10**6, b"\x91" * 10**6, b"\xdf\xff\xff\xff\xff",
        msgpack.packb({"seq": 1, "shape": [1400, 1400], "map": bytes(4 * 1400 * 1400)}),
    ))  # fmt: skip
    one = message(rng.choice((STATE, FRAME, MAP, CLOUD, WIRE)), honest.first_ns, data)
    return honest.file(honest.body, *[chunk(one * max(LARGEST // len(one), 1))] * rng.choice((1, 20)))


def attached(honest: Honest, rng: random.Random) -> bytes:
    """References, names of channels and metadata without end."""
    size, pairs = rng.choice((100, 60_000)), b"".join(text(f"k{k}") + text("v") for k in range(100_000))
    many = b"".join(honest.attachment(f"reference-{k}", b"%d" % k + b" " * size) for k in range(1100))
    named = b"".join(
        record(4, struct.pack("<HH", k, 0) + text(f"/eitskin/{'x' * rng.choice((1, 5000))}") + text("") + bytes(4))
        for k in range(9, 3000)
    )
    metadata = record(12, text("other") + struct.pack("<I", len(pairs)) + pairs)
    return honest.file(rng.choice((many, named, chunk(named), metadata)), honest.body)


def told(honest: Honest, rng: random.Random) -> bytes:
    """States, clouds and notes by the ten thousand."""
    note, count = json.loads(honest.of(FRAME)), rng.choice((2000, 8000))
    made: dict[int, Callable[[int], bytes]] = {
        STATE: lambda k: honest.of(STATE),
        CLOUD: lambda k: msgpack.packb({**msgpack.unpackb(honest.of(CLOUD)), "revision": k}),
        FRAME: lambda k: json.dumps({**note, "number": k, "events": ["e" * 99] * 50}).encode(),
    }
    topic = rng.choice(list(made))
    return honest.file(
        honest.body, *chunks((message(topic, honest.first_ns, made[topic](k), k) for k in range(count)), LARGEST)
    )


KINDS: Final[dict[str, Callable[[Honest, random.Random], bytes]]] = {
    make.__name__: make
    for make in (
        nothings, equal_frames, changing, disordered, nested, crowded, lying, bombs, attached, told,
    )
}  # fmt: skip
"""By name."""
