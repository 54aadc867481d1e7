"""``eitskin run`` is told to end at random moments of its life: it ends soon, cleanly, and leaves nothing.

Several runtimes go beside each other, each on a virtual skin of its own, from the interpreter's start on: while modules
are loaded, the device is greeted, a reference captured, frames streamed, over TCP with keys too, and verified, a
control request waits, the device is silent, or its port is gone.
"""

import random
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
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
OLDEST_S: Final = 150.0
"""After which a lane's skin is replaced: it ends by itself after 300."""
LANES: Final = 6
MOST_S: Final = 5.0
"""By the clock, on a busy machine; the figures say how long it takes, which is tenths of a second."""

LIVES: Final = ("start", "start", "capture", "stream", "control", "silent", "unplugged", "curve", "verify")

WRONG: Final = ("Traceback", "terminate called", "Fatal Python", "Assertion", "Exception ignored")

TCP: Final = "tcp://127.0.0.1:*"


class Lane:
    """Runs runtimes one after the other on a skin of its own; release it with ``close``."""

    def __init__(self) -> None:
        self._folder, self._keys = (Path(tempfile.mkdtemp(prefix=letter)) for letter in "ak")
        make_keys(self._keys)
        self._context: Any = zmq.Context()
        self._start_s = 1.0
        """How long it took until frames came, the last time."""
        self._skin, self._port, self._skin_since_s = *start_skin(rate_hz=200), time.monotonic()

    def close(self) -> None:
        """End the skin."""
        ended(self._skin)
        self._context.destroy(0)
        for folder in (self._folder, self._keys):
            shutil.rmtree(folder)

    def one(self, life: str, number: int, draw: random.Random) -> tuple[float, str]:
        """End one runtime; return how many seconds that took, and what was wrong."""
        if time.monotonic() - self._skin_since_s > OLDEST_S or self._skin.poll() is not None:
            ended(self._skin)
            self._skin, self._port, self._skin_since_s = *start_skin(rate_hz=200), time.monotonic()
        out = self._folder / "out"
        words = ["run", "--bundle", str(TINY), "--port", self._port, "--json", *self._options(life)]
        words += ["--reference-frames", "100000" if life == "capture" else "5"]
        with ExitStack() as stack, out.open("w") as file:
            process = subprocess.Popen(
                [sys.executable, "-m", "eitskin_tools.cli", *words],
                stdin=subprocess.DEVNULL, stdout=file, stderr=subprocess.STDOUT, cwd=ROOT,
            )  # fmt: skip
            stack.callback(process.wait)
            stack.callback(process.kill)
            began_s = time.monotonic()
            if life == "start":
                time.sleep(draw.uniform(0.0, self._start_s))
            elif not _said(process, out, "capturing" if life == "capture" else "ready "):
                return 0.0, f"it was not ready: {_last(out)}"
            else:
                self._start_s = time.monotonic() - began_s
                self._live(life, stack, out.read_text(errors="replace").split(), draw)
            children = _children(process.pid)
            began_s = time.monotonic()
            process.send_signal(number)
            with suppress(subprocess.TimeoutExpired):
                process.wait(MOST_S)
            took_s = time.monotonic() - began_s
            if process.poll() is None:
                return took_s, f"it did not end within {MOST_S:g} s: {_last(out)}"
        if living := [child for child in children if not _gone(child)]:
            return took_s, f"it left processes {living}"
        left = [path for path in self._folder.iterdir() if path != out]
        for path in left:
            path.unlink()
        if left:
            return took_s, f"it left {left}"
        return took_s, _judged(life, number, process.returncode, out.read_text(errors="replace"))

    def _options(self, life: str) -> list[str]:
        ipc = ["--publish", f"ipc://{self._folder}/f", "--control", f"ipc://{self._folder}/c"]
        match life:
            case "unplugged":
                return [*ipc, "--reconnect", "60"]
            case "curve":
                return ["--publish", TCP, "--control", TCP, "--curve-keys", str(self._keys)]
            case "verify":
                return [*ipc, "--verify", "always"]
        return ipc

    def _live(self, life: str, stack: ExitStack, said: list[str], draw: random.Random) -> None:
        """Do what a life is about, and wait for some moment of it."""
        match life:
            case "silent":  # after a second the device is greeted anew, in vain
                self._skin.send_signal(signal.SIGSTOP)
                stack.callback(self._skin.send_signal, signal.SIGCONT)
            case "unplugged":
                ended(self._skin)
            case "control":  # some requests wait, that for a reference first
                where = said[said.index("ready") + 5]
                for command in [{"command": "reference", "frames": 10_000}, *[{"command": "status"}] * 2]:
                    self._connect(stack, zmq.REQ, where).send(msgpack.packb(command))
            case "stream" | "curve" | "verify":
                self._connect(stack, zmq.SUB, said[said.index("ready") + 3], keys=life == "curve")
        time.sleep(draw.uniform(0.0, 2.5 if life == "silent" else 0.3))

    def _connect(self, stack: ExitStack, kind: int, where: str, keys: bool = False) -> Any:
        socket = self._context.socket(kind)
        stack.callback(socket.close, 0)
        if keys:
            load_client_keys(self._keys / "server.key", self._keys / "client.key_secret").apply(socket)
        if kind == zmq.SUB:
            socket.subscribe(b"")
        socket.connect(where)
        return socket


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
        return f"its exit status was {status}, and it said: {text.strip()[-700:]}"
    return "" if life == "start" or '"frames"' in text else f"it printed no summary: {text.strip()[-700:]}"


def _children(process: int) -> list[int]:
    """Return the processes that a process started and that run."""
    with suppress(OSError):
        tasks = list(Path(f"/proc/{process}/task").iterdir())
        return [int(child) for task in tasks for child in (task / "children").read_text().split()]
    return []


def _gone(process: int) -> bool:
    """Return whether a process has ended, or does so soon: its parent's end ends it, and somebody must collect it."""
    until_s = time.monotonic() + 4 * MOST_S
    while time.monotonic() < until_s:
        try:
            if Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] in "ZX":
                return True
        except OSError:
            return True
        time.sleep(0.01)
    return False


def _said(process: "subprocess.Popen[bytes]", out: Path, word: str) -> bool:
    """Wait until it says a word, and return whether it did."""
    until_s = time.monotonic() + PATIENCE_S
    while word not in out.read_text(errors="replace"):
        if process.poll() is not None or time.monotonic() > until_s:
            return False
        time.sleep(0.01)
    return True


def _last(out: Path) -> str:
    return out.read_text(errors="replace").strip()[-700:]


def random_moments(effort: Effort) -> Outcome:
    """End runtimes at random moments: each life once, or a thousand moments of all lives."""
    outcome = Outcome("run.terminated")
    lives = random.Random(effort.seed).choices(LIVES, k=MOMENTS) if effort.long else LIVES
    moments = list(enumerate(lives))[::-1]
    ctrl_c = signal.getsignal(signal.SIGINT) != signal.SIG_IGN  # as behind a shell's "&", and runtimes inherit that
    lock, times_s = threading.Lock(), list[float]()

    def work(lane: Lane) -> None:
        while True:
            with lock:
                if not moments:
                    return
                index, life = moments.pop()
            number = signal.SIGINT if index % CTRL_C == CTRL_C - 1 and ctrl_c else signal.SIGTERM
            took_s, wrong = lane.one(life, number, random.Random(f"{effort.seed}/{index}"))
            with lock:
                times_s.append(took_s)
                outcome.note(not wrong, f"moment {index}, {life}, {signal.Signals(number).name}: {wrong}")

    with ExitStack() as stack:
        lanes = [Lane() for _ in range(effort.count(1, LANES))]
        for lane in lanes:
            stack.callback(lane.close)
        threads = [threading.Thread(target=work, args=(lane,)) for lane in lanes]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    found, spread = sorted(times_s), {"p50": 0.5, "p99": 0.99, "max": 1.0}
    outcome.figures["exit_s"] = {name: round(found[int(part * (len(found) - 1))], 3) for name, part in spread.items()}
    outcome.figures["lives"] = dict(Counter(lives))
    return outcome
