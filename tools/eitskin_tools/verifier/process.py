"""The verifier's process: waits for frames that have gone out, explains the newest, and answers; ends with the runtime.

It is told by letters (:mod:`eitskin_tools.verifier.mailbox`) and answers over a socket. A thread beats, so that who
started it sees a process that was stopped, and says how late the computing is, so that it sees one that hangs.
"""

import ctypes
import json
import os
import select
import signal
import socket
import sys
import threading
import time
from contextlib import suppress
from typing import Any, Final

from eitskin_tools.verifier.mailbox import FRAME, REST, SETUP, Mailbox
from eitskin_tools.verifier.work import BEAT_S, MODEL_S, TimeHad, Work

PR_SET_PDEATHSIG: Final = 1
"""Option of prctl(2): the signal that a process gets when the thread that started it ends."""

ORPHANED: Final = 3
"""Exit status of a process whose parent was gone before it began."""


def end_with(parent: int) -> None:
    """Have the kernel end this process with its parent, at once, even while it is stopped."""
    if sys.platform == "linux":
        ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
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


class Worker:
    """Answers letters until the runtime is gone.

    Args:
        mailbox: With the letters.
        bell: An eventfd that is rung behind each letter.
        answers: Where answers go.
        work: Is told what is computed.
    """

    def __init__(self, mailbox: Mailbox, bell: int, answers: socket.socket, work: Work) -> None:
        self._mailbox, self._bell, self._answers, self._work = mailbox, bell, answers, work
        self._checker: Any = None
        self._setup = 0
        self._budget_s = 0.0

    def run(self) -> None:
        """Answer until the other side is gone."""
        waits = select.poll()
        waits.register(self._bell, select.POLLIN)
        waits.register(self._answers, select.POLLIN)
        with suppress(BrokenPipeError, ConnectionResetError):
            while True:
                self._take_all()
                for descriptor, _ in waits.poll():
                    if descriptor != self._bell:
                        return  # nobody ever writes there: it was closed
                with suppress(BlockingIOError):
                    os.eventfd_read(self._bell)

    def _take_all(self) -> None:
        while True:
            setup = self._mailbox.take(SETUP)
            if setup is not None:
                self._prepare(*setup)
            rest = self._mailbox.take(REST)
            if rest is not None:
                self._rest(*rest)
            frame = self._mailbox.take(FRAME)
            if frame is not None:
                self._verify(*frame)
            elif setup is None and rest is None:
                return

    def _prepare(self, number: int, letter: bytes) -> None:
        from eitskin.messaging.verified.message import FAILED, PREPARING, READY
        from eitskin_tools.verifier.checkers import Checker
        from eitskin_tools.verifier.letters import Setup, state_answer

        self._setup, self._checker = number, None
        self._answers.send(state_answer(PREPARING, number))
        begin = time.perf_counter()
        try:
            setup = Setup.of(letter)
            self._budget_s = setup.budget_s
            with self._work.within(MODEL_S):
                self._checker = Checker(setup)
        except Exception as error:  # of any cloud or skin: the stream goes on, and says why
            self._answers.send(state_answer(FAILED, number, reason(error)))
            return
        self._answers.send(state_answer(READY, number, setup_ms=1e3 * (time.perf_counter() - begin)))

    def _is_for(self, setup: int) -> bool:
        """Return whether a letter is of the shape that can be verified, which may have come between two looks."""
        if setup != self._setup and (letter := self._mailbox.take(SETUP)) is not None:
            self._prepare(*letter)
        return self._checker is not None and setup == self._setup

    def _rest(self, _: int, letter: bytes) -> None:
        from eitskin.messaging.verified.message import READY
        from eitskin_tools.verifier.letters import RestLetter, state_answer

        rest = RestLetter.of(letter)
        if not self._is_for(rest.setup):
            return
        try:
            with self._work.within(MODEL_S):
                why = self._checker.rest(rest)
        except Exception as error:  # what the untouched sheet reads helps, and is not needed
            why = reason(error)
        self._answers.send(state_answer(READY, self._setup, why))

    def _verify(self, number: int, letter: bytes) -> None:
        from eitskin.messaging.verified.message import READY, rest
        from eitskin_tools.verifier.letters import FrameLetter, verdict_answer

        if not letter:
            return  # the one before was taken back
        frame = FrameLetter.of(letter)
        if not self._is_for(frame.setup):
            return  # of another shape: counted as skipped by the number of the next
        begin = time.perf_counter_ns()
        verdict, touches, why = None, (), ""
        try:
            with self._work.within(self._budget_s):
                verdict, touches, why = self._checker.check(frame)
        except Exception as error:  # a frame that nothing can be said of must not end the verifying of others
            why = reason(error)
        end = time.perf_counter_ns()
        stamps = frame.read_ns, frame.publish_ns, begin, end
        told = rest(frame.seq, frame.device_us, frame.cloud, READY, why, stamps, verdict, touches)
        flagged = None if verdict is None else verdict[3]
        self._answers.send(verdict_answer(number, told, flagged, 1e-6 * (end - begin)))


def reason(error: Exception) -> str:
    """Return what went wrong in a line."""
    text = " ".join(str(error).split())
    known = isinstance(error, ValueError) or type(error).__module__.startswith("eitskin")
    return text if known and text else f"{type(error).__name__}: {text}"


def beat(mailbox: Mailbox, work: Work) -> None:
    """Beat for ever, and say how late the work is."""
    while True:
        mailbox.late_s = work.late_s()
        mailbox.give_beat()
        time.sleep(BEAT_S)


def main() -> int:
    """Run the verifier's process."""
    told = json.loads(sys.argv[1])
    end_with(told["parent"])
    step_back(told["nice"], told["cpus"], idle=told["idle"])
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_DFL)
    mailbox = Mailbox(told["memory"])
    mailbox.skip(FRAME, told["skip"])
    work = Work(TimeHad())
    threading.Thread(target=beat, args=(mailbox, work), name="beat", daemon=True).start()
    with socket.socket(fileno=told["answers"]) as answers:
        Worker(mailbox, told["bell"], answers, work).run()
    os._exit(0)  # nothing is worth tidying up for


if __name__ == "__main__":
    sys.exit(main())
