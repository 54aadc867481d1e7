"""``eitskin run`` is told to end at random moments of its life: it ends within a second, cleanly, and leaves nothing.

Six runtimes go beside each other, each on a virtual skin of its own, from the interpreter's start on: while modules are
loaded, the device is greeted, a reference captured, frames streamed, over TCP with CURVE keys too, and verified, a
control request waits, the device is silent, or its port is gone. The second is the process's own
(:mod:`tests.attack.shutdown.exit_time`); both times are among the figures.
"""

import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any, Final

import msgpack
import zmq

from eitskin.messaging.curve_keys import ClientKeys, load_client_keys, make_keys

from ..outcome import Effort, Outcome
from ..stream import PATIENCE_S, ROOT, SKIN, TINY
from .exit_time import SURELY_S, ExitTime, Watch
from .judged import LAST, judge

MOMENTS: Final = 1250
"""Of the long form: one in ``CTRL_C`` is by SIGINT, so 1,000 are by SIGTERM."""

CTRL_C: Final = 5

OLDEST_S: Final = 150.0
"""After which a lane's skin is replaced: it ends by itself after 300."""

LANES: Final = 6

LIVES: Final = {
    "start": 5, "capture": 3, "stream": 3, "control": 3, "silent": 2, "unplugged": 1,
    "curve": 4, "verify_idle": 2, "verify_always": 2,
}  # fmt: skip
"""Where in its life a runtime is ended, and how often, one against the other."""

IN_MEMORY: Final = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
"""Where sockets, keys and output lie, if the machine has it: a wait for a disk would count as the process's own."""

TCP: Final = "tcp://127.0.0.1:*"


class Lane:
    """Runs runtimes one after the other on a skin of its own; release it with ``close``."""

    def __init__(self) -> None:
        self._folder, self._keys = (Path(tempfile.mkdtemp(prefix=letter, dir=IN_MEMORY)) for letter in "ak")
        make_keys(self._keys)
        self._context: Any = zmq.Context()
        self._watch = Watch()
        self._start_s = 1.0
        """How long it took until frames came, the last time."""
        self._skin, self._port, self._skin_since_s = *_skin(), time.monotonic()

    def close(self) -> None:
        """End the skin."""
        self._end_skin()
        self._watch.close()
        self._context.destroy(0)
        for folder in (self._folder, self._keys):
            shutil.rmtree(folder)

    def _end_skin(self) -> None:
        with suppress(ProcessLookupError):
            self._skin.send_signal(signal.SIGCONT)
        self._skin.terminate()
        self._skin.communicate(timeout=PATIENCE_S)

    def one(self, life: str, number: int, draw: random.Random) -> tuple[ExitTime | None, str]:
        """End one runtime, and return how long that took and what was wrong; nothing if all was well."""
        if time.monotonic() - self._skin_since_s > OLDEST_S or self._skin.poll() is not None:
            self._end_skin()
            self._skin, self._port, self._skin_since_s = *_skin(), time.monotonic()
        out = self._folder / "out"
        words = [sys.executable, "-m", "eitskin_tools.cli", "run", "--bundle", TINY, "--port", self._port, "--json"]
        words += ["--reference-frames", "100000" if life == "capture" else "5", *self._options(life)]
        with ExitStack() as stack, out.open("w") as file:
            process = subprocess.Popen(
                list(map(str, words)), stdin=subprocess.DEVNULL, stdout=file, stderr=subprocess.STDOUT, cwd=ROOT
            )
            stack.callback(_finish, process)
            began_s = time.monotonic()
            if life == "start":
                time.sleep(draw.uniform(0.0, self._start_s))
            elif not _said(process, out, "capturing" if life == "capture" else "ready "):
                return None, f"it was not ready: {_last(out)}"
            else:
                self._start_s = time.monotonic() - began_s
                said = out.read_text(errors="replace").split()
                at = said.index("ready") if "ready" in said else -6
                getattr(self, f"_{life}")(stack, said[at + (5 if life == "control" else 3)], draw)
            children = _children(process.pid)
            took = self._watch.end(process.pid, number)
        if took is not None and (living := [child for child in children if not _gone(child)]):
            return took, f"it left processes {living}"
        left = [path.name for path in self._folder.iterdir() if path != out]
        for name in left:
            (self._folder / name).unlink()
        if took is None:
            return None, f"it did not end within {SURELY_S:g} s of its own: {_last(out)}"
        if left:
            return took, f"it left {left}"
        return took, judge(life, number, process.returncode, took, out.read_text(errors="replace"))

    def _options(self, life: str) -> list[str]:
        """Return the options of ``eitskin run`` of a life."""
        ipc = ["--publish", f"ipc://{self._folder}/f", "--control", f"ipc://{self._folder}/c"]
        match life:
            case "unplugged":
                return [*ipc, "--reconnect", "60"]
            case "curve":
                return ["--publish", TCP, "--control", TCP, "--curve-keys", str(self._keys)]
            case "verify_idle" | "verify_always":
                return [*ipc, "--verify", life.partition("_")[2]]
        return ipc

    def _capture(self, stack: ExitStack, where: str, draw: random.Random) -> None:
        time.sleep(draw.uniform(0.0, 0.2))

    def _stream(self, stack: ExitStack, where: str, draw: random.Random) -> None:
        self._subscribe(stack, where, [b""])
        time.sleep(draw.uniform(0.0, 0.3))

    _verify_idle = _verify_always = _stream

    def _curve(self, stack: ExitStack, where: str, draw: random.Random) -> None:
        keys = load_client_keys(self._keys / "server.key", self._keys / "client.key_secret")
        self._subscribe(stack, where, [b""], keys)
        time.sleep(draw.uniform(0.0, 0.3))

    def _control(self, stack: ExitStack, where: str, draw: random.Random) -> None:
        """Let some requests wait, that for a reference first."""
        for command in [{"command": "reference", "frames": 10_000}, *[{"command": "status"}] * draw.randrange(3)]:
            socket = self._context.socket(zmq.REQ)
            stack.callback(socket.close, 0)
            socket.connect(where)
            socket.send(msgpack.packb(command))
        time.sleep(draw.uniform(0.0, 0.2))

    def _silent(self, stack: ExitStack, where: str, draw: random.Random) -> None:
        """Let the device fall silent; after a second it is greeted anew, in vain."""
        self._skin.send_signal(signal.SIGSTOP)
        stack.callback(self._skin.send_signal, signal.SIGCONT)
        time.sleep(draw.uniform(0.0, 2.5))

    def _unplugged(self, stack: ExitStack, where: str, draw: random.Random) -> None:
        self._end_skin()
        time.sleep(draw.uniform(0.0, 0.3))

    def _subscribe(self, stack: ExitStack, where: str, topics: list[bytes], keys: ClientKeys | None = None) -> None:
        socket = self._context.socket(zmq.SUB)
        stack.callback(socket.close, 0)
        if keys is not None:
            keys.apply(socket)
        socket.connect(where)
        for topic in topics:
            socket.setsockopt(zmq.SUBSCRIBE, topic)


def _children(process: int) -> list[int]:
    """Return the processes that a process started and that run."""
    with suppress(OSError):
        tasks = list(Path(f"/proc/{process}/task").iterdir())
        return [int(child) for task in tasks for child in (task / "children").read_text().split()]
    return []


def _gone(process: int) -> bool:
    """Return whether a process has ended, or does so soon: its parent's end ends it, and somebody must collect it."""
    until_s = time.monotonic() + SURELY_S
    while time.monotonic() < until_s:
        try:
            if Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] in "ZX":
                return True
        except OSError:
            return True
        time.sleep(0.01)
    return False


def _skin() -> tuple["subprocess.Popen[str]", str]:
    process = subprocess.Popen([sys.executable, str(SKIN), '{"rate_hz": 200}'], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    return process, process.stdout.readline().strip()


def _said(process: "subprocess.Popen[bytes]", out: Path, word: str) -> bool:
    """Wait until it says a word, and return whether it did."""
    until_s = time.monotonic() + PATIENCE_S
    while word not in out.read_text(errors="replace"):
        if process.poll() is not None or time.monotonic() > until_s:
            return False
        time.sleep(0.01)
    return True


def _finish(process: "subprocess.Popen[bytes]") -> None:
    if process.poll() is None:
        process.kill()
    process.wait()


def _last(out: Path) -> str:
    return out.read_text(errors="replace").strip()[-LAST:]


def random_moments(effort: Effort) -> Outcome:
    """End runtimes at random moments."""
    draw = random.Random(effort.seed)
    lives = list(LIVES)
    return at_moments(effort, draw.choices(lives, list(LIVES.values()), k=MOMENTS) if effort.long else lives)


def at_moments(effort: Effort, lives: list[str]) -> Outcome:
    """End a runtime in each of these lives."""
    outcome = Outcome("run.terminated")
    moments = list(enumerate(lives))
    moments.reverse()
    ctrl_c = signal.getsignal(signal.SIGINT) != signal.SIG_IGN  # as behind a shell's "&", and runtimes inherit that
    lock, times, seen = threading.Lock(), [], Counter[str]()

    def work(lane: Lane) -> None:
        try:
            while True:
                with lock:
                    if not moments:
                        return
                    index, life = moments.pop()
                number = signal.SIGINT if index % CTRL_C == CTRL_C - 1 and ctrl_c else signal.SIGTERM
                took, wrong = lane.one(life, number, random.Random(f"{effort.seed}/{index}"))
                with lock:
                    seen[life] += 1
                    if took is not None:
                        times.append(took)
                    outcome.note(not wrong, f"moment {index}, {life}, {signal.Signals(number).name}: {wrong}")
        finally:
            lane.close()

    lanes = [Lane() for _ in range(effort.count(1, LANES))]  # here: keys are made under a umask, the whole process's
    threads = [threading.Thread(target=work, args=(lane,)) for lane in lanes]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    outcome.figures |= {"lives": dict(seen), "exit_own_s": _spread(times, lambda took: took.own_s)}
    outcome.figures["exit_by_the_clock_s"] = _spread(times, lambda took: took.raw_s)
    return outcome


def _spread(times: list[ExitTime], of: Callable[[ExitTime], float]) -> dict[str, float]:
    found = sorted(map(of, times)) or [float("nan")]
    return {
        "p50": round(found[len(found) // 2], 3),
        "p99": round(found[min(len(found) - 1, len(found) * 99 // 100)], 3),
        "max": round(found[-1], 3),
    }
