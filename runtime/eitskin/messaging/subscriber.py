"""The base of all subscriptions: it connects a socket, closes it, and returns the next item.

libzmq reconnects when the other side ended a connection, but not when it ended one itself: after a message beyond all
bounds, or bytes that are not ZMTP, such as those of another program on the port. So a silent subscriber connects anew.
"""

import math
import time
from collections.abc import Iterable
from contextlib import suppress
from typing import Any, Final

import zmq

from eitskin.errors import EndpointError, FrameError, NoFrame
from eitskin.messaging.curve_keys import ClientKeys
from eitskin.messaging.endpoints import check_client_keys, default_publish
from eitskin.messaging.listener import CLIENT_FILES, check_files
from eitskin.messaging.reachability import explain_silence
from eitskin.messaging.reader import LONGEST_WAIT_MS, Item, Reader

_POLLIN: Final = int(zmq.POLLIN)

MODES: Final = ("latest", "all")

FIRST_S: Final = 5.0
"""How long the first message may take where no time was named; a runtime that is there sends one within 0.1 s."""

LARGEST_TAKEN: Final = 73728
"""Bytes of a message that is still accepted; a larger one ends the connection, so memory is bounded."""

SILENCE_NS: Final = 2_000_000_000
"""Silence after which it connects anew."""


class Subscriber(Reader[Item]):
    """A connected socket that yields items; leave it with ``close`` or as a context manager.

    A subclass says what a message holds (:meth:`_item`).

    Args:
        endpoint: ``ipc:///path`` or ``tcp://address:port``; None takes the one of ``eitskin run``.
        topics: To subscribe to, in this order.
        queue: Messages that wait on this side at most.
        mode: ``all``, or ``latest`` to leave older messages alone where newer ones wait.
        conflate: In mode ``latest`` libzmq keeps one message only; it does not go with more than one topic.
        timeout_s: How long to wait for an item; None waits 5 s for the first and then for ever.
        keys: CURVE keys, which TCP needs.
        nothing: Name of the missing item, for people.

    Raises:
        ValueError: The time is not positive, or the mode does not exist.
        EndpointError: ZeroMQ cannot make sense of the endpoint, or it is TCP and there are no keys, or there is no
            folder for the default one.
    """

    def __init__(
        self,
        endpoint: str | None,
        topics: Iterable[bytes],
        queue: int,
        *,
        mode: str = "all",
        conflate: bool = False,
        timeout_s: float | None,
        keys: ClientKeys | None,
        nothing: str = "no frame",
    ) -> None:
        if mode not in MODES:
            raise ValueError(f"mode {mode!r} does not exist; expected one of {', '.join(MODES)}")
        if timeout_s is not None and not timeout_s > 0:
            raise ValueError(f"timeout_s is {timeout_s}, expected more than 0")
        super().__init__()
        self.endpoint = default_publish() if endpoint is None else endpoint
        check_client_keys(self.endpoint, keys)
        self.received = 0
        """Items returned so far."""
        self.rejected = 0
        """Messages of another kind than subscribed to, or damaged."""
        self._timeout_s = math.inf if timeout_s is None else timeout_s
        self._first_s = FIRST_S if timeout_s is None else timeout_s
        self._nothing = nothing
        self._newest_only = mode == "latest" and not conflate
        self._wait_ms = -1
        """The socket's present receive timeout. It waits by itself, because a ``poll`` would delay frames."""
        self._unusable: tuple[int, str] = (0, "")
        """Messages rejected since the last accepted one, and the kind of the last of them."""
        self._heard_ns = time.perf_counter_ns()
        """When the last message came."""
        check_files(self.endpoint, CLIENT_FILES)
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self.socket: Any = self._context.socket(zmq.SUB)
        """For waiting on several sockets."""
        self.socket.setsockopt(zmq.LINGER, 0)
        self.socket.setsockopt(zmq.MAXMSGSIZE, LARGEST_TAKEN)
        self.socket.setsockopt(zmq.RCVHWM, queue)
        if mode == "latest" and conflate:
            self.socket.setsockopt(zmq.CONFLATE, 1)
        if keys is not None:
            keys.apply(self.socket)
        # Before it connects: CONFLATE holds for what is sent as well, and a subscription that is written in the instant
        # in which libzmq's own thread looks for one is lost without a word (dbuffer.hpp): 4 of 300,000.
        for topic in topics:
            self.socket.setsockopt(zmq.SUBSCRIBE, topic)
        try:
            self.socket.connect(self.endpoint)
        except zmq.ZMQError as error:
            self.close()
            raise EndpointError(
                f"{endpoint!r} cannot be connected to: {error.strerror}; expected ipc:///path or tcp://address:port"
            ) from error

    def _item(self, message: bytes) -> Item | None:
        """Return the item of a message; None if the message alone makes none.

        Raises:
            FrameError: It cannot be used.
        """
        raise NotImplementedError

    def _newer(self, before: Item | None, found: Item | None) -> Item | None:
        """Return which of two is to be returned in mode ``latest``."""
        return before if found is None else found

    def _why(self, waited_s: float) -> str:
        """Return why nothing came, with advice."""
        return self.silence(waited_s)

    def _wait(self, timeout_s: float | None) -> Item:
        """Return the next item, waiting for it.

        Raises:
            NoFrame: None came in time; the text says whether anybody is there, and what to do.
            Closed: The subscription was stopped or closed.
        """
        if timeout_s is None:
            timeout_s = self._timeout_s if self.received else self._first_s
        left_s = timeout_s
        end_s = time.perf_counter() + timeout_s
        while True:
            wait_ms = max(1, math.ceil(min(1000 * left_s, LONGEST_WAIT_MS)))
            if wait_ms != self._wait_ms:
                self._wait_ms = wait_ms
                self.socket.setsockopt(zmq.RCVTIMEO, wait_ms)
            try:
                item = self._taken(self._recv())
            except zmq.Again:
                item = None
                self.connect_if_silent()
            if item is not None:
                return item
            self._check_stopped()
            left_s = end_s - time.perf_counter()
            if left_s <= 0:
                raise NoFrame(f"{self._nothing} from {self.endpoint} within {timeout_s:g} s: {self._why(timeout_s)}")

    def waiting(self) -> Item | None:
        """Return the item that waits already; None if there is none."""
        self._check_stopped()
        return self._taken(self._recv()) if self.waits else None

    def _taken(self, message: bytes) -> Item | None:
        """Return the item of a message, or the newest of all that wait, until the reader is stopped."""
        item = self._checked(message)
        while self._newest_only and not self._stopped and self.waits:
            item = self._newer(item, self._checked(self._recv()))
        self.received += item is not None
        return item

    def _checked(self, message: bytes) -> Item | None:
        try:
            item = self._item(message)
        except FrameError as error:  # whatever publishes there, it must not end a robot's loop
            self.rejected += 1
            self._unusable = self._unusable[0] + 1, str(error)
            return None
        if item is not None:
            self._unusable = 0, ""
        return item

    @property
    def waits(self) -> bool:
        """Whether a message is there already."""
        return bool(self.socket.getsockopt(zmq.EVENTS) & _POLLIN)

    def silence(self, waited_s: float, what: str = "frame", likely: str = "") -> str:
        """Return why nothing that was waited for came; arguments as of :func:`explain_silence`."""
        (count, last), self._unusable = self._unusable, (0, "")
        if count:
            return f"{count} messages arrived, but none is a usable {what}: {last}"
        return explain_silence(self.endpoint, waited_s, what, likely)

    def _recv(self) -> bytes:
        """Receive a message, and keep in mind when it came."""
        message: bytes = self.socket.recv()
        self._heard_ns = time.perf_counter_ns()
        return message

    def connect_if_silent(self) -> None:
        """Connect anew if nothing has come for a while."""
        if time.perf_counter_ns() - self._heard_ns > SILENCE_NS:
            with suppress(zmq.ZMQError):
                self.socket.disconnect(self.endpoint)
            self.socket.connect(self.endpoint)
            self._heard_ns = time.perf_counter_ns()

    def _release(self) -> None:
        self.socket.close(0)
        self._context.term()
