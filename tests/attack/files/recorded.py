"""Recordings: damaged in their bytes, written again with other contents in their messages, or well-formed and hostile.

The name of a damaged file says which command reads it; the whole one is read by each.
"""

import json
import random
from functools import cache
from pathlib import Path
from typing import Final

import msgpack
from tests.tools.recording.hostile.files import KINDS, Honest

from . import mutations
from .samples import TINY, commanded

FRAMES: Final = 60
LARGEST_NS: Final = 2**64 - 1

COMMANDS: Final[dict[str, tuple[str, ...]]] = {
    "replay": ("--bundle", str(TINY), "--as-fast-as-possible", "--publish", "ipc://{0}/f", "--control", "ipc://{0}/c"),
    "reinfer": ("--bundle", str(TINY), "--out", "{0}/maps.npz", "--quiet"),
    "convert": ("--bundle", str(TINY), "--out", "{0}/out.npz"),
    "evaluate": ("--solver", "tikhonov", "--bundle", str(TINY), "--measured"),
    "doctor": ("--electrodes", "--recorded"),
    "view": (),
}
"""What reads a recording, and its further options; {0} is a folder."""


def read(path: Path) -> None:
    """Read a recording by what its name says, or in each way."""
    for name, options in COMMANDS.items():
        if path.stem not in (name, "all"):
            continue
        if name == "view":
            _view(path)
        else:
            words = [option.format(path.parent) for option in options]
            last = words[-1:] in (["--measured"], ["--recorded"])
            commanded(path.parent, name, *([*words, str(path)] if last else [str(path), *words]))


def _view(path: Path) -> None:
    """Ask for the parts that a page would."""
    from eitskin_tools.view.film import Film

    film = Film(path, TINY)
    for number in sorted({0, 1, film.parts // 2, film.parts - 1}):
        if number < film.parts:
            film.part(number)


@cache
def _whole() -> bytes:
    import tempfile

    from tests.tools.recording.conftest import measured, recorded

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "whole.mcap"
        recorded(path, measured(FRAMES, skip_unchanged=True))
        return path.read_bytes()


def make(folder: Path, rng: random.Random | None) -> tuple[Path, str]:
    """Put a recording into a folder, damaged unless there is no generator; return its path and what was done."""
    name = "all" if rng is None else rng.choice(list(COMMANDS))
    path = folder / f"{name}.mcap"
    if rng is None:
        path.write_bytes(_whole())
        return path, "whole"
    how = rng.choice(("bytes", "messages", rng.choice(list(KINDS))))
    path.write_bytes(mutations.bent(_whole(), rng) if how == "bytes" else _whole())
    if how == "messages":
        _rewrite(path, rng)
    elif how in KINDS:
        path.write_bytes(KINDS[how](Honest(path), rng))
    return path, f"{name}, {how}"


def _rewrite(path: Path, rng: random.Random) -> None:
    """Write a recording again with other contents in messages of one channel: all alike, or each in its own way."""
    from tests.tools.recording.conftest import rewritten

    from eitskin_tools.recording.reader import Recording

    channel = rng.choice(sorted({one.topic for one in Recording(path).entries()}))
    seed, alike, share = rng.randrange(1 << 30), rng.random() < 0.5, rng.choice((0.03, 0.5, 1.0))

    def changed(topic: str, data: bytes, log_ns: int) -> tuple[bytes, int]:
        if topic == channel and rng.random() < share:
            data = _body(data, random.Random(seed) if alike else rng)
        return data, log_ns

    rewritten(path, changed).rename(path)


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
        fields[key] = mutations.bent(value, rng)[:200_000]
    elif isinstance(value, int | float) and not isinstance(value, bool) and rng.random() < 0.5:
        fields[key] = rng.choice((0, -1, 1, 2, 2**31, 2**53, 2**63, LARGEST_NS, value + 1, 1e300, -0.5, float("nan")))
    else:
        fields[key] = rng.choice(mutations.HOSTILE)
    try:
        return bytes(msgpack.packb(fields))
    except (OverflowError, UnicodeEncodeError):  # what MessagePack cannot hold
        return bytes(msgpack.packb({**fields, key: None}))
