"""Control requests to a running runtime, its own side: a new cloud, a new reference, its state, stop.

A request is one MessagePack map ``{"command": ..., ...}``, the answer one map ``{"ok": true, ...}`` or ``{"ok": false,
"error": text}``. The server has a thread of its own, which runs the geometry graph while the frame loop goes on; the
loop only picks up the finished result. What a client sends is data of bounded size and nothing else: no code, no
pickle; a request that makes no sense is answered with what was wrong. Who asks is in
:mod:`eitskin.messaging.control_client`.

=============  ====================================================  ===========================
command        fields                                                answer
=============  ====================================================  ===========================
``cloud``      ``cloud``: 16200 bytes, float32 LE (3, 30, 45) mm;     ``cloud``: its revision;
               optional ``predicted`` and ``predicted_flat``:        ``warnings``: list of lines,
               832 bytes each, float64 LE (104,) V                   what is doubtful about it
``reference``  optional ``frames``: 2 to 10000; optional             ``frames``, ``weak_rows``,
               ``force``: true takes it even if the sheet seems      and what was found of it
               bent, touched or moving                               (``Judgement.fields``)
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

from eitskin.errors import ControlError, SkinError
from eitskin.messaging.admission.door import Door
from eitskin.messaging.control_fields import LARGEST_REQUEST, array_field, unpack_fields
from eitskin.messaging.curve_keys import Doorkeeper, ServerKeys
from eitskin_proto.sensor.cloud import CLOUD_SHAPE
from eitskin_proto.sensor.sheet_cloud import check_sheet
from eitskin_proto.sensor.table import N_ROWS

MOST_CONNECTIONS: Final = 64
"""Clients at once; see :mod:`eitskin.messaging.admission`."""

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

    def recapture(self, frames: int, *, force: bool = False) -> Mapping[str, object]:
        """Replace the reference by the mean of the next frames, and return what was captured and found of it."""

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
        try:
            self._door = Door(self._socket, endpoint, keys=self._keys, control=True, most=MOST_CONNECTIONS)
        except BaseException:
            self._socket.close(0)
            raise
        self.endpoint = self._door.endpoint

    def _serve(self) -> None:
        """Block until there is a request or a connection; end when the context is terminated."""
        while True:
            try:
                zmq.select([self._socket, *self._door.waits_on], [], [], self._door.look_again_s)
                self._door.look()
                self._door.count()
                if self._socket.getsockopt(zmq.EVENTS) & zmq.POLLIN:
                    self._socket.send(self._answer(self._socket.recv_multipart()))
            except zmq.ContextTerminated:
                break
            except zmq.ZMQError:
                continue  # a client that vanished between request and answer
        self._door.close()
        self._socket.close()

    def _answer(self, parts: list[bytes]) -> bytes:
        try:
            answer: Mapping[str, object] = {"ok": True, **self._perform(unpack_fields(parts))}
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
        cloud = array_field(request, "cloud", np.dtype("<f4"), CLOUD_SHAPE)
        if cloud is None:
            raise ControlError("a cloud request needs the field 'cloud'")
        predicted = array_field(request, "predicted", np.dtype("<f8"), (N_ROWS,))
        flat = array_field(request, "predicted_flat", np.dtype("<f8"), (N_ROWS,))
        doubts = check_sheet(cloud)[1]
        return {"cloud": self._controlled.set_cloud(cloud, predicted, flat), "warnings": list(doubts)}

    def _reference(self, request: Mapping[str, Any]) -> Mapping[str, object]:
        frames = request.get("frames", 100)
        low, high = REFERENCE_FRAMES
        if isinstance(frames, bool) or not isinstance(frames, int) or not low <= frames <= high:
            raise ControlError(f"frames is {str(frames)[:40]}, expected {low} to {high}")
        force = request.get("force", False)
        if not isinstance(force, bool):
            raise ControlError(f"force is {str(force)[:40]}, expected true or false")
        return self._controlled.recapture(frames, force=force)

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
