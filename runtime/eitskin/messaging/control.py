"""Control requests to a running runtime: a new cloud, a new reference, its state, stop.

A request is one MessagePack map ``{"command": ..., ...}``, the answer one map ``{"ok": true, ...}`` or ``{"ok": false,
"error": text}``. The server has a thread of its own, which runs the geometry graph while the frame loop goes on; the
loop only picks up the finished result. What a client sends is data of bounded size and nothing else: no code, no
pickle; a request that makes no sense is answered with what was wrong.

=============  ====================================================  ===========================
command        fields                                                answer
=============  ====================================================  ===========================
``cloud``      ``cloud``: 16200 bytes, float32 LE (3, 30, 45) mm;     ``cloud``: its revision
               optional ``predicted`` and ``predicted_flat``:
               832 bytes each, float64 LE (104,) V
``reference``  optional ``frames``: 2 to 10000                        ``frames``, ``weak_rows``
``exclude``    ``electrodes``: list of at most 4 numbers, 0 to 15;    ``electrodes``
               empty uses all again
``status``                                                            counters and ids
``stop``
=============  ====================================================  ===========================
"""

import threading
from collections.abc import Callable, Mapping
from typing import Any, Final, Protocol

import msgpack  # type: ignore[import-untyped]
import numpy as np
import numpy.typing as npt
import zmq

from eitskin.errors import ControlError, EndpointError, SkinError
from eitskin.messaging.connection_limit import Connections
from eitskin.messaging.curve_keys import ClientKeys, Doorkeeper, ServerKeys
from eitskin.messaging.endpoints import bind, release, reopen
from eitskin.reference.predicted import check_voltages
from eitskin_proto.sensor.cloud import CLOUD_SHAPE, check_cloud
from eitskin_proto.sensor.table import N_ROWS

LARGEST_REQUEST: Final = 32768
"""Bytes; a cloud with both predictions has 18,000. libzmq drops a client that sends more, before it takes memory."""

MOST_CONNECTIONS: Final = 64
"""Clients at once; see :mod:`eitskin.messaging.connection_limit`."""

REFERENCE_FRAMES: Final = (2, 10_000)
"""Fewest and most frames of a reference that is asked for."""


class Controlled(Protocol):
    """What the server needs of the runtime; called in the server's thread."""

    def set_cloud(
        self,
        cloud: npt.NDArray[np.floating] | None,
        predicted: npt.NDArray[np.float64] | None = None,
        predicted_flat: npt.NDArray[np.float64] | None = None,
    ) -> int:
        """Use a cloud from the next frame on and return its revision."""

    def recapture(self, frames: int) -> Mapping[str, object]:
        """Replace the reference by the mean of the next frames, and return what was captured."""

    def exclude(self, electrodes: tuple[int, ...]) -> None:
        """Go on without these electrodes from the next frame on."""

    def status(self) -> Mapping[str, object]:
        """Return counters and ids."""

    def stop(self) -> None:
        """End the frame loop soon."""


class ControlServer:
    """Answers requests until ``close``.

    Args:
        endpoint: ``ipc:///path``, or TCP with keys.
        controlled: The runtime.
        keys: CURVE keys, needed for TCP.

    Raises:
        EndpointError: The endpoint is not allowed like this, or in use.
    """

    def __init__(self, endpoint: str, controlled: Controlled, keys: ServerKeys | None = None) -> None:
        self._controlled = controlled
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._keys = keys
        self.refused = 0
        """Requests that were answered with an error."""
        self.resets = 0
        """How often a flood of connections made the socket start anew."""
        self._doorkeeper = Doorkeeper(self._context, keys) if keys is not None else None
        try:
            self._open(endpoint)
        except BaseException:
            self._end()
            raise
        self._thread = threading.Thread(target=self._serve, name="eitskin-control", daemon=True)
        self._thread.start()

    def _open(self, endpoint: str) -> None:
        self._socket: Any = self._context.socket(zmq.REP)
        self._socket.setsockopt(zmq.MAXMSGSIZE, LARGEST_REQUEST)
        self._socket.setsockopt(zmq.RCVHWM, 4)
        self._socket.setsockopt(zmq.SNDHWM, 4)
        self._socket.setsockopt(zmq.HANDSHAKE_IVL, 2000)
        self._socket.setsockopt(zmq.LINGER, 200)
        self._connections = Connections(self._socket)
        try:
            self.endpoint = bind(self._socket, endpoint, keys=self._keys, control=True)
        except BaseException:
            self._connections.close()
            self._socket.close(0)
            raise

    def _serve(self) -> None:
        """Block until there is a request or a connection; end when the context is terminated."""
        while True:
            try:
                zmq.select([self._socket, self._connections.monitor], [], [])
                if self._connections.look() > MOST_CONNECTIONS:
                    self._start_anew()
                elif self._socket.getsockopt(zmq.EVENTS) & zmq.POLLIN:
                    self._socket.send(self._answer(self._socket.recv_multipart()))
            except (zmq.ContextTerminated, EndpointError):  # the latter: its address is gone for good
                break
            except zmq.ZMQError:
                continue  # a client that vanished between request and answer
        if not self._socket.closed:
            self._connections.close()
            self._socket.close()

    def _start_anew(self) -> None:
        self._connections.close()
        self._socket.close(0)
        self.resets += 1
        reopen(self._open, self.endpoint)

    def _answer(self, parts: list[bytes]) -> bytes:
        try:
            answer: Mapping[str, object] = {"ok": True, **self._perform(_request(parts))}
        except (SkinError, ValueError, TimeoutError) as error:
            self.refused += 1
            answer = {"ok": False, "error": " ".join(str(error).split())[:1000]}
        except Exception as error:  # whatever a request brings about, the next one must find a server
            self.refused += 1
            answer = {"ok": False, "error": f"the runtime failed at this request: {type(error).__name__}"}
        packed: bytes = msgpack.packb(answer)
        return packed

    def _perform(self, request: Mapping[str, Any]) -> Mapping[str, object]:
        commands: dict[str, Callable[[Mapping[str, Any]], Mapping[str, object]]] = {
            "cloud": self._cloud,
            "reference": self._reference,
            "exclude": self._exclude,
            "status": lambda _: self._controlled.status(),
            "stop": self._stop,
        }
        command = request.get("command")
        if not isinstance(command, str) or command not in commands:
            raise ControlError(f"command {str(command)[:40]!r} does not exist; expected one of {', '.join(commands)}")
        return commands[command](request)

    def _cloud(self, request: Mapping[str, Any]) -> Mapping[str, object]:
        cloud = _array(request, "cloud", np.dtype("<f4"), CLOUD_SHAPE)
        if cloud is None:
            raise ControlError("a cloud request needs the field 'cloud'")
        predicted = _array(request, "predicted", np.dtype("<f8"), (N_ROWS,))
        flat = _array(request, "predicted_flat", np.dtype("<f8"), (N_ROWS,))
        return {"cloud": self._controlled.set_cloud(cloud, predicted, flat)}

    def _reference(self, request: Mapping[str, Any]) -> Mapping[str, object]:
        frames = request.get("frames", 100)
        low, high = REFERENCE_FRAMES
        if isinstance(frames, bool) or not isinstance(frames, int) or not low <= frames <= high:
            raise ControlError(f"frames is {str(frames)[:40]}, expected {low} to {high}")
        return self._controlled.recapture(frames)

    def _exclude(self, request: Mapping[str, Any]) -> Mapping[str, object]:
        electrodes = request.get("electrodes")
        if not isinstance(electrodes, list) or not all(type(number) is int for number in electrodes):
            raise ControlError(f"electrodes is {str(electrodes)[:40]}, expected a list of numbers from 0 to 15")
        self._controlled.exclude(tuple(electrodes))
        return {"electrodes": electrodes}

    def _stop(self, _: Mapping[str, Any]) -> Mapping[str, object]:
        self._controlled.stop()
        return {}

    def _end(self) -> None:
        self._context.term()  # wakes the threads, and waits until they have closed their sockets
        if self._doorkeeper is not None:
            self._doorkeeper.join()

    def close(self) -> None:
        """Answer nobody any more; closing twice is fine."""
        if self._context.closed:
            return
        self._end()
        self._thread.join()
        release(self.endpoint)


def request(
    endpoint: str, command: str, *, timeout_s: float = 10.0, keys: ClientKeys | None = None, **fields: object
) -> dict[str, Any]:
    """Send one control request and return the answer's fields.

    Args:
        endpoint: Of the runtime's control.
        command: ``cloud``, ``reference``, ``status`` or ``stop``.
        timeout_s: How long to wait for the answer.
        keys: CURVE keys, for TCP.
        fields: Of the request.

    Raises:
        ControlError: The runtime refused, with its reason; or did not answer in time.
        EndpointError: ZeroMQ cannot make sense of the endpoint.
    """
    if not timeout_s > 0:
        raise ValueError(f"timeout_s is {timeout_s}, expected more than 0")
    context: zmq.Context[Any] = zmq.Context()
    socket = context.socket(zmq.REQ)
    try:
        socket.setsockopt(zmq.LINGER, 0)
        socket.setsockopt(zmq.MAXMSGSIZE, LARGEST_REQUEST)
        if keys is not None:
            keys.apply(socket)
        socket.connect(endpoint)
        socket.send(msgpack.packb({"command": command, **fields}))
        if not socket.poll(round(timeout_s * 1000)):
            raise ControlError(f"no answer from {endpoint} within {timeout_s:g} s; is the runtime running?")
        answer = _request([socket.recv()])
    except zmq.ZMQError as error:
        raise EndpointError(f"{endpoint} cannot be used: {error.strerror}") from error
    finally:
        socket.close(0)
        context.term()
    if answer.pop("ok", None) is not True:
        raise ControlError(str(answer.get("error", "the runtime refused without a reason")))
    return answer


def send_cloud(
    endpoint: str,
    cloud: npt.ArrayLike,
    predicted: npt.ArrayLike | None = None,
    predicted_flat: npt.ArrayLike | None = None,
    *,
    timeout_s: float = 10.0,
    keys: ClientKeys | None = None,
) -> int:
    """Give a running runtime the scanned surface and return the cloud's revision, which frames carry from then on.

    Args:
        endpoint: Of the runtime's control.
        cloud: (3, 30, 45) mm, in any pose.
        predicted: (104,) V, what the forward model says of this surface untouched; None for no prediction.
        predicted_flat: (104,) V, what the same model says of the flat sheet; None takes the captured reference, which
            is right only if model and device agree on current and gain.
        timeout_s: How long to wait for the answer.
        keys: CURVE keys, for TCP.

    Raises:
        ValueError: The cloud or the voltages are malformed: shape, NaN, size; with the value and the bound.
        ControlError: The runtime refused, or did not answer.
    """
    fields: dict[str, object] = {"cloud": check_cloud(cloud).astype("<f4").tobytes()}
    for name, voltages in (("predicted", predicted), ("predicted_flat", predicted_flat)):
        if voltages is not None:
            fields[name] = check_voltages(name, voltages).astype("<f8").tobytes()
    return int(request(endpoint, "cloud", timeout_s=timeout_s, keys=keys, **fields)["cloud"])


def _request(parts: list[bytes]) -> dict[str, Any]:
    if len(parts) != 1:
        raise ControlError(f"a message of {len(parts)} parts; expected one")
    try:
        fields = msgpack.unpackb(
            parts[0], raw=False, strict_map_key=True, max_str_len=2048, max_bin_len=LARGEST_REQUEST, max_array_len=64,
            max_map_len=64, max_ext_len=0,
        )  # fmt: skip
    except Exception as error:  # msgpack's exceptions have no common base
        raise ControlError(
            f"a message of {len(parts[0])} bytes is no MessagePack map ({type(error).__name__})"
        ) from error
    if not isinstance(fields, dict):
        raise ControlError(f"a message holds {type(fields).__name__}, expected a map")
    return fields


def _array(
    request: Mapping[str, Any], name: str, kind: np.dtype[Any], shape: tuple[int, ...]
) -> npt.NDArray[Any] | None:
    raw = request.get(name)
    if raw is None:
        return None
    expected = int(np.prod(shape)) * kind.itemsize
    if not isinstance(raw, bytes) or len(raw) != expected:
        found = f"{len(raw)} bytes" if isinstance(raw, bytes) else type(raw).__name__
        raise ControlError(f"{name}: found {found}, expected {expected} bytes of {kind.str} {shape}")
    return np.frombuffer(raw, dtype=kind).reshape(shape)
