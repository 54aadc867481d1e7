"""A bound address of the runtime: it limits connections and keeps libzmq from running out of files.

Only trusted clients can connect: an ipc socket has mode 0600 from its first instant, and TCP always needs CURVE keys
(:mod:`eitskin.messaging.endpoints`). Trusted clients make mistakes, though: a program that leaks connections can use up
the files of the process, and libzmq 4.3.5 aborts the process when its ipc listener finds no descriptor for a connection
(``ipc_listener.cpp``; a tcp listener survives).

So libzmq never accepts at an ipc path that clients can reach. A listener of this class is bound there. Once a client
waits, and there are enough files, a second listener replaces it at the path, and libzmq gets the first one, which new
clients can no longer reach: it accepts the waiting clients, and never more than the queue holds. ::

    path -> L1    A, B wait
    path -> L2    L1 goes to libzmq, which accepts A and B        L2 is renamed onto the path: no gap for C
    path -> L2    C waits

libzmq ends a listener's connections with it, so each is kept until all of its own have left. On TCP libzmq accepts
every connection, and those beyond the limit are ended. It ends by itself what does not shake hands. A thread only
counts connections as libzmq's monitor reports them, because libzmq blocks when its monitor is not read.
"""

import errno
import itertools
import os
import select
import socket
import stat
import struct
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

import zmq

from eitskin.errors import EndpointError
from eitskin.messaging.curve_keys import ServerKeys
from eitskin.messaging.endpoints import bind_problem, check_allowed, clear_path

QUEUE: Final = 8
"""Connections that may wait at an ipc path, and one more, as Linux counts; a client that finds no place tries again by
itself."""

GRACE_S: Final = 0.5
"""How long a listener is kept at least."""

PAUSE_S: Final = 0.05
"""Pause before the next look at waiting clients when there was no room for them."""

RESERVE: Final = 24
"""Files that stay free for the process itself, and for new connections of another address."""

CONTEXT_FILES: Final = 8
"""Files of a context and its socket."""

CLIENT_FILES: Final = CONTEXT_FILES + 2
"""Files of a context, a socket that connects, and a connection that is made anew."""

HANDSHAKE_MS: Final = 2000
"""How long a handshake may take; libzmq ends a connection that takes longer."""

IPC: Final = "ipc://"

MOST_FILES: Final = 65536
"""Limits from here on count as none."""

_EVENT: Final = struct.Struct("=Hi")
_EVENTS: Final = zmq.EVENT_ACCEPTED | zmq.EVENT_DISCONNECTED | zmq.EVENT_MONITOR_STOPPED
_NUMBERS: Final = itertools.count()
"""Of ipc listeners in this process, whose names must differ."""


class Listener:
    """Binds a ZeroMQ socket, bounds its connections, and closes it; leave it with ``close``.

    Use it only in the thread of the socket.

    Args:
        context: Of the socket.
        socket_: Of zmq; its other options must be set already.
        endpoint: ``ipc:///path`` or ``tcp://address:port``.
        keys: CURVE keys, which TCP needs.
        most: Connections at once; fewer where few files may be open.

    Raises:
        EndpointError: The endpoint is not allowed like this, or in use, or cannot be bound. The socket is closed.
    """

    def __init__(self, context: Any, socket_: Any, endpoint: str, *, keys: ServerKeys | None, most: int) -> None:
        self._socket, self._most = socket_, most
        self.endpoint = endpoint
        """Where it is bound, with the port that a ``*`` became."""
        self._lock = threading.Lock()
        self._connections: dict[int, str] = {}
        """By descriptor: the endpoint of its listener, as libzmq names it."""
        self.refused = 0
        """Connections that were ended because there were too many."""
        self._ipc = endpoint.startswith(IPC)
        self._waiting: socket.socket | None = None
        """The listener at the ipc path."""
        self._next_s = 0.0
        """Time of the next look at waiting clients."""
        self._given: dict[str, tuple[int, float]] = {}
        """Of each listener that libzmq has got: its descriptor, and when."""
        monitor = f"inproc://monitor-{id(self)}"
        socket_.monitor(monitor, _EVENTS)
        events = context.socket(zmq.PAIR)
        events.connect(monitor)
        self._thread = threading.Thread(target=self._count, args=(events,), name="eitskin-connections", daemon=True)
        self._thread.start()
        try:
            check_allowed(endpoint, keys)
            self.endpoint = self._bind(endpoint, keys)
        except (zmq.ZMQError, OSError) as error:
            self.close()
            raise EndpointError(bind_problem(endpoint, error)) from error
        except BaseException:
            self.close()
            raise

    def _bind(self, endpoint: str, keys: ServerKeys | None) -> str:
        """Bind the socket, and return where, with the port that a ``*`` became."""
        self._socket.setsockopt(zmq.HANDSHAKE_IVL, HANDSHAKE_MS)
        if keys is not None and not self._ipc:
            keys.apply(self._socket)
            self._socket.bind(endpoint)
            return self._last_endpoint()
        path = Path(endpoint.removeprefix(IPC))
        clear_path(path)
        self._waiting = listening(path)
        self._inode = path.lstat().st_ino
        return endpoint

    def _last_endpoint(self) -> str:
        return str(self._socket.getsockopt_string(zmq.LAST_ENDPOINT)).rstrip("\0")

    def _count(self, events: Any) -> None:
        """Count connections until the socket is closed."""
        with events, suppress(zmq.ContextTerminated):
            while True:
                packed, listener = events.recv_multipart()
                event, descriptor = _EVENT.unpack(packed)
                if event == zmq.EVENT_MONITOR_STOPPED:
                    return
                with self._lock:
                    if event == zmq.EVENT_ACCEPTED:
                        self._connections[descriptor] = listener.decode()
                        few_files = descriptor > file_limit() - RESERVE  # a new one has the lowest free number
                        if not self._ipc and (few_files or len(self._connections) > self._most):
                            self._end(descriptor)
                    else:  # libzmq says so before it closes the descriptor
                        self._connections.pop(descriptor, None)

    def _end(self, descriptor: int) -> None:
        """End a connection; under the lock."""
        self.refused += 1
        with suppress(OSError), connection(descriptor, self._connections.pop(descriptor)) as ended:
            ended.shutdown(socket.SHUT_RDWR)  # libzmq finds it ended by the other side, and cleans up

    @property
    def waits_on(self) -> list[int]:
        """Descriptors to wait on: one that can be read means that ``admit`` has something to do."""
        return [self._waiting.fileno()] if self._waiting is not None and self.pause_s is None else []

    @property
    def pause_s(self) -> float | None:
        """How long to wait on them at most; None for ever."""
        return PAUSE_S if time.monotonic() < self._next_s else None

    def admit(self) -> None:
        """Accept waiting clients at an ipc address if there is room; takes microseconds while none waits."""
        if self._waiting is None or not can_be_read(self._waiting.fileno()) or self.pause_s is not None:
            return
        self._release()
        full = free_files() < QUEUE + 2 or len(self._connections) >= self._most
        if full or any(can_be_read(number) for number, _ in self._given.values()):
            self._next_s = time.monotonic() + PAUSE_S
        else:
            self._let_in(self._waiting, Path(self.endpoint.removeprefix(IPC)))

    def _let_in(self, waiting: socket.socket, path: Path) -> None:
        """Put another listener at the path, and give libzmq the one at which clients wait."""
        beside = path.with_name(f".{next(_NUMBERS) % 0x100000:x}")
        try:
            another = listening(beside)
            beside.rename(path)
        except OSError:  # the folder is gone, and everybody's way here with it
            self._next_s = time.monotonic() + PAUSE_S
            return
        self._inode = path.lstat().st_ino
        self._waiting = another
        self._socket.setsockopt(zmq.USE_FD, waiting.fileno())
        self._socket.bind(f"{IPC}{waiting.getsockname()}")
        self._given[self._last_endpoint()] = waiting.detach(), time.monotonic()

    def _release(self) -> None:
        """Take listeners back whose connections have all left."""
        used = set(list(self._connections.values()))
        before_s = time.monotonic() - GRACE_S
        for endpoint, (number, given_s) in list(self._given.items()):
            if endpoint not in used and given_s < before_s and not can_be_read(number):
                del self._given[endpoint]
                with suppress(zmq.ZMQError):
                    self._socket.unbind(endpoint)

    @property
    def connections(self) -> int:
        """How many there are."""
        return len(self._connections)

    def close(self) -> None:
        """Close the socket, and take its file away if it is still ours; closing twice is fine."""
        if self._waiting is not None:
            path = Path(self.endpoint.removeprefix(IPC))
            with suppress(OSError):
                found = path.lstat()
                if stat.S_ISSOCK(found.st_mode) and found.st_ino == self._inode:
                    path.unlink()
            self._waiting.close()
            self._waiting = None
        self._socket.close()
        self._thread.join()


def listening(path: Path) -> socket.socket:
    """Return a listener at a path that only its owner can reach.

    Raises:
        OSError: It cannot be bound.
    """
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_NONBLOCK)
    try:
        os.fchmod(listener.fileno(), 0o600)  # before it is bound: its file has this mode from the first instant
        listener.bind(os.fspath(path))
        listener.listen(QUEUE)
    except BaseException:
        listener.close()
        raise
    return listener


def can_be_read(descriptor: int) -> bool:
    """Return whether a descriptor is readable: for a listener, whether a client waits."""
    poll = select.poll()
    poll.register(descriptor, select.POLLIN)
    return any(event & select.POLLIN for _, event in poll.poll(0))


def connection(descriptor: int, listener: str) -> socket.socket:
    """Return a connection once more, if it is still the one that came to a listener.

    Raises:
        OSError: It has left, whatever has its descriptor now.
    """
    number = os.dup(descriptor)
    try:
        found = socket.socket(fileno=number)
    except BaseException:
        os.close(number)
        raise
    name = found.getsockname()
    if not listener.endswith(f":{name[1]}" if isinstance(name, tuple) else f"{IPC}{name}"):
        found.close()
        raise ConnectionResetError(errno.ECONNRESET, f"{name} is not {listener}")
    return found


def sender_of(message: Any) -> int | None:
    """Return the descriptor over which a frame of zmq came; None where libzmq made it up."""
    try:
        return int(message.get(zmq.SRCFD))
    except zmq.ZMQError:
        return None


def check_files(endpoint: str, wanted: int = RESERVE + CONTEXT_FILES + 2 * (QUEUE + 2)) -> None:
    """Refuse an endpoint if too few files may be open; libzmq aborts the process where it finds none.

    Args:
        endpoint: Its name.
        wanted: Files that it opens; those of a listener and its first clients.

    Raises:
        EndpointError: There are too few.
    """
    left = free_files() + RESERVE
    if left < wanted:
        limit = file_limit()
        raise EndpointError(
            f"{endpoint}: only {limit} files may be open, of which {max(left, 0)} are left for connections, "
            f"expected at least {wanted}: allow more with 'ulimit -n {limit + 100 - left}' or LimitNOFILE"
        )


def file_limit() -> int:
    """Return how many files may be open."""
    try:
        import resource  # noqa: PLC0415 -- Windows has none
    except ImportError:
        return MOST_FILES
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return MOST_FILES if soft == resource.RLIM_INFINITY else min(soft, MOST_FILES)


def free_files() -> int:
    """Return how many files may still be opened for connections; less than nothing if the reserve is used."""
    try:
        used = len(os.listdir("/proc/self/fd"))
    except FileNotFoundError:
        used = 0  # macOS and Windows do not tell
    except OSError:  # not even one is left
        used = file_limit()
    return file_limit() - used - RESERVE
