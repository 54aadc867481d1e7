"""The kinds of files that are attacked: how a sample is made and damaged, and what reads it."""

import copy
import json
import random
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from tests.runtime.model import hostile_graphs

from eitskin_proto.files.digest import sha256_of

from . import mutations, recorded, samples
from .samples import ROOT, TINY, commanded

Make = Callable[[Path, random.Random | None], tuple[Path, str]]
"""Puts a sample into a folder, damaged unless there is no generator; returns its path and what was done."""

Draw = Callable[[random.Random | None], tuple[bytes, str]]
"""Returns a sample's bytes, likewise."""

SCANS: Final = ("ply", "ply-text", "pcd", "pcd-text", "xyz", "npy")
MOST_ELEMENTS: Final = 10_000
"""Of a mesh that is solved; the default scene has 8,500."""


@dataclass(frozen=True)
class Kind:
    """One kind of file."""

    make: Make
    read: Callable[[Path], object]
    """Reads a sample as a command would, as far as what the file says has an effect."""
    long: int = 2000
    """Tries of the long form; fewer where each takes longer."""


def _file(name: str, draw: Draw) -> Make:
    def make(folder: Path, rng: random.Random | None) -> tuple[Path, str]:
        path = folder / name
        content, what = draw(rng)
        path.write_bytes(content)
        return path, what

    return make


def _scan(folder: Path, rng: random.Random | None) -> tuple[Path, str]:
    form = "ply" if rng is None else rng.choice(SCANS)
    return _file(f"s.{form.removesuffix('-text')}", partial(_bytes, lambda: samples.scan(form)))(folder, rng)


def _bytes(whole: Callable[[], bytes], rng: random.Random | None) -> tuple[bytes, str]:
    return (whole(), "whole") if rng is None else (mutations.bent(whole(), rng), "bytes")


def _json(whole: Callable[[], Any], rng: random.Random | None) -> tuple[bytes, str]:
    if rng is None or rng.random() < 0.15:
        return _bytes(lambda: json.dumps(whole()).encode(), rng)
    return mutations.text_of(mutations.changed(whole(), rng)).encode(), "values"


def _reference(rng: random.Random | None) -> tuple[bytes, str]:
    if rng is None or rng.random() < 0.2:
        return _bytes(lambda: samples.sealed(samples.reference()), rng)
    return samples.sealed(mutations.changed(samples.reference(), rng)), "values, sealed again"


def _npy(rng: random.Random | None) -> tuple[bytes, str]:
    if rng is None or rng.random() < 0.5:
        return _bytes(lambda: samples.npy(np.tile(samples.VOLTS, (500, 1))), rng)
    return mutations.array(rng), "another array"


def _npz(whole: Callable[[], dict[str, Any]], rng: random.Random | None) -> tuple[bytes, str]:
    arrays = whole()
    if rng is None:
        return samples.npz(**arrays), "whole"
    parts = {f"{name}.npy": samples.npy(value) for name, value in arrays.items()}
    if rng.random() < 0.4:
        return mutations.archive(parts, rng), "archive"
    name, strange = rng.choice(list(arrays)), rng.random() < 0.5
    parts[f"{name}.npy"] = mutations.array(rng) if strange else mutations.valued(arrays[name], rng)
    return mutations.zipped(parts), f"{name}: {'another array' if strange else 'other values'}"


FACTORS: Final = (-1.0, 0.0, 1e-9, 1e-3, 0.1, 0.5, 0.9, 1.1, 2.0, 10.0, 1e3, 1e9, 1e300)
"""What a number of a TOML file is multiplied by."""

VALUES: Final = (
    "1e400", "-1", "nan", "inf", "true", "[]", "{}", '"\\u001b[2J"', "1" * 5000, "[" * 60_000, "1979-05-27", "[[[]]]",
    '"' + "x" * 99 + '"', "0", "0x7fffffffffffffffffff", "[" + "1," * 20_000 + "]", "{a={a={a={}}}}",
)  # fmt: skip
"""What stands in place of a value of a TOML file."""


def _toml(whole: bytes, rng: random.Random | None) -> tuple[bytes, str]:
    if rng is None or rng.random() < 0.3:
        return _bytes(lambda: whole, rng)
    lines = whole.decode().splitlines()
    for _ in range(rng.choice((1, 1, 2))):
        at = rng.randrange(len(lines))
        key, _, value = lines[at].partition("=")
        numbers = re.findall(r"\d+(?:\.\d+)?(?![\d.])", value)  # and none in the midst of 127.0.0.1
        if numbers and rng.random() < 0.3:
            one = rng.choice(numbers)
            lines[at] = f"{key}={value.replace(one, str(float(one) * rng.choice(FACTORS)), 1)}"
        elif rng.random() < 0.1:
            lines.insert(at, rng.choice((".".join("a" * 4000) + " = 1", lines[at], "\x1b = 1", "[" * 5000)))
        else:
            lines[at] = f"{key}= {rng.choice(VALUES)}" if "=" in lines[at] else rng.choice(("[x]", "", "[[a]]"))
    return "\n".join(lines).encode(), "values"


def _bundle(rng: random.Random | None) -> tuple[bytes, str]:
    parts = samples.members(TINY.read_bytes())
    manifest = json.loads(parts.pop("manifest.json"))
    how = -1 if rng is None else rng.randrange(8)
    if rng is None or how == 7:
        return _bytes(TINY.read_bytes, rng)
    if how < 2:
        text = mutations.text_of(mutations.changed(copy.deepcopy(manifest), rng))
        return mutations.zipped({"manifest.json": text.encode(), **parts}), "manifest"
    if how == 6:
        return mutations.archive({"manifest.json": json.dumps(manifest).encode(), **parts}, rng), "archive"
    if how < 5:
        name = rng.choice([name for name in parts if name.endswith(".onnx")])
        parts[name], what = hostile_graphs.hostile(parts[name], rng)
    else:
        name, what = rng.choice(list(parts)), "is another"
        parts[name] = mutations.array(rng) if name.endswith(".npy") else mutations.bent(parts[name], rng)
    manifest["files"][name]["sha256"] = sha256_of(parts[name])
    return mutations.zipped({"manifest.json": json.dumps(manifest).encode(), **parts}), f"{name}: {what}"


def _read_bundle(path: Path) -> None:
    """Infer a map: an untouched and a touched sheet's."""
    from tests.attack.line.line import FLAT, HELLO, Line

    import eitskin
    from eitskin.errors import PortLost

    def send(line: Line, number: int) -> bytes:
        touched = 1.0 + 0.3 * (number > 12) * np.cos(np.arange(104))
        return line.frame(counts=np.rint(FLAT * touched * (1 + 1e-4 * line.rng.standard_normal(104))).astype(np.int32))

    with eitskin.Skin(Line(send, HELLO, clocked=False, scans_left=16), bundle=path) as skin:
        skin.capture_reference(10)
        skin.set_cloud(skin.bundle.skin.grid.flat_cloud_mm())
        try:
            for frame in skin.frames():
                if not np.isfinite(frame.map).all():
                    raise AssertionError("a map that is not finite was published")
        except PortLost:
            pass  # all is sent


def _read_scene(path: Path) -> None:
    """Load a scene and solve it, where that takes seconds and not the minute that a fine mesh may take."""
    from eitskin_sim.fem.meshing import scene_mesh
    from eitskin_sim.fem.solve import solve_scene
    from eitskin_sim.scene.scene import load_scene

    scene = load_scene(path)
    if scene_mesh(scene).n_elements > MOST_ELEMENTS:
        return
    if not np.isfinite(solve_scene(scene).voltages).all():  # the contact law of data sets: seconds faster
        raise AssertionError("voltages that are not finite would be written")


def _read_scan(path: Path) -> None:
    from eitskin_sim.surface.ordered_cloud import organise
    from eitskin_sim.surface.point_files import read_points

    organise(read_points(path))


def _read_cloud(path: Path) -> None:
    from eitskin_proto.skin.cloud import align_cloud
    from eitskin_proto.skin.cloud_file import load_surface

    align_cloud(load_surface(path).cloud_mm)


def _command(*words: str) -> Callable[[Path], None]:
    """Return what gives a file to a command as its last word, or where a word is ``FILE``."""

    def read(path: Path) -> None:
        told = [str(path) if word == "FILE" else word for word in words]
        commanded(path.parent, *told, *([] if "FILE" in words else [str(path)]))

    return read


_PROTO: Final = ROOT / "firmware_proto" / "eitskin_proto"

KINDS: Final[dict[str, Kind]] = {
    "bundle": Kind(_file("b.eitskin", _bundle), _read_bundle, 1500),
    "reference": Kind(_file("r.json", _reference), _command("reference", "--show")),
    "configuration": Kind(
        _file("c.toml", partial(_toml, (_PROTO / "configurations" / "idle.toml").read_bytes())),
        _command("flash", "write", "FILE", "--dry-run"),
    ),
    "skin": Kind(
        _file("s.toml", partial(_toml, (_PROTO / "skins" / "hydrogel.toml").read_bytes())), _command("skin", "check")
    ),
    "robot": Kind(_file("robot.toml", partial(_toml, samples.ROBOT)), _command("run", "--check", "--config")),
    "scene": Kind(_file("s.json", partial(_json, samples.scene)), _read_scene, 400),
    "scan": Kind(_scan, _read_scan, 1500),
    "cloud": Kind(_file("c.npz", partial(_npz, samples.cloud)), _read_cloud),
    "voltages": Kind(_file("r.npy", _npy), _command("doctor", "--electrodes", "--recorded")),
    "recording": Kind(recorded.make, recorded.read, 2500),
    "measured": Kind(_file("m.npz", partial(_npz, samples.measured)), _command("evaluate", "--measured"), 800),
}
"""By name."""
