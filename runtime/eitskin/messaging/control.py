"""The runtime's side of control requests: a new cloud, a new reference, its state, stop.

A request is one MessagePack map ``{"command": ..., ...}``, the answer one map ``{"ok": true, ...}`` or ``{"ok": false,
"error": text}``. The server has a thread of its own, which runs the geometry graph while the frame loop goes on; the
loop only picks up the finished result. ``reference`` waits for frames: it is answered by a second thread when they are
in, one at a time, and everything else is answered meanwhile. A request is data of bounded size, without code or
pickles; the answer to an invalid one says what is wrong. :mod:`eitskin.messaging.control_commands` has the commands,
:mod:`eitskin.messaging.control_client` the client.

The socket is a ROUTER, so that each answer goes to the client that asked, whatever others send: a REP socket gives the
next client's answer away when a message has no delimiter. ::

    [client's identity, by libzmq] [further identities, of proxies] [b"", the delimiter] [the map]

=============  ====================================================  ===========================
command        fields                                                answer
=============  ====================================================  ===========================
``cloud``      ``cloud``: float32 LE (3, rows, columns) mm, 16200     ``cloud``: its revision;
               bytes for the paper's skin; optional ``grid_id``      ``warnings``: list of lines
               and ``skin_digest``: the skin of the cloud;
               optional ``predicted`` and ``predicted_flat``:
               832 bytes each, float64 LE (104,) V
``reference``  optional ``frames``: 2 to 10000; optional             ``frames``, ``weak_rows``,
               ``force``: true accepts it even if the sheet seems    and the findings
               bent, touched or moving                               (``Judgement.fields``)
``exclude``    ``electrodes``: list of at most 4 numbers, 0 to 15;    ``electrodes``
               empty uses all again
``status``                                                            counters and ids
``stop``
=============  ====================================================  ===========================
"""

import os
import threading
import time
from collections.abc import Callable
from queue import Empty, SimpleQueue
from typing import Any, Final

import zmq

from eitskin.errors import ControlError
from eitskin.messaging.control_commands import Answer, Commands, Controlled, answer_of, largest_request, refusal
from eitskin.messaging.curve_keys import CurveAuthenticator, ServerKeys
from eitskin.messaging.listener import Listener, check_files
from eitskin_proto.skin.skin import PAPER
from eitskin_proto.skin.skin import Skin as SkinDescription

MOST_CONNECTIONS: Final = 64
"""Clients at once; further ones wait."""

MOST_PARTS: Final = 16
"""Of a message: identities of proxies, the delimiter, the map."""

PAUSE_S: Final = 0.01
"""Pause after a failure, so that one that lasts takes no core."""

FAREWELL_S: Final = 0.1
"""How long ``close`` waits for the answer to a request that was ended by it."""

Route = list[bytes]
"""Parts of a message up to the delimiter: where its answer goes."""


class ControlServer:
    """Answers control requests until ``close``.

    Args:
        endpoint: ``ipc:///path``, or TCP with keys.
        controlled: The runtime; it accepts clouds of its ``description``, else of the paper's skin.
        keys: CURVE keys, required for TCP.

    Raises:
        EndpointError: The endpoint is not allowed or in use, or the process may open too few files.
    """

    def __init__(self, endpoint: str, controlled: Controlled, keys: ServerKeys | None = None) -> None:
        known: SkinDescription = getattr(controlled, "description", PAPER)
        self._largest = largest_request(known.grid)
        self._commands = Commands(controlled, known)
        check_files(endpoint)
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self.refused = 0
        """Requests that were answered with an error."""
        self._closing = False
        self._slow = _SlowRequest()
        self._authenticator = CurveAuthenticator(self._context, keys) if keys is not None else None
        self._socket: Any = self._context.socket(zmq.ROUTER)
        self._socket.setsockopt(zmq.MAXMSGSIZE, self._largest)
        self._socket.setsockopt(zmq.RCVHWM, 4)
        self._socket.setsockopt(zmq.SNDHWM, 4)
        self._socket.setsockopt(zmq.LINGER, 100)
        try:
            self._listener = Listener(self._context, self._socket, endpoint, keys=keys, most=MOST_CONNECTIONS)
        except BaseException:
            self._end()
            raise
        self.endpoint = self._listener.endpoint
        self._thread = threading.Thread(target=self._serve, name="eitskin-control", daemon=True)
        self._thread.start()

    @property
    def ended(self) -> int:
        """Number of connections that were closed because there were too many."""
        return self._listener.refused

    def _serve(self) -> None:
        """Answer until stopped, or until the context ends; the address is released in any case."""
        try:
            self._answer_all()
        finally:
            self._say_farewell()
            self._listener.close()

    def _answer_all(self) -> None:
        """Block until there is a request, an answer or a connection."""
        while not self._closing:
            try:
                listener = self._listener
                zmq.select([self._socket, self._slow.wake, *listener.waits_on], [], [], listener.pause_s)
                self._answer_finished()
                listener.admit()
                if self._socket.getsockopt(zmq.EVENTS) & zmq.POLLIN:
                    self._receive(self._socket.recv_multipart())
            except zmq.ContextTerminated:
                return
            except Exception:  # a client that vanished, or a moment without memory: the next request finds a server
                time.sleep(PAUSE_S)

    def _receive(self, parts: list[bytes]) -> None:
        """Answer a message, or have it answered later."""
        if b"" not in parts[1:MOST_PARTS]:
            route, body = [parts[0], b""], None
        else:
            end = parts.index(b"", 1) + 1
            route, body = parts[:end], parts[end:]
        try:
            if body is None:
                raise ControlError(
                    f"a message of {len(parts) - 1} parts has no empty part before the map; send [b'', map], as a "
                    "REQ socket does"
                )
            perform, slow = self._commands.prepare(body)
            if slow:
                self._slow.start(route, perform)
                return
        except ControlError as error:
            self._send(route, False, refusal(str(error)))
        else:
            self._send(route, *answer_of(perform))

    def _send(self, route: Route, granted: bool, answer: bytes) -> None:
        """Send an answer; it is dropped if its client has vanished or reads none."""
        self.refused += not granted
        self._socket.send_multipart([*route, answer], zmq.NOBLOCK)

    def _answer_finished(self, wait_s: float = 0.0) -> bool:
        """Answer the slow request, if it is done, and return whether it was."""
        found = self._slow.finished(wait_s)
        if found is None:
            return False
        self._send(*found)
        return True

    def _say_farewell(self) -> None:
        """Answer the clients that still wait."""
        waiting = self._slow.waiting
        if waiting is None:
            return
        try:
            if not self._answer_finished(FAREWELL_S):
                self._send(waiting, False, refusal("the runtime takes no more requests; ask again once it runs"))
        except zmq.ZMQError:
            return  # no client can be reached any more

    def _end(self) -> None:
        self._context.term()  # wakes the authenticator; waits until sockets are closed and answers sent
        self._slow.close()
        if self._authenticator is not None:
            self._authenticator.join()

    def close(self) -> None:
        """Stop answering; a second call does nothing."""
        if self._context.closed:
            return
        self._closing = True
        self._slow.ring()
        self._thread.join()
        self._end()


class _SlowRequest:
    """One request at a time that is performed in a thread of its own."""

    def __init__(self) -> None:
        self.wake = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        """To wait on: something is finished, or ``ring`` was called."""
        self.waiting: Route | None = None
        """A client that waits for an answer."""
        self._done: SimpleQueue[tuple[bool, bytes]] = SimpleQueue()
        self._lock = threading.Lock()

    def start(self, route: Route, perform: Callable[[], Answer]) -> None:
        """Begin; ``finished`` will have the answer.

        Raises:
            ControlError: There is one already, or the system has no thread for it.
        """
        if self.waiting is not None:
            raise ControlError("a reference is already being captured; ask again when it is done")
        self.waiting = route
        try:
            threading.Thread(target=self._run, args=(perform,), name="eitskin-reference", daemon=True).start()
        except RuntimeError as error:  # the next request must find a server
            self.waiting = None
            raise ControlError(f"the runtime cannot do this now ({error}): allow it more threads") from error

    def _run(self, perform: Callable[[], Answer]) -> None:
        self._done.put(answer_of(perform))
        self.ring()

    def ring(self) -> None:
        """Wake the thread that waits on ``wake``."""
        with self._lock:
            if self.wake >= 0:
                os.eventfd_write(self.wake, 1)

    def finished(self, wait_s: float) -> tuple[Route, bool, bytes] | None:
        """Return a client and its answer; None if nothing is finished within the time."""
        try:
            os.eventfd_read(self.wake)
        except BlockingIOError:
            if not wait_s:
                return None
        try:
            granted, answer = self._done.get(timeout=wait_s) if wait_s else self._done.get_nowait()
        except Empty:
            return None
        assert self.waiting is not None
        route, self.waiting = self.waiting, None
        return route, granted, answer

    def close(self) -> None:
        """Let go of the descriptor; a request still in progress gets no answer."""
        with self._lock:
            os.close(self.wake)
            self.wake = -1
