"""Plays a sequence on a device, and judges it twice: by the promise alone, and by SPEC.md as a state machine.

The promise: once a configuration was confirmed, whatever is cut, the device ends with one that was confirmed. It
is judged from what the device said and did, so that a wrong state machine cannot hide its breach.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from tests.emulator.device_core import Outcome
from tests.faults.requests import specification as states
from tests.faults.requests.specification import Reply, Request, State, answer, digest_of
from tests.faults.requests.steps import FACTORY, TYPES, Known, Step, payload, resolve

from eitskin_proto.wire import framing
from eitskin_proto.wire.codes import Code, HelloFlag, MessageType


@dataclass(slots=True)
class Verdict:
    """What came of a sequence."""

    requests: int = 0
    cuts: int = 0
    """Power cuts that really came."""
    confirmed: bool = False
    """Whether anything was ever confirmed, so that the promise held something to keep."""
    lost: str = ""
    """The first moment without a bootable confirmed configuration."""
    differs: str = ""
    """The first answer or boot that is not SPEC.md's."""


def outcome_of(state: State) -> Outcome:
    """Return what a device with this storage boots, and what once every trial is over."""
    booted = states.boot(state)
    settled = states.boot(booted) if booted.trial else booted
    return Outcome(
        booted.generation, digest_of(booted.blob), int(booted.trial), settled.generation, digest_of(settled.blob)
    )


class Player:
    """Plays one sequence.

    Args:
        line: A fresh device (lines.py).
    """

    def __init__(self, line: Any) -> None:
        self._line = line
        self.verdict = Verdict()
        self._known = Known()
        self._may_be: list[State] = [State(FACTORY)]
        self._confirmed: set[tuple[int, int]] = set()
        self._tag = 0

    def play(self, steps: Sequence[Step]) -> Verdict:
        """Play the steps, then switch the device off and on until nothing is on trial."""
        self._hello()
        for step in steps:
            match step:
                case ("cut", change, seed):
                    self._line.cut(change, seed)
                case ("power",):
                    self._boot(self._may_be)
                case ("wait", seconds):
                    self._wait(seconds)
                case _:
                    self._request(resolve(step, self._known))
        self._line.cut(0, 0)
        for _ in range(2):
            self._boot(self._may_be)
        return self.verdict

    def _wait(self, seconds: int) -> None:
        before, self._may_be = self._may_be, [states.wait(state, seconds) for state in self._may_be]
        self._line.wait(seconds)
        self._came_from(before)

    def _hello(self) -> None:
        self._request(("hello",))

    def _request(self, request: Request) -> None:
        running = (self._known.generation, self._known.digest)
        if request[0] == "confirm" and request[1:] == running and running[0]:
            self._confirmed.add(running)  # from now on it may count, however the power fails
        said = self._said(request)
        after = [(state, *answer(state, request)) for state in self._may_be]
        possible = [state for before, then, _ in after for state in (before, then)]
        if self._line.dead:
            self._boot(possible, cut=True)
            return
        self._look(possible)
        reply = self._reply(said, request)
        self._may_be = self._only([then for _, then, foretold in after if _agrees(foretold, reply)], request, reply)
        self._learn(request, reply)
        if request[0] == "restart" and reply[:2] == ("ack", Code.OK):
            self._restart()

    def _said(self, request: Request) -> list[bytes]:
        self.verdict.requests += 1
        self._tag = self._tag % 250 + 1
        answers: list[bytes] = self._line.ask(framing.encode(payload(request, self._tag)))
        return answers

    def _restart(self) -> None:
        before = self._may_be
        self._line.await_restart()
        self._may_be = [states.boot(state) for state in before]
        self._came_from(before)

    def _came_from(self, before: list[State]) -> None:
        """Look at a device that went on by itself, from one of these states to one of those that it may be in now."""
        if self._line.dead:
            self._boot([*before, *self._may_be], cut=True)
        else:
            self._look([*before, *self._may_be])
            self._hello()

    def _boot(self, stored: Iterable[State], cut: bool = False) -> None:
        """Switch off and on; a cut that is still to come may come within the boot."""
        stored = list(stored)
        while True:
            self.verdict.cuts += cut
            self._line.boot()
            booted = [states.boot(state) for state in stored]
            self._look([*stored, *booted])
            self._may_be = list(dict.fromkeys(booted))
            reply = self._reply(self._said(("hello",)), ("hello",))
            if not self._line.dead:
                states_left = [state for state in self._may_be if answer(state, ("hello",))[1] == reply]
                self._may_be = self._only(states_left, ("boot",), reply)
                self._learn(("hello",), reply)
                return
            stored, cut = [*stored, *booted], True

    def _learn(self, request: Request, reply: Reply) -> None:
        known = self._known
        if reply[0] == "hello":
            known.generation, known.digest = reply[1:3]
            if self.verdict.confirmed and not reply[3] & HelloFlag.TRIAL:
                self._keep((known.generation, known.digest), f"it runs generation {known.generation}")
        elif request[0] == "write" and reply[1] in (Code.OK, Code.BAD_OFFSET):
            known.written = reply[2]
        elif request[0] == "confirm" and reply[1] == Code.OK and known.generation:
            self.verdict.confirmed = True

    def _look(self, possible: Iterable[State]) -> None:
        """Judge what would have booted if power had failed at any change since the last look."""
        found = self._line.outcomes()
        if not found:
            return
        foretold = {outcome_of(state) for state in possible}
        for outcome in found:
            if self.verdict.confirmed:
                self._keep(outcome[3:], f"it would end with generation {outcome.settled_generation}")
            if foretold:
                self._expect(outcome in foretold, f"would boot {outcome}, foretold are {sorted(foretold)}")

    def _keep(self, settled: tuple[int, ...], what: str) -> None:
        if settled not in self._confirmed and not self.verdict.lost:
            self.verdict.lost = f"after {self.verdict.requests} requests {what}, which was never confirmed"

    def _only(self, left: list[State], request: Request, reply: Reply) -> list[State]:
        """Return the states that agree with an answer; once there are none the state machine says no more."""
        if self._may_be:
            self._expect(bool(left), f"{request} was answered {reply}")
        return list(dict.fromkeys(left))

    def _expect(self, held: bool, what: str) -> None:
        if not held and not self.verdict.differs:
            self.verdict.differs = f"request {self.verdict.requests}: {what}"

    def _reply(self, said: list[bytes], request: Request) -> Reply:
        if len(said) != 1 or said[0][1] != self._tag:
            return ("none", [payload.hex() for payload in said])
        found = said[0]
        if found[0] == MessageType.HELLO:
            return ("hello", _u32(found, 52), _u32(found, 48), found[27])
        if found[0] == MessageType.ACK and found[2] == TYPES[request[0]]:
            return ("ack", found[3], _u32(found, 4))
        return ("none", found.hex())


def _u32(payload: bytes, at: int) -> int:
    return int.from_bytes(payload[at : at + 4], "little")


def _agrees(foretold: Reply, reply: Reply) -> bool:
    return foretold == reply or (foretold[-1] is None and foretold[:-1] == reply[:-1])
