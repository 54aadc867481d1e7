"""Where the viewer takes frames from: the newest only, with touches, and the rest is never decoded.

CONFLATE keeps one message of a socket, whatever its topic, and the last of its subscriptions. So the socket that brings
frames has one topic, the first byte of a frame, and all that is asked for besides stands on a second one, over which
nothing ever comes.
"""

import time
from contextlib import suppress
from typing import Any, Self

import zmq

from eitskin.errors import EndpointError, FrameError, NoFrame
from eitskin.messaging.curve_keys import ClientKeys
from eitskin.messaging.frame import FIRST_BYTE, Frame, unpack_frame
from eitskin.messaging.reachability import explain_silence
from eitskin.messaging.received.subscriber import LARGEST_TAKEN
from eitskin.messaging.regions import ALWAYS, TOUCHES, WHOLE


class Tap:
    """Two sockets to a runtime; a context.

    Args:
        endpoint: Where it publishes.
        keys: CURVE keys.

    Raises:
        EndpointError: ZeroMQ cannot make sense of the endpoint.
    """

    def __init__(self, endpoint: str, keys: ClientKeys | None) -> None:
        self._endpoint, self._keys = endpoint, keys
        self._context: zmq.Context[Any] = zmq.Context()
        self._sockets: list[Any] = []
        try:
            self._open()
        except BaseException:
            self.__exit__()
            raise

    def _open(self) -> None:
        for topics in ((FIRST_BYTE,), (WHOLE, ALWAYS, TOUCHES)):
            socket: Any = self._context.socket(zmq.SUB)
            self._sockets.append(socket)
            socket.setsockopt(zmq.LINGER, 0)
            socket.setsockopt(zmq.MAXMSGSIZE, LARGEST_TAKEN)
            if len(topics) == 1:
                socket.setsockopt(zmq.CONFLATE, 1)
            if self._keys is not None:
                self._keys.apply(socket)
            for topic in topics:  # before it connects, as for frames
                socket.setsockopt(zmq.SUBSCRIBE, topic)
            try:
                socket.connect(self._endpoint)
            except zmq.ZMQError as error:
                raise EndpointError(
                    f"{self._endpoint!r} cannot be connected to: {error.strerror}; expected ipc:///path or "
                    "tcp://address:port"
                ) from error

    def newest(self, within_s: float) -> Frame:
        """Return the newest frame, waiting for one.

        Args:
            within_s: How long.

        Raises:
            NoFrame: None came; the text says whether anybody is there, and what to do. The sockets are new ones then:
                libzmq never comes back to where something else had answered.
        """
        deadline_s = time.monotonic() + within_s
        while (left_s := deadline_s - time.monotonic()) > 0.0:
            if self._sockets[0].poll(max(1, round(1000 * left_s))):
                message = self._sockets[0].recv()
                with suppress(FrameError):  # whoever publishes there
                    return unpack_frame(message, time.perf_counter_ns())
        self._close()
        self._open()
        raise NoFrame(
            f"no frame from {self._endpoint} within {within_s:g} s: {explain_silence(self._endpoint, within_s)}"
        )

    def _close(self) -> None:
        while self._sockets:
            self._sockets.pop().close(0)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._close()
        self._context.term()
