"""Damaged files and targets that are no files, given to ``eitskin`` itself: one line, a status that is documented."""

import json
import os
import random
import socket
import stat
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from tests.attack.outcome import Effort, Outcome

from . import samples
from .kinds import KINDS

WALL_S: Final = 120.0

READING: Final[dict[str, Callable[[str, Path], list[str]]]] = {
    "bundle": lambda file, folder: ["doctor", "--electrodes", "--recorded", str(folder / "r.npy"), "--bundle", file],
    "reference": lambda file, _: ["reference", "--show", file],
    "configuration": lambda file, _: ["flash", "write", file, "--dry-run"],
    "scene": lambda file, folder: ["simulate", file, "--element-size-mm", "10", "--out", str(folder / "v.npz")],
    "scan-ply": lambda file, folder: ["surface", file, "--out", str(folder / "c.npz")],
    "scan-npy": lambda file, folder: ["surface", file, "--out", str(folder / "c.npz")],
    "recording": lambda file, _: ["doctor", "--electrodes", "--recorded", file],
    "measured": lambda file, _: ["evaluate", "--measured", file],
    "tank": lambda file, _: ["evaluate", "--tank", file],
    "skin": lambda file, _: ["skin", "check", file],
}
"""Command by kind of file, given the file and a folder for what else it needs."""

WRITING: Final[dict[str, list[str]]] = {
    "simulate": ["simulate", "sample", "--element-size-mm", "10", "--out"],
    "surface": ["surface", "sample", "--out"],
    "reference": ["reference", "--port", "/dev/null", "--out"],
    "evaluate": ["evaluate", "--phantoms", "paper_units", "--picture"],
}
"""Commands that end in the name of a file that they write."""

NODES: Final = ("folder", "fifo", "socket", "device")


def command_line(effort: Effort) -> Outcome:
    """Give commands damaged files, and targets that are no files."""
    outcome = Outcome("files.commands")
    rng = random.Random(effort.seed)
    with tempfile.TemporaryDirectory(prefix="a") as name:
        folder = Path(name)
        (folder / "r.npy").write_bytes(samples.npy(samples.recording()))
        for number in range(effort.count(1, 12)):
            for kind, words in READING.items():
                place = folder / f"{kind}-{number}"
                place.mkdir()
                seed = rng.randrange(1 << 30)
                path, what = KINDS[kind].make(place, random.Random(seed))
                _note(outcome, words(str(path), folder), f"{kind}, seed {seed}, {what}")
        commands = list(WRITING.items())
        for node in NODES:
            for command, words in commands if effort.long else [commands[rng.randrange(len(commands))]]:
                path = folder / f"{command}-{node}"
                make(path, node)
                before = (path.lstat().st_ino, path.lstat().st_mode)
                _note(outcome, [*words, str(path)], f"{command} writes to a {node}", failing=True)
                outcome.note(
                    (path.lstat().st_ino, path.lstat().st_mode) == before,
                    f"{command} left something else in place of a {node}",
                )
    return outcome


def make(path: Path, node: str) -> None:
    """Put something that is no regular file at a path; a device only where this user may, else a link to one."""
    if node == "folder":
        path.mkdir()
    elif node == "fifo":
        os.mkfifo(path)
    elif node == "socket":
        where = os.open(path.parent, os.O_RDONLY)
        try:
            with socket.socket(socket.AF_UNIX) as bound:
                bound.bind(f"/proc/self/fd/{where}/{path.name}")  # a socket's path has at most 107 bytes
        finally:
            os.close(where)
    else:
        try:
            os.mknod(path, 0o600 | stat.S_IFCHR, os.makedev(1, 3))
        except PermissionError:
            path.symlink_to("/dev/null")


def _note(outcome: Outcome, words: list[str], what: str, *, failing: bool = False) -> None:
    how: Any
    try:
        done = subprocess.run(
            [sys.executable, "-m", "eitskin_tools.cli", *words], stdin=subprocess.DEVNULL, capture_output=True,
            timeout=WALL_S, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        outcome.note(False, f"{what}: hung for {WALL_S:g} s")
        return
    said, text = done.stderr.decode(errors="replace"), done.stdout.decode(errors="replace")
    how = done.returncode, said[-200:]
    held = done.returncode in ((1, 2) if failing else (0, 1, 2)) and "Traceback" not in said
    held &= all(line.isprintable() for line in (said + text).splitlines())
    held &= done.returncode == 0 or said.count("\n") >= 1
    outcome.note(held, f"{what}: {json.dumps(how)}")
