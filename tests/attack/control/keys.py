"""A folder of keys in which somebody else may write, or in which files are damaged: who enters is what was meant."""

import os
import random
import shutil
import tempfile
from pathlib import Path

from eitskin.errors import EndpointError
from eitskin.messaging.curve_keys import load_server_keys, make_keys

from ..outcome import Effort, Outcome

PARTS = (".", "clients", "clients/client.key", "server.key_secret")


def key_folders(effort: Effort) -> Outcome:
    """Spoil copies of a folder of keys at random."""
    outcome, draw = Outcome("control.keys"), random.Random(effort.seed)
    with tempfile.TemporaryDirectory(prefix="a") as name:
        good = Path(name) / "good"
        make_keys(good)
        meant = load_server_keys(good).admitted
        text = (good / "clients" / "client.key").read_bytes()
        open_files = len(os.listdir("/proc/self/fd"))
        for number in range(effort.count(150, 5000)):
            spoilt = Path(name) / "spoilt"
            shutil.copytree(good, spoilt)
            try:
                kind = _spoil(spoilt, text, draw)
                outcome.note(_holds(spoilt, meant, kind), f"folder {number}, seed {effort.seed}: {kind}")
            finally:
                shutil.rmtree(spoilt)
        left = len(os.listdir("/proc/self/fd")) - open_files
        outcome.note(left == 0, f"{left} files were left open")
    return outcome


def _spoil(folder: Path, text: bytes, draw: random.Random) -> str:
    """Do something to a folder, and return what: ``writable``, ``damaged`` or ``crowded``."""
    kind = draw.choices(["writable", "damaged", "crowded"], [10, 10, 0.1])[0]
    match kind:
        case "writable":
            path = folder / draw.choice(PARTS)
            path.chmod(path.stat().st_mode | draw.choice([0o002, 0o020, 0o022]))
        case "damaged":
            for number in range(draw.randrange(1, 6)):
                _put_damaged(folder / "clients" / f"{number}.key", text, draw)
        case "crowded":
            for number in range(1001):
                (folder / "clients" / f"{number}.key").write_bytes(text)
    return kind


def _put_damaged(path: Path, text: bytes, draw: random.Random) -> None:
    match draw.choice(["bits", "cut", "noise", "fifo", "link", "folder", "endless"]):
        case "bits":
            where = text.index(b'public-key = "') + 14 + draw.randrange(40)
            path.write_bytes(text[:where] + bytes([draw.choice([0, 9, 10, 32, 34, 200])]) + text[where + 1 :])
        case "cut":
            path.write_bytes(text[: draw.randrange(text.index(b'public-key = "') + 54)])
        case "noise":
            path.write_bytes(draw.randbytes(draw.choice([0, 1, 100, 100_000])))
        case "fifo":
            os.mkfifo(path, 0o600)
            return
        case "link":
            path.symlink_to("nowhere")
            return
        case "endless":
            path.symlink_to("/dev/zero")
            return
        case "folder":
            path.mkdir(0o700)
            return
    path.chmod(0o600)


def _holds(folder: Path, meant: frozenset[bytes], kind: str) -> bool:
    try:
        found = load_server_keys(folder)
    except EndpointError as error:
        return kind != "damaged" and "\n" not in str(error)
    return kind == "damaged" and found.admitted == meant and len(found.damaged) > 0
