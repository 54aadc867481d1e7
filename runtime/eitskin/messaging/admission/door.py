"""Where somebody comes in: a ZeroMQ socket's address, and how many are let in there.

An ipc address has a gate of our own before it (:mod:`eitskin.messaging.admission.gate`), so that nobody comes in for
whom there is no descriptor. On TCP libzmq accepts whoever comes; who is too many is ended at the next look. In neither
case does it cost those anything who are served already. Where files are few, TCP is shut for the moment in which ipc
lets somebody in (:mod:`eitskin.messaging.admission.shutter`).
"""

import os
import select
import time
from collections.abc import Container
from pathlib import Path
from typing import Any, Final

import zmq

from eitskin.errors import EndpointError
from eitskin.messaging.admission.connections import MANY_SPARE, Connections, Name
from eitskin.messaging.admission.descriptors import RESERVE, Connection, limit, room
from eitskin.messaging.admission.gate import Gate
from eitskin.messaging.admission.promises import PROMISES
from eitskin.messaging.admission.shutter import Shutter, queue
from eitskin.messaging.admission.traffic import ALLOWANCE, MODEST, received_from
from eitskin.messaging.curve_keys import ServerKeys
from eitskin.messaging.endpoints import bind_problem, check_allowed, clear_path

PAUSE_S: Final = 0.05
"""How long those who wait are not looked at again when there is no room for them."""

COUNT_S: Final = 1.0
"""How often it is looked at an ipc address who has left, if nobody comes."""

LOOK_S: Final = 0.05
"""How often it is looked at a TCP address, where whoever comes is accepted, and may send without end."""

FEWEST: Final = 4
"""Descriptors that must be left for anybody to come in at all."""


class Door:
    """A bound address; leave it with ``close`` before the socket is closed. For the thread that uses the socket.

    Args:
        socket_: Of zmq; its other options must be set already.
        endpoint: ``ipc:///path`` or ``tcp://address:port``.
        keys: CURVE keys; they are used wherever they are given on TCP.
        control: See :func:`eitskin.messaging.endpoints.needs_keys`.
        most: How many are served at once.
        allowance_bytes: What of one TCP connection may be read that is no whole message yet, or was not ``took``.

    Raises:
        EndpointError: The endpoint is not allowed like this, or in use, or cannot be bound; or the process may open so
            few files that nobody could come.
    """

    def __init__(
        self,
        socket_: Any,
        endpoint: str,
        *,
        keys: ServerKeys | None = None,
        control: bool,
        most: int,
        allowance_bytes: int = ALLOWANCE,
    ) -> None:
        check_allowed(endpoint, keys, control=control)
        self._socket = socket_
        self._gate: Gate | None = None
        self._shutter: Shutter | None = None
        self._next_s = 0.0
        """When those who wait are looked at again."""
        self._count_s = 0.0
        try:
            if endpoint.startswith("ipc://"):
                path = Path(endpoint.removeprefix("ipc://"))
                clear_path(path)
                self._gate = Gate(socket_, path, most)
                self.endpoint = endpoint
            else:
                if keys is not None:
                    keys.apply(socket_)
                socket_.setsockopt(zmq.BACKLOG, queue())
                socket_.bind(endpoint)
                self.endpoint = str(socket_.getsockopt_string(zmq.LAST_ENDPOINT)).rstrip("\0")
        except (zmq.ZMQError, OSError) as error:
            raise EndpointError(bind_problem(endpoint, error)) from error
        self._port = -1 if self._gate is not None else int(self.endpoint.rpartition(":")[2])
        self._connections = Connections(most, self._ours, allowance_bytes)
        if self._gate is None:
            self._shutter = Shutter(self._port)
            PROMISES.stranger_came(self._shutter)
        left = room()
        if left < FEWEST:
            self.close()
            raise EndpointError(
                f"{endpoint}: only {limit()} files may be open, of which {max(left, 0)} are left for connections, "
                f"expected at least {FEWEST}: allow more with 'ulimit -n {limit() + 100 - left}' or LimitNOFILE"
            )
        self._many = limit() - left - RESERVE + min(left, most + MANY_SPARE)
        """A descriptor's number from which on it is high time to look."""
        self._poll = self._polled()
        self._connections.look()

    def _ours(self, name: Name) -> bool:
        return name == self._port if self._gate is None else self._gate.ours(name)

    def _polled(self) -> select.poll:
        poll = select.poll()
        if self._gate is not None:
            poll.register(self._gate.descriptor, select.POLLIN)
        return poll

    @property
    def open_to_all(self) -> bool:
        """Whether libzmq accepts whoever comes, at any time."""
        return self._gate is None

    @property
    def ended(self) -> int:
        """Connections that were ended because there were too many."""
        return self._connections.ended

    @property
    def waits_on(self) -> list[int]:
        """Descriptors to wait on: one that can be read means that ``look`` has something to do."""
        if self._gate is None or time.monotonic() < self._next_s:
            return []
        return [self._gate.descriptor]

    @property
    def look_again_s(self) -> float:
        """How long to wait on them at most."""
        if time.monotonic() < self._next_s:
            return PAUSE_S
        return LOOK_S if self._gate is None else COUNT_S

    def look(self, keep: Container[Connection] = (), *, newcomers: bool = True) -> None:
        """Let in who waits; never waits itself, and takes microseconds while nobody comes.

        Args:
            keep: Connections that are served, as :meth:`connection_at` names them.
            newcomers: False lets nobody in who waits at an ipc address: those before them are still to be seen to.
        """
        if self._gate is None:
            PROMISES.settle()
            if self._crowded():
                self.count(keep)
        elif newcomers and self._poll.poll(0) and time.monotonic() >= self._next_s:
            places = self._cull(keep, self._gate.size)
            if places >= self._gate.size and self._gate.let_in(places):
                self._poll = self._polled()
            else:
                self._next_s = time.monotonic() + PAUSE_S

    def connection_at(self, descriptor: int) -> Connection | None:
        """Return which of the connections lies at a descriptor now; None if it is none of them."""
        return self._connections.at(descriptor)

    def end_greedy(self) -> int:
        """End who sends without end; return how many were, in all."""
        self._connections.end_greedy()
        return self._connections.greedy

    def end_endless(self) -> None:
        """End who sends messages without end by TCP, and nobody whose messages wait for long."""
        if self._gate is None:
            self._connections.end_endless()

    def sent_much(self, connection: Connection) -> bool:
        """Return whether a connection sent more than who is honest; of ipc it is not known, and so always thought."""
        return self._gate is not None or received_from(connection) > MODEST

    def took(self, connection: Connection, size: int, parts: int) -> None:
        """Take note of a whole message that was taken out of the socket: so many bytes in so many parts."""
        if self._gate is None:
            self._connections.took(connection, size, parts)

    def count(self, keep: Container[Connection] = ()) -> None:
        """End who is too many, a few times a second."""
        now_s = time.monotonic()
        PROMISES.settle()
        if self._gate is None or now_s >= self._count_s:
            self._count_s = now_s + COUNT_S
            self._cull(keep, 0)

    def _cull(self, keep: Container[Connection], expected: int) -> int:
        settled = set() if self._gate is None else self._gate.settled
        living = self._connections.look()
        if self._gate is not None:
            self._gate.forget(settled.difference(living.values()))
        return self._connections.cull(living, keep, expected)

    def _crowded(self) -> bool:
        """Whether so many files are open that counting cannot wait: a new one gets the lowest free number."""
        try:
            number = os.dup(self._socket.getsockopt(zmq.FD))
        except OSError:
            return True
        os.close(number)
        return number >= self._many

    def close(self) -> None:
        """Let nobody in any more; closing twice is fine."""
        if self._gate is not None:
            self._gate.close()
            self._gate = None
        elif self._shutter is not None:
            self._port = -1
            PROMISES.stranger_left(self._shutter)
            self._shutter = None
