"""The verifier's process: receives published frames, explains the newest, and answers; ends with the runtime.

It gets packets over a socket and answers there (:mod:`eitskin_tools.verifier.letters`).
"""

import json
import os
import signal
import socket
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
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


MODEL_S: Final = 240.0
"""What a model of a surface may take: it takes some seconds, and a small computer many of them."""

HANGS_S: Final = 60.0
"""A computation that is over its budget by so much hangs, in time of the processor. A frame may need a new model of its
surface, which counts beside its budget, and a small computer is many times slower than others."""


@contextmanager
def within(limit_s: float) -> Iterator[None]:
    """Run a block; the kernel ends the process by SIGPROF once it computed so long and ``HANGS_S`` more."""
    signal.setitimer(signal.ITIMER_PROF, limit_s + HANGS_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)


class Worker:
    """Answers packets until the runtime is gone.

    Args:
        line: To the runtime.
    """

    def __init__(self, line: socket.socket) -> None:
        self._line = line
        self._checker: Any = None
        self._setup = 0
        self._budget_s = 0.0

    def run(self) -> None:
        """Answer until the other side is gone."""
        from eitskin_tools.verifier.letters import LARGEST_PACKET, BaselineLetter, Setup, letter_of

        with suppress(BrokenPipeError, ConnectionResetError):
            while packet := self._line.recv(LARGEST_PACKET):
                letter = letter_of(packet)
                if isinstance(letter, Setup):
                    self._prepare(letter)
                elif isinstance(letter, BaselineLetter):
                    self._learn_baseline(letter)
                else:
                    self._verify(letter)
                self._tell_shape()

    def _prepare(self, setup: Any) -> None:
        from eitskin.messaging.streams.verified import FAILED, PREPARING, READY
        from eitskin_tools.verifier.checkers import Checker
        from eitskin_tools.verifier.letters import state_answer

        number = setup.number
        self._setup, self._checker, self._budget_s = number, None, setup.budget_s
        self._line.send(state_answer(PREPARING, number))
        begin = time.perf_counter()
        try:
            with within(MODEL_S):
                self._checker = Checker(setup)
        except Exception as error:  # of any cloud or skin: the stream goes on, and says why
            self._line.send(state_answer(FAILED, number, reason(error)))
            return
        setup_ms = 1e3 * (time.perf_counter() - begin)
        self._line.send(state_answer(READY, number, self._checker.why, setup_ms))

    def _learn_baseline(self, rest: Any) -> None:
        from eitskin.messaging.streams.verified import READY
        from eitskin_tools.verifier.letters import state_answer

        if self._checker is None or rest.setup != self._setup:
            return
        try:
            with within(MODEL_S):
                why = self._checker.learn_baseline(rest)
        except Exception as error:  # what the untouched sheet reads helps, and is not needed
            why = reason(error)
        self._line.send(state_answer(READY, self._setup, why))

    def _verify(self, frame: Any) -> None:
        from eitskin.messaging.streams.verified import READY, pack_verdict
        from eitskin_tools.verifier.letters import verdict_answer

        begin = time.perf_counter_ns()
        verdict, touches, why = None, (), ""
        try:
            if self._checker is None or frame.setup != self._setup:
                raise ValueError("the surface has changed since")
            with within(self._budget_s):
                verdict, touches, why = self._checker.check(frame)
        except Exception as error:  # a frame that nothing can be said of must not end the verifying of others
            why = reason(error)
        end = time.perf_counter_ns()
        stamps = frame.read_ns, frame.publish_ns, begin, end
        told = pack_verdict(frame.seq, frame.device_us, frame.cloud, READY, why, stamps, verdict, touches)
        flagged = None if verdict is None else verdict[3]
        self._line.send(verdict_answer(told, flagged, 1e-6 * (end - begin)))

    def _tell_shape(self) -> None:
        """Tell the shape that frames show, if it is another one; an error leaves the network the shape that it has."""
        from eitskin_tools.verifier.letters import shape_answer

        with suppress(Exception), within(MODEL_S):
            if self._checker is not None and (shape := self._checker.another_shape()) is not None:
                self._line.send(shape_answer(self._setup, shape))


def reason(error: Exception) -> str:
    """Return what went wrong in a line."""
    text = " ".join(str(error).split())
    known = isinstance(error, ValueError) or type(error).__module__.startswith("eitskin")
    return text if known and text else f"{type(error).__name__}: {text}"


def main() -> int:
    """Run the verifier's process."""
    options = json.loads(sys.argv[1])
    end_with(options["parent"])
    step_back(options["nice"], options["cpus"], idle=options["idle"])
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGPROF):
        signal.signal(number, signal.SIG_DFL)
    with socket.socket(fileno=options["line"]) as line:
        Worker(line).run()
    os._exit(0)  # nothing is worth tidying up for


if __name__ == "__main__":
    sys.exit(main())
