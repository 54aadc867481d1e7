"""The kinds of files that are attacked: how a sample is made and damaged, and what reads it."""

import copy
import json
import random
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any, Final

from . import evaluated, folders, graphs, mutations, recorded, replayed, robots, samples

Make = Callable[[Path, random.Random | None], tuple[Path, str]]
"""Puts a sample into a folder, damaged unless there is no generator; returns its path and what was done."""


@dataclass(frozen=True)
class Kind:
    """One kind of file."""

    make: Make
    read: samples.Read
    errors: tuple[type[BaseException], ...] = (OSError,)
    """What its reader says that it raises besides the package's own errors."""
    prepare: Callable[[Path], None] = lambda _: None
    """Called once with a folder that stays."""
    long: int = 4000
    """Tries of the long form; fewer where each takes longer."""


def _file(name: str, data: Callable[[random.Random | None], tuple[bytes, str]]) -> Make:
    def make(folder: Path, rng: random.Random | None) -> tuple[Path, str]:
        path = folder / name
        if rng is not None and rng.random() < 0.04:
            return path, f"not a file: {mutations.special(path, rng)}"
        content, what = data(rng)
        path.write_bytes(content)
        return path, what

    return make


def _bytes(whole: Callable[[], bytes], rng: random.Random | None) -> tuple[bytes, str]:
    return (whole(), "whole") if rng is None else (mutations.bent(whole(), rng), "bytes")


def _json(whole: Callable[[], Any], rng: random.Random | None) -> tuple[bytes, str]:
    if rng is None:
        return json.dumps(whole()).encode(), "whole"
    if rng.random() < 0.15:
        return mutations.bent(json.dumps(whole()).encode(), rng), "bytes"
    return mutations.text_of(mutations.changed(whole(), rng)).encode(), "values"


def _reference(rng: random.Random | None) -> tuple[bytes, str]:
    if rng is None:
        return samples.sealed(samples.reference()), "whole"
    if rng.random() < 0.2:
        return mutations.bent(samples.sealed(samples.reference()), rng), "bytes"
    return samples.sealed(mutations.changed(samples.reference(), rng)), "values, sealed again"


def _npy(whole: Callable[[], Any], rng: random.Random | None) -> tuple[bytes, str]:
    if rng is None:
        return samples.npy(whole()), "whole"
    if rng.random() < 0.5:
        return mutations.array(rng), "another array"
    return mutations.bent(samples.npy(whole()), rng), "bytes"


def _npz(whole: Callable[[], dict[str, Any]], rng: random.Random | None) -> tuple[bytes, str]:
    arrays = whole()
    if rng is None:
        return samples.npz(**arrays), "whole"
    parts = {f"{name}.npy": samples.npy(value) for name, value in arrays.items()}
    how = rng.random()
    if how < 0.6:
        name = rng.choice(list(arrays))
        parts[f"{name}.npy"] = mutations.array(rng) if how < 0.3 else mutations.valued(arrays[name], rng)
        return mutations.zipped(parts), "another array" if how < 0.3 else "other values"
    return mutations.archive(parts, rng), "archive"


_CONFIGURATION: Final = (
    samples.ROOT / "firmware_proto" / "eitskin_proto" / "configurations" / "idle.toml"
).read_bytes()

FACTORS: Final = (-1.0, 0.0, 1e-9, 1e-3, 0.1, 0.5, 0.9, 1.1, 2.0, 10.0, 1e3, 1e9, 1e300)
"""What a number of a TOML file is multiplied by."""


def _toml(whole: bytes, rng: random.Random | None) -> tuple[bytes, str]:
    if rng is None:
        return whole, "whole"
    if rng.random() < 0.3:
        return mutations.bent(whole, rng), "bytes"
    lines = whole.decode().splitlines()
    for _ in range(rng.choice((1, 1, 2))):
        at = rng.randrange(len(lines))
        key, _, value = lines[at].partition("=")
        numbers = re.findall(r"\d+(?:\.\d+)?(?![\d.])", value)  # and none in the midst of 127.0.0.1
        if numbers and rng.random() < 0.3:
            one = rng.choice(numbers)
            lines[at] = f"{key}={value.replace(one, str(float(one) * rng.choice(FACTORS)), 1)}"
            continue
        values = (
            "1e400", "-1", "nan", "inf", "true", "[]", "{}", '"\\u001b[2J"', "1" * 5000, "[" * 60_000, "9" * 400,
            "1979-05-27", "[[[]]]", '"' + "x" * 99 + '"', "0", "0x7fffffffffffffffffff", "." .join("a" * 9),
            "[" + "1," * 20_000 + "]", '"""' + "\\n" * 999 + '"""', "{a={a={a={}}}}",
        )  # fmt: skip
        lines[at] = (
            f"{key}= {rng.choice(values)}" if "=" in lines[at] else rng.choice(("[x]", "[drive.x]", "", "[[a]]"))
        )
        if rng.random() < 0.1:
            lines.insert(at, rng.choice((".".join("a" * 4000) + " = 1", lines[at], "\x1b = 1", "[" * 5000)))
    return "\n".join(lines).encode(), "values"


@cache
def _tiny() -> tuple[dict[str, bytes], Any]:
    parts = samples.members(samples.TINY)
    manifest = json.loads(parts.pop("manifest.json"))
    return parts, manifest


def _bundle(rng: random.Random | None) -> tuple[bytes, str]:
    whole, listed = _tiny()
    parts, manifest = dict(whole), copy.deepcopy(listed)
    if rng is None:
        return samples.bundle(parts, manifest), "whole"
    how = rng.randrange(10)
    if how < 3:
        text = mutations.text_of(mutations.changed(manifest, rng))
        return mutations.zipped({"manifest.json": text.encode(), **parts}), "manifest"
    if how < 6:
        name = rng.choice([name for name in parts if name.endswith(".onnx")])
        parts[name], what = graphs.hostile(parts[name], rng)
        return samples.bundle(parts, manifest), f"{name}: {what}"
    if how < 8:
        name = rng.choice(list(parts))
        parts[name] = mutations.array(rng) if name.endswith(".npy") else mutations.bent(parts[name], rng)
        if name.endswith(".npz"):
            parts[name] = mutations.archive(samples.members_of(whole[name]), rng)
        return samples.bundle(parts, manifest), f"{name} is another"
    data = {"manifest.json": json.dumps(manifest).encode(), **parts}
    return (
        (mutations.archive(data, rng), "archive")
        if how == 8
        else (mutations.bent(mutations.zipped(data), rng), "bytes")
    )


def _phantoms() -> Any:
    return [{"name": "1", "scene": samples.scene(), "truth": "area"}, {"scene": {}, "truth": "units"}]


def _pcd(form: str) -> bytes:
    rows = samples.points()
    head = "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z _\nSIZE 4 4 4 1\nTYPE F F F U\nCOUNT 1 1 1 4\n"
    head += f"WIDTH {len(rows)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(rows)}\nDATA {form}\n"
    if form == "ascii":
        return (head + "\n".join(" ".join(f"{v:g}" for v in row) + " 0 0 0 0" for row in rows)).encode()
    return head.encode() + b"".join(row.tobytes() + bytes(4) for row in rows)


def _xyz() -> bytes:
    return "\n".join(" ".join(f"{v:g}" for v in row) for row in samples.points()).encode()


KINDS: Final[dict[str, Kind]] = {
    "bundle": Kind(_file("b.eitskin", _bundle), samples.read_bundle, long=1500),
    "reference": Kind(_file("r.json", _reference), samples.read_reference),
    "configuration": Kind(
        _file("c.toml", partial(_toml, _CONFIGURATION)), samples.read_configuration, (OSError, ValueError)
    ),
    "scene": Kind(_file("s.json", partial(_json, samples.scene)), samples.read_scene, long=400),
    "phantoms": Kind(_file("p.json", partial(_json, _phantoms)), samples.read_phantoms, long=1500),
    "scan-ply": Kind(_file("s.ply", partial(_bytes, samples.ply_binary)), samples.read_scan, long=600),
    "scan-ply-text": Kind(_file("s.ply", partial(_bytes, samples.ply_text)), samples.read_scan, long=600),
    "scan-pcd": Kind(_file("s.pcd", partial(_bytes, partial(_pcd, "binary"))), samples.read_scan, long=600),
    "scan-pcd-text": Kind(_file("s.pcd", partial(_bytes, partial(_pcd, "ascii"))), samples.read_scan, long=600),
    "scan-xyz": Kind(_file("s.xyz", partial(_bytes, _xyz)), samples.read_scan, long=600),
    "scan-npy": Kind(_file("s.npy", partial(_npy, samples.points)), samples.read_scan, long=600),
    "cloud": Kind(_file("c.npz", partial(_npz, samples.cloud)), samples.read_cloud),
    "recording": Kind(_file("r.npy", partial(_npy, samples.recording)), samples.read_recording),
    "data-set": Kind(folders.data_set, samples.read_data_set, prepare=folders.make_data_set, long=800),
    "measured": Kind(_file("m.npz", partial(_npz, evaluated.measured)), evaluated.read_measured, long=800),
    "mismatches": Kind(_file("d.json", partial(_json, evaluated.mismatches)), evaluated.read_mismatches, long=1500),
    "tank": Kind(_file("t.npz", partial(_npz, evaluated.tank)), evaluated.read_tank, (OSError, ValueError), long=800),
    "skin": Kind(_file("s.toml", partial(_toml, evaluated.SKIN)), evaluated.read_skin, (OSError, ValueError)),
    "mcap": Kind(recorded.make, replayed.read, prepare=recorded.prepare, long=2500),
    "robot": Kind(_file("robot.toml", partial(_toml, robots.TOML)), robots.read_toml),
    "robot-state": Kind(_file("robot.json", partial(_json, robots.state)), robots.read_state, long=1500),
    "run": Kind(folders.run, samples.read_run, prepare=folders.make_run, long=400),
}
"""By name."""

LIGHT: Final = tuple(name for name in KINDS if name != "run")
"""Those that need no torch."""
