"""The verifier's process: waits for frames that have gone out, explains the newest, and answers; ends with the runtime.

It gets packets over a socket and answers there (:mod:`eitskin_tools.verifier.letters`). A thread beats into a pipe, so
that the runtime sees a process that was stopped; a beat is how late the computing is, so that it sees one that hangs.
"""

import json
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from struct import pack
from typing import Any, Final

from eitskin_tools.processes.children import die_with_parent

ORPHANED: Final = 3
"""Exit status of a process whose parent was gone before it began."""


def end_with(parent: int) -> None:
    """Have the kernel end this process with its parent, at once, even while it is stopped."""
    die_with_parent(signal.SIGKILL)
    if os.getppid() != parent:
        raise SystemExit(ORPHANED)


def step_back(nice: int, cpus: list[int], *, idle: bool) -> None:
    """Take the core and the priority that were chosen; whatever the parent has is not taken over.

    Args:
        nice: From 0, as everybody, to 19.
        cpus: To run on.
        idle: Run only while nothing else wants the core.
    """
    with suppress(OSError):  # a service may forbid it
        os.sched_setscheduler(0, os.SCHED_IDLE if idle else os.SCHED_OTHER, os.sched_param(0))
    with suppress(OSError):
        os.sched_setaffinity(0, cpus)
    with suppress(PermissionError):  # a parent that is nicer than that, which only root may undo
        os.setpriority(os.PRIO_PROCESS, 0, nice)


BEAT_S: Final = 0.1
"""Between two signs of life."""

MODEL_S: Final = 240.0
"""What a model of a surface may take: it takes some seconds, and a small computer many of them."""

MAX_COUNTED_S: Final = 2.0 * BEAT_S
"""Of the time between two signs of life: beyond it the process was stopped, or the machine asleep."""

RUNNABLE: Final = "R"
"""State of a thread that computes, or waits for a core to."""


class Deadline:
    """Says how far a computation is beyond what it may take.

    Only what the computing thread computed or slept counts, not what it waited for a core, nor what the whole process
    stood still: a computation that is far beyond its limit hangs.

    Args:
        elapsed_s: Returns the seconds that the thread had since the last call.
    """

    def __init__(self, elapsed_s: Callable[[], float]) -> None:
        self._elapsed_s = elapsed_s
        self._lock = threading.Lock()
        self._limit_s: float | None = None
        self._spent_s = 0.0

    @contextmanager
    def within(self, limit_s: float) -> Iterator[None]:
        """Run a block that may take so many seconds."""
        with self._lock:
            self._limit_s, self._spent_s = limit_s, 0.0
        try:
            yield
        finally:
            with self._lock:
                self._limit_s = None

    def late_s(self) -> float:
        """Return the seconds beyond the limit; 0 where the computation is not late, or there is none."""
        elapsed_s = self._elapsed_s()
        with self._lock:
            if self._limit_s is None:
                return 0.0
            self._spent_s += elapsed_s
            return max(0.0, self._spent_s - self._limit_s)


class ThreadTime:
    """Counts the time that a thread of this process had; another thread calls it at each sign of life.

    Args:
        thread: Which; by default the one that makes this.
    """

    def __init__(self, thread: threading.Thread | None = None) -> None:
        thread = thread or threading.current_thread()
        assert thread.ident is not None
        self._clock = time.pthread_getcpuclockid(thread.ident)
        self._stat = Path(f"/proc/self/task/{thread.native_id}/stat")
        self._cpu_s, self._at_s = time.clock_gettime(self._clock), time.monotonic()

    def __call__(self) -> float:
        """Return the seconds since the last call in which it computed; all of them where it slept throughout."""
        cpu_s, at_s = time.clock_gettime(self._clock), time.monotonic()
        computed_s, passed_s = cpu_s - self._cpu_s, at_s - self._at_s
        self._cpu_s, self._at_s = cpu_s, at_s
        slept = computed_s == 0.0 and self._state() != RUNNABLE
        return min(passed_s if slept else computed_s, MAX_COUNTED_S)

    def _state(self) -> str:
        with suppress(OSError):  # a machine without /proc: a thread that did not compute slept
            return self._stat.read_text().rpartition(")")[2].split()[0]
        return ""


class Worker:
    """Answers packets until the runtime is gone.

    Args:
        line: To the runtime.
        deadline: Of each computation.
    """

    def __init__(self, line: socket.socket, deadline: Deadline) -> None:
        self._line, self._deadline = line, deadline
        self._checker: Any = None
        self._setup = 0
        self._budget_s = 0.0

    def run(self) -> None:
        """Answer until the other side is gone."""
        from eitskin_tools.verifier.letters import FRAME, LARGEST_PACKET, REST, SETUP, unpack

        handlers = {SETUP: self._prepare, REST: self._rest, FRAME: self._verify}
        with suppress(BrokenPipeError, ConnectionResetError):
            while packet := self._line.recv(LARGEST_PACKET):
                kind, *items = unpack(packet)
                handlers[kind](*items)

    def _prepare(self, number: int, fields: dict[str, Any]) -> None:
        from eitskin.messaging.streams.verified import FAILED, PREPARING, READY
        from eitskin_tools.verifier.checkers import Checker
        from eitskin_tools.verifier.letters import Setup, state_answer

        self._setup, self._checker = number, None
        self._line.send(state_answer(PREPARING, number))
        begin = time.perf_counter()
        try:
            setup = Setup(**fields)
            self._budget_s = setup.budget_s
            with self._deadline.within(MODEL_S):
                self._checker = Checker(setup)
        except Exception as error:  # of any cloud or skin: the stream goes on, and says why
            self._line.send(state_answer(FAILED, number, reason(error)))
            return
        self._line.send(state_answer(READY, number, setup_ms=1e3 * (time.perf_counter() - begin)))

    def _rest(self, *items: Any) -> None:
        from eitskin.messaging.streams.verified import READY
        from eitskin_tools.verifier.letters import RestLetter, state_answer

        rest = RestLetter.of(*items)
        if self._checker is None or rest.setup != self._setup:
            return
        try:
            with self._deadline.within(MODEL_S):
                why = self._checker.rest(rest)
        except Exception as error:  # what the untouched sheet reads helps, and is not needed
            why = reason(error)
        self._line.send(state_answer(READY, self._setup, why))

    def _verify(self, *items: Any) -> None:
        from eitskin.messaging.streams.verified import READY, pack_verdict
        from eitskin_tools.verifier.letters import FrameLetter, verdict_answer

        frame = FrameLetter.of(*items)
        begin = time.perf_counter_ns()
        verdict, touches, why = None, (), ""
        try:
            if self._checker is None or frame.setup != self._setup:
                raise ValueError("its surface is no longer in use")
            with self._deadline.within(self._budget_s):
                verdict, touches, why = self._checker.check(frame)
        except Exception as error:  # a frame that nothing can be said of must not end the verifying of others
            why = reason(error)
        end = time.perf_counter_ns()
        stamps = frame.read_ns, frame.publish_ns, begin, end
        told = pack_verdict(frame.seq, frame.device_us, frame.cloud, READY, why, stamps, verdict, touches)
        flagged = None if verdict is None else verdict[3]
        self._line.send(verdict_answer(told, flagged, 1e-6 * (end - begin)))


def reason(error: Exception) -> str:
    """Return what went wrong in a line."""
    text = " ".join(str(error).split())
    known = isinstance(error, ValueError) or type(error).__module__.startswith("eitskin")
    return text if known and text else f"{type(error).__name__}: {text}"


def beat(pipe: int, deadline: Deadline) -> None:
    """Beat for ever, and say how late the computation is."""
    while True:
        with suppress(BlockingIOError):  # nobody has read the others
            os.write(pipe, pack("<d", deadline.late_s()))
        time.sleep(BEAT_S)


def main() -> int:
    """Run the verifier's process."""
    options = json.loads(sys.argv[1])
    end_with(options["parent"])
    step_back(options["nice"], options["cpus"], idle=options["idle"])
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_DFL)
    deadline = Deadline(ThreadTime())
    threading.Thread(target=beat, args=(options["beats"], deadline), name="beat", daemon=True).start()
    with socket.socket(fileno=options["line"]) as line:
        Worker(line, deadline).run()
    os._exit(0)  # nothing is worth tidying up for


if __name__ == "__main__":
    sys.exit(main())
