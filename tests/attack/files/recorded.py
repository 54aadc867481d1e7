"""Recordings, to be damaged: of their bytes, and by who writes what he likes into one that is otherwise whole.

The name of a damaged file says which command reads it; the whole one is read by each.
"""

import hashlib
import json
import random
from pathlib import Path
from typing import Any, Final

import msgpack

from . import mutations, samples
from .replayed import READERS

FRAMES: Final = 60
LARGEST_NS: Final = 2**64 - 1

WAYS: Final = ("bytes", "bytes", "head", "reference", "body", "body", "body", "times", "order", "scans", "chunk")

Message = tuple[str, bytes, int, int]
"""Topic, data, log time in ns, sequence."""


class Whole:
    """A recording that is nothing but right; made once."""

    def __init__(self, path: Path) -> None:
        from tests.tools.recording.conftest import measured, recorded

        from eitskin_tools.recording.reader import Recording

        recorded(path, measured(FRAMES, skip_unchanged=True))
        self.data = path.read_bytes()
        found = Recording(path)
        self.messages: list[Message] = [(one.topic, one.data, one.log_ns, one.sequence) for one in found.entries()]
        self.head, self.attached = found.head, found.attached


_WHOLE: list[Whole] = []


def prepare(folder: Path) -> None:
    """Make the recording."""
    _WHOLE.append(Whole(folder / "whole.mcap"))


def make(folder: Path, rng: random.Random | None) -> tuple[Path, str]:
    """Put a recording into a folder, damaged unless there is no generator; return its path and what was done."""
    whole = _WHOLE[0]
    name = "all" if rng is None else rng.choice(list(READERS))
    path = folder / f"{name}.mcap"
    if rng is None:
        path.write_bytes(whole.data)
        return path, "whole"
    if rng.random() < 0.04:
        return path, f"{name}, not a file: {mutations.special(path, rng)}"
    how = rng.choice(
        ("bytes", "bytes", "head", "reference", "body", "body", "body", "times", "order", "scans", "chunk")
    )
    if how == "bytes":
        path.write_bytes(mutations.bent(whole.data, rng))
    elif how == "chunk":
        path.write_bytes(_strange_chunk(whole.data, rng))
    else:
        head, attached, messages = dict(whole.head), dict(whole.attached), list(whole.messages)
        match how:
            case "head":
                head = _head(head, rng)
            case "reference":
                attached, messages = _reference(attached, messages, rng)
            case "body":
                _bodies(messages, rng)
            case "times":
                _times(messages, rng)
            case "order":
                messages = _order(messages, rng)
            case _:
                _scans(messages, rng)
        _write(path, head, attached, messages)
    return path, f"{name}, {how}"


def _write(path: Path, head: dict[str, str], attached: dict[str, bytes], messages: list[Message]) -> None:
    from eitskin_tools.recording.channels import CHANNELS
    from eitskin_tools.recording.sink import Reserve
    from eitskin_tools.recording.writer import RecordingWriter

    channels = {channel.topic: channel for channel in CHANNELS}
    writer = RecordingWriter(path, head, reserve=(reserve := Reserve(path.parent, 4096)), now_s=lambda: 0.0)
    for name, data in attached.items():
        writer.attach(name, "application/json", data, 0)
    for topic, data, log_ns, sequence in messages:
        writer.add(channels[topic], data, log_ns, sequence)
    writer.close()
    reserve.give_up()


def _text(value: Any) -> str:
    """Return what UTF-8 can hold of a value's text; a whole number of 400 digits has too many for Python to say."""
    text = value if isinstance(value, str) else "9" * 400 if isinstance(value, int) and value > 10**300 else str(value)
    return text.encode("utf-8", "replace").decode()


def _head(head: dict[str, str], rng: random.Random) -> dict[str, str]:
    for _ in range(rng.choice((1, 1, 2))):
        key = rng.choice(list(head)) if rng.random() < 0.6 else "hello"
        if key == "hello" and "hello" in head and rng.random() < 0.8:
            head[key] = mutations.bent(bytes.fromhex(head[key]), rng)[:2000].hex()
            if rng.random() < 0.7:  # one byte of it, wherever
                found = bytearray.fromhex(_WHOLE[0].head[key])
                found[rng.randrange(len(found))] = rng.choice((0, 1, 127, 128, 255))
                head[key] = found.hex()
        elif rng.random() < 0.2:
            head.pop(key, None)
        else:
            head[key] = _text(rng.choice(mutations.HOSTILE))
    return head


def _reference(
    attached: dict[str, bytes], messages: list[Message], rng: random.Random
) -> tuple[dict[str, bytes], list[Message]]:
    """Change the reference, so that the frames name the one that is there."""
    name, data = next(iter(attached.items()))
    fields = json.loads(data)
    if rng.random() < 0.1:
        return {}, messages
    changed = samples.sealed(mutations.changed({k: v for k, v in fields.items() if k != "sha256"}, rng))
    if rng.random() < 0.2:
        changed = mutations.bent(data, rng)
    before, after = (hashlib.sha256(one).hexdigest().encode() for one in (data, changed))
    return {name: changed}, [
        (topic, body.replace(before, after), log_ns, number) for topic, body, log_ns, number in messages
    ]


def _bodies(messages: list[Message], rng: random.Random) -> None:
    """Change what messages of one channel hold."""
    topic = rng.choice(sorted({one[0] for one in messages}))
    places = [at for at, one in enumerate(messages) if one[0] == topic]
    if rng.random() < 0.3:
        places = [rng.choice(places)]
    seed = rng.randrange(1 << 30)
    alike = rng.random() < 0.5
    for at in places:
        draw = random.Random(seed) if alike else rng
        _, data, log_ns, sequence = messages[at]
        messages[at] = topic, _body(data, draw), log_ns, sequence


def _body(data: bytes, rng: random.Random) -> bytes:
    if rng.random() < 0.15:
        return mutations.bent(data, rng)[:200_000]
    if data[:1] == b"{":
        return mutations.text_of(mutations.changed(json.loads(data), rng)).encode("utf-8", "replace")
    fields = msgpack.unpackb(data)
    key = rng.choice(list(fields))
    value = fields[key]
    if rng.random() < 0.08:
        del fields[key]
    elif isinstance(value, bytes) and rng.random() < 0.8:
        fields[key] = _array(value, rng)
    elif isinstance(value, int | float) and not isinstance(value, bool) and rng.random() < 0.5:
        fields[key] = rng.choice((0, -1, 1, 2, 2**31, 2**53, 2**63, LARGEST_NS, value + 1, 1e300, -0.5, float("nan")))
    else:
        fields[key] = rng.choice(mutations.HOSTILE)
    try:
        return bytes(msgpack.packb(fields))
    except (OverflowError, UnicodeEncodeError):  # what MessagePack cannot hold
        return bytes(msgpack.packb({**fields, key: None}))


def _array(data: bytes, rng: random.Random) -> bytes:
    """Return the bytes of numbers with others, or of another length."""
    import numpy as np

    if rng.random() < 0.3:
        return mutations.bent(data, rng)[:200_000]
    kind = "<f4" if len(data) % 8 or rng.random() < 0.5 else "<f8"
    values = np.frombuffer(data[: len(data) // 8 * 8], dtype=kind).copy()
    if not len(values):
        return bytes(8)
    hostile = rng.choice((np.nan, np.inf, 0.0, -1.0, 1e-40, 1e30, -1e30, 1e38, 5e-324, 1e300))
    with np.errstate(all="ignore"):
        if rng.random() < 0.5:
            values[:] = hostile
        else:
            values[rng.randrange(len(values))] = hostile
    return values.tobytes() + data[len(values) * values.itemsize :]


def _times(messages: list[Message], rng: random.Random) -> None:
    """Give messages other times and sequences."""
    how, first = rng.randrange(4), messages[0][2]
    moment = rng.choice((0, 1, 2**63, LARGEST_NS, first + 10**12, first + 10**15, first + 10**18, first - 10**9))
    split = rng.randrange(len(messages))
    for at, (topic, data, log_ns, sequence) in enumerate(messages):
        then_ns, number = log_ns, sequence
        if how == 2 or (how == 0 and at == split):
            then_ns = moment
        elif how == 1 and at >= split:
            then_ns = min(max(log_ns - first + moment, 0), LARGEST_NS)
        elif how == 3:
            number = rng.choice((0, 2**32 - 1, sequence, sequence + 7))
        messages[at] = topic, data, max(then_ns, 0), number


def _order(messages: list[Message], rng: random.Random) -> list[Message]:
    """Leave channels out, say things again, or in another order."""
    how, topics = rng.randrange(5), sorted({one[0] for one in messages})
    chosen = rng.choice(topics)
    if how == 0:
        return [one for one in messages if one[0] != chosen]
    if how == 1:
        return [one for one in messages if one[0] == chosen]
    if how == 2:
        return [one for one in messages for _ in range(30 if one[0] == chosen else 1)]
    if how == 3:
        rng.shuffle(messages)
        return messages
    return messages[:: rng.choice((-1, 2, 7))]


def _scans(messages: list[Message], rng: random.Random) -> None:
    """Change payloads of the wire in places; whoever recorded them says that they were intact."""
    places = [at for at, one in enumerate(messages) if one[0] == "/eitskin/wire"]
    at_byte, value, part = rng.randrange(40), rng.choice((0, 1, 127, 128, 255)), rng.choice((1.0, 0.3))
    for at in places:
        if rng.random() > part:
            continue
        topic, data, log_ns, sequence = messages[at]
        fields = msgpack.unpackb(data)
        payload = bytearray(fields["payload"])
        payload[at_byte if at_byte < 30 else rng.randrange(len(payload))] = value
        fields["payload"] = bytes(payload)
        messages[at] = topic, msgpack.packb(fields), log_ns, sequence


def _strange_chunk(data: bytes, rng: random.Random) -> bytes:
    """Put a chunk of what nobody writes before the end of a recording: much of nothing, or wrong about itself."""
    import struct
    import zlib

    import zstandard

    size = rng.choice((0, 1000, 1 << 20, 64 << 20, 255 << 20))
    unit = rng.choice((bytes(9), b"\x05" + struct.pack("<Q", 22) + bytes(22), b"\x04" + struct.pack("<Q", 0)))
    inner = unit * (size // len(unit))
    compression = rng.choice((b"zstd", b"zstd", b"lz4", b"", b"none"))
    packed = zstandard.ZstdCompressor(level=1).compress(inner) if compression == b"zstd" else inner[: 1 << 20]
    says = rng.choice((len(inner), len(inner), 0, LARGEST_NS, len(inner) + 1))
    check = rng.choice((0, zlib.crc32(inner)))
    chunk = struct.pack("<QQQI", 0, rng.choice((0, LARGEST_NS)), says, check)
    chunk += struct.pack("<I", len(compression)) + compression + struct.pack("<Q", len(packed)) + packed
    record = b"\x06" + struct.pack("<Q", len(chunk)) + chunk
    footer = data.rfind(b"\x02" + struct.pack("<Q", 20))
    data_end = data.rfind(b"\x0f" + struct.pack("<Q", 4))
    at = data_end if 0 < data_end < footer else footer
    return data[:at] + record + data[at:]
