"""``eitskin run`` is told to end at random moments of its life: it ends soon, cleanly, and leaves nothing.

Each runtime has a virtual skin of its own, and is ended while modules are loaded, a reference is captured, frames are
streamed, over TCP with keys too, and verified, a control request waits, the device is silent, or its port is gone.
"""

import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any, Final

import msgpack
import zmq

from eitskin.messaging.curve_keys import load_client_keys, make_keys

from ..outcome import Effort, Outcome
from ..stream import PATIENCE_S, ROOT, TINY, ended, start_skin

MOMENTS: Final = 1000
"""Of the long form."""
CTRL_C: Final = 5
"""One in so many is by SIGINT, the others by SIGTERM."""
AT_ONCE: Final = 6
MOST_S: Final = 5.0
"""By the clock, on a busy machine; the figures say how long it takes, which is tenths of a second."""

LIVES: Final = ("start", "start", "capture", "stream", "control", "silent", "unplugged", "curve", "verify")

WRONG: Final = ("Traceback", "terminate called", "Fatal Python", "Assertion", "Exception ignored")

TCP: Final = "tcp://127.0.0.1:*"


def _options(life: str, folder: Path, keys: Path) -> list[str]:
    if life == "curve":
        return ["--publish", TCP, "--control", TCP, "--curve-keys", str(keys)]
    more = {"unplugged": ["--reconnect", "60"], "verify": ["--verify", "always"]}.get(life, [])
    return ["--publish", f"ipc://{folder}/f", "--control", f"ipc://{folder}/c", *more]


def _ended_once(life: str, number: int, draw: random.Random) -> tuple[float, str]:
    """End one runtime; return how many seconds that took, and what was wrong."""
    with ExitStack() as stack:
        folder, keys = (Path(stack.enter_context(tempfile.TemporaryDirectory(prefix=letter))) for letter in "ak")
        make_keys(keys)
        skin, port = start_skin(rate_hz=200)
        stack.callback(ended, skin)
        out = folder / "out"
        words = ["run", "--bundle", str(TINY), "--port", port, "--json", *_options(life, folder, keys)]
        words += ["--reference-frames", "10000" if life == "capture" else "5"]
        process = subprocess.Popen(
            [sys.executable, "-m", "eitskin_tools.cli", *words],
            stdin=subprocess.DEVNULL, stdout=stack.enter_context(out.open("w")), stderr=subprocess.STDOUT, cwd=ROOT,
        )  # fmt: skip
        stack.callback(process.wait)
        stack.callback(process.kill)
        if life == "start":
            time.sleep(draw.uniform(0.0, 1.5))
        elif not _said(process, out, "capturing" if life == "capture" else "ready "):
            return 0.0, f"it was not ready: {_text(out)}"
        else:
            _live(life, stack, skin, keys, _text(out).split())
            time.sleep(draw.uniform(0.0, 2.5 if life == "silent" else 0.3))
        children = _children(process.pid)
        began_s = time.monotonic()
        process.send_signal(number)
        with suppress(subprocess.TimeoutExpired):
            process.wait(MOST_S)
        took_s = time.monotonic() - began_s
        if process.poll() is None:
            return took_s, f"it did not end within {MOST_S:g} s: {_text(out)[-700:]}"
        if living := [child for child in children if not _gone(child)]:
            return took_s, f"it left processes {living}"
        if left := [path.name for path in folder.iterdir() if path != out]:
            return took_s, f"it left {left}"
        return took_s, _judged(life, number, process.returncode, _text(out))


def _live(life: str, stack: ExitStack, skin: "subprocess.Popen[str]", keys: Path, said: list[str]) -> None:
    """Do what a life is about."""
    context: Any = zmq.Context()
    context.linger = 0
    stack.callback(context.term)
    match life:
        case "silent":  # after a second the device is greeted anew, in vain
            skin.send_signal(signal.SIGSTOP)
            stack.callback(skin.send_signal, signal.SIGCONT)
        case "unplugged":
            ended(skin)
        case "control":  # some requests wait, that for a reference first
            for command in [{"command": "reference", "frames": 10_000}, *[{"command": "status"}] * 2]:
                socket = stack.enter_context(context.socket(zmq.REQ))
                socket.connect(said[said.index("ready") + 5])
                socket.send(msgpack.packb(command))
        case "stream" | "curve" | "verify":
            socket = stack.enter_context(context.socket(zmq.SUB))
            if life == "curve":
                load_client_keys(keys / "server.key", keys / "client.key_secret").apply(socket)
            socket.subscribe(b"")
            socket.connect(said[said.index("ready") + 3])


def _judged(life: str, number: int, status: int, text: str) -> str:
    """Return what was wrong with an end; nothing if all was well."""
    wrong = any(word in text for word in WRONG)
    if (
        number == signal.SIGINT
        and "commands/run.py" not in text
        and ("KeyboardInterrupt" in text or (status == 130 and not text))
    ):
        return ""  # Ctrl-C met Python while it started, whose own ways hold until ``eitskin run`` has begun
    if status == -number and "firmware" not in text and not wrong:
        return ""  # it had opened nothing yet
    if wrong or status != 0:
        return f"its exit status was {status}, and it said: {text[-700:]}"
    return "" if life == "start" or '"frames"' in text else f"it printed no summary: {text[-700:]}"


def _children(process: int) -> list[int]:
    """Return the processes that a process started and that run."""
    with suppress(OSError):
        tasks = list(Path(f"/proc/{process}/task").iterdir())
        return [int(child) for task in tasks for child in (task / "children").read_text().split()]
    return []


def _gone(process: int) -> bool:
    """Return whether a process has ended, or does so soon."""
    until_s = time.monotonic() + 4 * MOST_S
    with suppress(OSError):
        while Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX":
            if time.monotonic() > until_s:
                return False
            time.sleep(0.01)
    return True


def _said(process: "subprocess.Popen[bytes]", out: Path, word: str) -> bool:
    """Wait until it says a word, and return whether it did."""
    until_s = time.monotonic() + PATIENCE_S
    while word not in _text(out):
        if process.poll() is not None or time.monotonic() > until_s:
            return False
        time.sleep(0.01)
    return True


def _text(out: Path) -> str:
    return out.read_text(errors="replace").strip()


def random_moments(effort: Effort) -> Outcome:
    """End runtimes at random moments: each life once, or a thousand moments of all lives."""
    outcome = Outcome("run.terminated")
    lives = random.Random(effort.seed).choices(LIVES, k=MOMENTS) if effort.long else LIVES
    ctrl_c = signal.getsignal(signal.SIGINT) != signal.SIG_IGN  # as behind a shell's "&", and runtimes inherit that
    numbers = [signal.SIGINT if at % CTRL_C == CTRL_C - 1 and ctrl_c else signal.SIGTERM for at in range(len(lives))]
    draws = [random.Random(f"{effort.seed}/{at}") for at in range(len(lives))]
    with ThreadPoolExecutor(effort.count(1, AT_ONCE)) as pool:
        found = list(pool.map(_ended_once, lives, numbers, draws))
    for at, (life, number, (_, wrong)) in enumerate(zip(lives, numbers, found, strict=True)):
        outcome.note(not wrong, f"moment {at}, {life}, {number.name}: {wrong}")
    times_s, spread = sorted(took_s for took_s, _ in found), {"p50": 0.5, "p99": 0.99, "max": 1.0}
    outcome.figures["exit_s"] = {name: round(times_s[int(part * (len(found) - 1))], 3) for name, part in spread.items()}
    outcome.figures["lives"] = dict(Counter(lives))
    return outcome
