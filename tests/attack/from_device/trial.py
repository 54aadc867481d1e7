"""A hostile device, ``eitskin run`` on it, and a witness: what an attack orders, and what must hold after it.

What the device really sent whole is its own account (``process.Machine``), read back from its own bytes; what was
published is the witness's. A frame's content is known by its number alone, since the device sends the same few patterns
over and over, and the gate's value of a pattern is the same to the last bit as long as the reference is.
"""

import json
import select
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from ..device.device import NOISES, PATTERNS, pattern
from ..outcome import Outcome
from ..pace import ENOUGH, LEAST, Passed, kept, pace
from ..shutdown.exit_time import MOST_S, ExitTime, end
from ..stream import EITSKIN, PATIENCE_S, ROOT, Stream, attacked
from .witness import Seen, Witness

QUIET: Final = 150
"""Scans that are untouched, for the reference."""
CLEAN: Final = 60
"""Frames in a row that show that it has recovered."""
RECOVERS_S: Final = 5.0
"""How soon after an attack the stream has all its frames again: two periods of silence, a greeting and a START."""


class Process:
    """The device's process."""

    def __init__(self, folder: Path, **options: Any) -> None:
        options = {"port": str(folder / "port"), "quiet": QUIET} | options
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.attack.device.process", json.dumps(options)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            cwd=ROOT,
            text=True,
        )
        self.port = self._line(PATIENCE_S)

    def order(self, **order: Any) -> dict[str, Any]:
        """Have it attack, and return what it says at the end."""
        self.start(**order)
        return self.ended(order.get("seconds", 30.0) + PATIENCE_S)

    def start(self, **order: Any) -> None:
        """Have it attack; ``ended`` gives what it says."""
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(order) + "\n")
        self._process.stdin.flush()

    def sent_ns(self) -> dict[int, list[tuple[int, int]]]:
        """Return when each whole frame since the last restart was made, and on the line, by its sequence number."""
        self.start(do="sent")
        return dict(json.loads(self._line(PATIENCE_S)))

    def ended(self, timeout_s: float) -> dict[str, Any]:
        """Return what it says at the end of an attack."""
        found: dict[str, Any] = json.loads(self._line(timeout_s))
        return found

    def close(self) -> None:
        """End it."""
        self._process.kill()
        self._process.communicate()

    def _line(self, timeout_s: float) -> str:
        assert self._process.stdout is not None
        if not select.select([self._process.stdout], [], [], timeout_s)[0]:
            raise RuntimeError("the device says nothing")
        line = self._process.stdout.readline().strip()
        if not line:
            raise RuntimeError(f"the device's process ended with {self._process.wait(PATIENCE_S)}")
        return line


@contextmanager
def device(**options: Any) -> Iterator[Process]:
    """Run a device and give it; its port vanishes with it."""
    with tempfile.TemporaryDirectory(prefix="d") as name:
        process = Process(Path(name), **options)
        try:
            yield process
        finally:
            process.close()


@dataclass
class Trial:
    """What runs, and what was learned of it while it was left alone."""

    device: Process
    stream: Stream
    witness: Witness
    first: int = 0
    """Sequence number of the device's first scan."""
    logits: dict[int, float] = field(default_factory=dict)
    """The gate's value of every pattern."""

    def learn(self) -> None:
        """Wait until every pattern was published, and remember what the gate says of each."""
        patterns = PATTERNS

        def learned(frames: list[Seen]) -> bool:
            return len(set(map(self._pattern, frames))) == patterns

        if not self.witness.wait(learned, PATIENCE_S):
            raise RuntimeError(f"no stream: {self.stream.said()[-400:]}")
        for frame in list(self.witness.frames):
            self.logits.setdefault(self._pattern(frame), frame.logit)
        wrong = self.wrong(list(self.witness.frames))
        if wrong or len(set(self.logits.values())) < 0.8 * patterns:
            raise RuntimeError(f"a frame's number does not say what it holds: {wrong[:3]}")

    def _pattern(self, frame: Seen) -> int:
        return pattern(frame.sequence % 2**32, QUIET, self.first)

    def wrong(self, frames: list[Seen]) -> list[str]:
        """Return what was published otherwise than it was measured."""
        found = []
        for frame in frames:
            number = self._pattern(frame)
            if frame.logit != self.logits[number] or frame.touched != (number >= NOISES):
                found.append(f"frame {frame.sequence}: gate {frame.logit}, expected {self.logits[number]}")
        return found

    def recovered(self, said: dict[str, Any] | None = None, timeout_s: float = 60.0) -> float | None:
        """Return after how many seconds frames came in a row again; None if they did not, or the runtime ended.

        Args:
            said: The device's account at the end of an attack: only frames of after it count.
            timeout_s: How long to wait.
        """
        began_s = time.monotonic()
        start = len(self.witness.frames)
        first = None if said is None else said["next"]

        def clean(frames: list[Seen]) -> bool:
            if len(frames) < start + CLEAN:
                return False
            one, last = frames[-CLEAN], frames[-1]
            after = first is None or (one.sequence - first) % 2**32 < 2**31
            return after and last.sequence - one.sequence == last.n - one.n == CLEAN - 1

        while time.monotonic() < began_s + timeout_s and self.stream.runtime.poll() is None:
            if self.witness.wait(clean, 0.2):
                return time.monotonic() - began_s
        return None

    def memory_kB(self) -> int:
        """Return how much memory the runtime has."""
        status = Path(f"/proc/{self.stream.runtime.pid}/status").read_text()
        return int(next(line.split()[1] for line in status.splitlines() if line.startswith("VmRSS")))

    def ends(self) -> ExitTime:
        """End the runtime by SIGTERM and return how long that took; for ever if it did not."""
        runtime = self.stream.runtime
        if runtime.poll() is not None:
            return ExitTime(0.0, 0.0)
        took = end(runtime.pid, signal.SIGTERM)
        if took is None:
            return ExitTime(float("inf"), 0.0)
        runtime.wait(PATIENCE_S)
        return took

    def endure(
        self,
        outcome: Outcome,
        *,
        exact: bool = True,
        content: bool = True,
        paced: bool = True,
        within_s: float = RECOVERS_S,
        uncounted: int = 1,
        **order: Any,
    ) -> dict[str, Any]:
        """Have the device attack and note what held, each property by itself; return what the device said at the end.

        Args:
            outcome: Where to note it.
            exact: Whether just what was sent whole must have been published, and all damage counted.
            content: Whether what is published must be what was measured.
            paced: Whether the stream must keep its pace: the device asks no more than it says that it does.
            within_s: How soon after the attack all frames must come again.
            uncounted: Damaged packets that need not be counted: what waits in a line that is opened anew is gone.
            order: What the device is to do.
        """
        outcome.tried += 1
        at = len(self.witness.frames)  # before the account, so that what it leaves out may be seen twice, never missed
        before, waited_ns = self.device.order(do="report"), self.witness.waits.total_ns
        counts = self.witness.frames[-1].counts
        said = self.device.order(**order)
        recovered_s = self.recovered(said)
        after = self.device.order(do="report")
        frames, broken = self.witness.frames[at:], list(self.witness.broken)
        wrong = [] if recovered_s is not None else [f"no frames within a minute: {self.stream.said()[-300:]!r}"]
        if recovered_s is not None and recovered_s > within_s:
            wrong.append(f"all frames again only after {recovered_s:.1f} s, expected {within_s} s")
        if self.stream.runtime.poll() is not None:
            wrong.append(f"the runtime ended with {self.stream.runtime.poll()}: {self.stream.said()[-300:]!r}")
        if "Traceback" in self.stream.said():
            wrong.append(f"a traceback: {self.stream.said()[-600:]!r}")
        wrong += [f"published what is no frame: {text}" for text in broken[:2]]
        wrong += [f"frame {frame.sequence} holds what is not finite" for frame in frames if not frame.finite][:2]
        wrong += self.wrong(frames)[:2] if content else []
        if paced and recovered_s is not None:
            self.witness.wait(lambda seen: len(seen) >= at + 2 * ENOUGH, 60.0)  # a flood leaves room for few
            found = self._pace(self.witness.frames[at:], self.witness.waits.total_ns - waited_ns)
            if found is not None:  # of few frames, as where most are withheld, there is none
                if not kept(found):
                    wrong.append(f"published at {found} of the pace of measuring, expected at least {LEAST}")
                outcome.figures["slowest_pace"] = min(outcome.figures.get("slowest_pace", 1.0), round(found, 3))
        if exact and frames:
            grown = {name: count - counts[name] for name, count in self.witness.frames[-1].counts.items()}
            damaged = after["damaged"] - before["damaged"]
            greeted = sum("recovered" in frame.events for frame in frames)
            if not damaged - uncounted - 2 * greeted <= grown["corrupt"] <= damaged:
                wrong.append(f"{grown['corrupt']} counted as corrupt, {damaged} sent damaged, {greeted} greetings")
            wrong += self._inexact(before, said, frames, grown["withheld"] if greeted else 0)
        outcome.withstood += not wrong
        if wrong and len(outcome.broken) < 20:
            outcome.broken.append(f"{json.dumps(order)}: {'; '.join(wrong)}")
        slowest = outcome.figures.get("slowest_recovery_s", 0.0)
        outcome.figures["slowest_recovery_s"] = round(max(slowest, recovered_s or 60.0), 2)
        return said

    def _pace(self, frames: list[Seen], waited_ns: int) -> float | None:
        """Return the pace of frames of which some may be missing, which is judged elsewhere."""
        sent_ns, passed, last_ns = self.device.sent_ns(), list[Passed](), 0
        for at, frame in enumerate(frames):  # numbers may come again, but what was sent first is published first
            times = sent_ns.get(frame.sequence % 2**32, ())
            if possible := [one for one in times if last_ns < one[1] <= frame.published_ns]:
                made_ns, last_ns = possible[0]
                passed.append(Passed(at, at, made_ns, last_ns, frame.published_ns))
        return pace(passed, waited_ns)

    def _inexact(self, before: dict[str, Any], said: dict[str, Any], frames: list[Seen], may_miss: int) -> list[str]:
        """Return how what was published differs from what was sent whole; what waited during a greeting may miss."""
        restarted = said["next"] < before["next"]
        scans = {number for number in said["scans"] if restarted or number >= before["next"]}
        whole = {number for number, _ in said["whole"]} & scans
        numbers = [frame.sequence % 2**32 for frame in frames]
        published = set(numbers) & scans
        found = []
        missing = sorted(whole - published)
        if len(missing) > may_miss:
            found.append(f"{len(missing)} whole frames were not published: {missing[:5]}")
        if forged := sorted(published - whole):
            found.append(f"{len(forged)} frames were published that were not sent whole: {forged[:5]}")
        if not restarted and len(set(numbers)) < len(numbers):
            found.append("a frame was published twice")
        return found


@contextmanager
def trial(*arguments: str, learn: bool = True, program: Sequence[str] = EITSKIN, **options: Any) -> Iterator[Trial]:
    """Run a device, the runtime with further arguments on it, and a witness; give them once all is learned."""
    with (
        device(**options) as skin,
        attacked(*arguments, port=skin.port, program=program) as stream,
        Witness(stream.frames, stream.runtime.pid) as witness,
    ):
        running = Trial(skin, stream, witness, options.get("first", 0))
        if learn:
            running.learn()
        yield running


def conclude(running: Trial, outcome: Outcome, before_kB: int, may_grow_kB: int = 8192) -> None:
    """Note what was lost, whether memory grew, and whether SIGTERM ends it."""
    grown_kB = running.memory_kB() - before_kB
    outcome.note(grown_kB <= may_grow_kB, f"memory grew by {grown_kB} kB, expected at most {may_grow_kB}")
    outcome.frames_lost += running.witness.lost
    took, status = running.ends(), running.stream.runtime.poll()
    outcome.note(took.own_s <= MOST_S and status == 0, f"SIGTERM: {took}, exit status {status}")
    outcome.figures |= {"grown_kB": grown_kB, "ended_s": round(took.raw_s, 3), "ended_own_s": round(took.own_s, 3)}


@contextmanager
def attack(name: str, *arguments: str, **options: Any) -> Iterator[tuple[Trial, Outcome]]:
    """Give a trial and its outcome; at the end look at memory, losses and how it ends."""
    outcome = Outcome(name)
    with trial(*arguments, **options) as running:
        before_kB = running.memory_kB()
        yield running, outcome
        if running.stream.runtime.poll() is None:
            conclude(running, outcome, before_kB)
