"""The client's side of control requests: a cloud, a reference, electrodes, its state and its clock, stop.

Requests go to the *control* endpoint of ``eitskin run --control``, not to the one on which frames are published. Both
sides have the same default (:func:`eitskin.messaging.endpoints.default_control`).
"""

import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import msgpack  # type: ignore[import-untyped]
import numpy as np
import numpy.typing as npt
import zmq

from eitskin.errors import CloudWarning, ControlError, EndpointError
from eitskin.messaging.control_commands import LARGEST_REQUEST, unpack_fields
from eitskin.messaging.curve_keys import ClientKeys
from eitskin.messaging.endpoints import CONTROL, ROBOT, check_client_keys, default_control
from eitskin.messaging.frame import Frame
from eitskin.messaging.listener import CLIENT_FILES, check_files
from eitskin.messaging.reachability import other_runtimes
from eitskin.reference.predicted import check_voltages
from eitskin_proto.skin.cloud import check_cloud
from eitskin_proto.skin.cloud_file import Surface, load_surface
from eitskin_proto.skin.skin import PAPER
from eitskin_proto.skin.skin import Skin as SkinDescription

SCHEMES = ("ipc://", "tcp://")


def request(
    endpoint: str | None, command: str, *, timeout_s: float = 10.0, keys: ClientKeys | None = None, **fields: object
) -> dict[str, Any]:
    """Send one control request and return the answer's fields.

    Args:
        endpoint: The runtime's control endpoint (``eitskin run --control``); None for the default.
        command: ``cloud`` (see :func:`send_cloud`); ``reference``, with ``frames`` and ``force``, captures a new
            reference; ``exclude``, with ``electrodes``, a list of numbers from 0 to 15, excludes these, and an empty
            list includes all again; ``status`` returns counters and ids; ``clock`` returns ``now_ns``; ``stop`` ends
            the runtime.
            :mod:`eitskin.messaging.control` lists the fields of each request and answer.
        timeout_s: How long to wait for the answer.
        keys: CURVE keys, required for TCP.
        fields: Fields of the request.

    Raises:
        ControlError: The runtime refused, with its reason, or did not answer in time.
        EndpointError: The endpoint is malformed, or needs keys because it is TCP.
        ValueError: ``timeout_s`` is not positive.
    """
    with _connected(endpoint, timeout_s, keys) as ask:
        return ask(command, **fields)


@dataclass(frozen=True, slots=True)
class RuntimeClock:
    """How the clock of a runtime's machine compares with this machine's.

    Attributes:
        offset_ns: What the runtime's clock shows, minus this machine's ``perf_counter_ns``.
        error_ns: How far that may be off: half of the shortest round trip.
    """

    offset_ns: int
    error_ns: int

    def age_s(self, frame: Frame) -> float:
        """Return the seconds from a frame's scan until now, the time on the network included."""
        return 1e-6 * frame.age_us + 1e-9 * (time.perf_counter_ns() + self.offset_ns - frame.host_ns["publish"])


def measure_clock(
    endpoint: str | None = None, *, rounds: int = 20, timeout_s: float = 10.0, keys: ClientKeys | None = None
) -> RuntimeClock:
    """Compare the clock of a runtime on another machine with this one, by requests for it.

    Clocks drift apart by some us a second, so measure again every minute.

    Args:
        endpoint: The runtime's control endpoint; None for the default.
        rounds: How many requests; the fastest counts.
        timeout_s: How long to wait for each answer.
        keys: CURVE keys, required for TCP.

    Raises:
        ControlError: The runtime did not answer in time, or is of an older release.
        EndpointError: As of :func:`request`.
    """
    found = []
    with _connected(endpoint, timeout_s, keys) as ask:
        for _ in range(rounds):
            sent_ns = time.perf_counter_ns()
            now_ns = int(ask("clock")["now_ns"])
            error_ns = (time.perf_counter_ns() - sent_ns) // 2
            found.append((error_ns, now_ns - sent_ns - error_ns))
    error_ns, offset_ns = min(found)
    return RuntimeClock(offset_ns, error_ns)


@contextmanager
def _connected(
    endpoint: str | None, timeout_s: float, keys: ClientKeys | None
) -> Iterator[Callable[..., dict[str, Any]]]:
    """Give a function that sends a request over one connection and returns the answer's fields."""
    if not timeout_s > 0:
        raise ValueError(f"timeout_s is {timeout_s}, expected more than 0")
    where = default_control() if endpoint is None else endpoint
    check_client_keys(where, keys)
    check_files(where, CLIENT_FILES)

    def ask(command: str, **fields: object) -> dict[str, Any]:
        socket.send(msgpack.packb({"command": command, **fields}))
        if not socket.poll(round(timeout_s * 1000)):
            raise ControlError(f"no answer from {where} within {timeout_s:g} s; {_why_silent(where)}")
        answer = unpack_fields([socket.recv()])
        if answer.pop("ok", None) is not True:
            raise ControlError(str(answer.get("error", "the runtime refused without a reason")))
        return answer

    context: zmq.Context[Any] = zmq.Context()
    try:
        socket = context.socket(zmq.REQ)
        socket.setsockopt(zmq.LINGER, 0)
        socket.setsockopt(zmq.MAXMSGSIZE, LARGEST_REQUEST)
        if keys is not None:
            keys.apply(socket)
        socket.connect(where)
        yield ask
    except zmq.ZMQError as error:
        raise EndpointError(f"{where} cannot be used: {error.strerror}") from error
    finally:
        context.destroy(0)


def send_cloud(
    endpoint: str | PathLike[str] | Surface | npt.ArrayLike,
    cloud: str | PathLike[str] | Surface | npt.ArrayLike | None = None,
    predicted: npt.ArrayLike | None = None,
    predicted_flat: npt.ArrayLike | None = None,
    *,
    timeout_s: float = 10.0,
    keys: ClientKeys | None = None,
    skin: SkinDescription | None = None,
) -> int:
    """Send the sheet's shape to a running runtime and return the cloud's revision, which later frames carry.

    ``send_cloud(cloud)`` sends to the default control endpoint, ``send_cloud(endpoint, cloud)`` to another one::

        eitskin.send_cloud("CLOUD.npz")                                 # from 'eitskin surface POINTS --predict'
        eitskin.send_cloud("ipc:///tmp/control", cloud, predicted, predicted_flat)
        eitskin.send_cloud("CLOUD.npz", skin=description)               # for another skin than the paper's

    Args:
        endpoint: The runtime's *control* endpoint (``eitskin run --control``), not the one that publishes frames;
            without it, the default.
        cloud: (3, rows, columns) mm, in any pose; or a file of ``eitskin surface``, as a path or as returned by
            :func:`eitskin_proto.skin.cloud_file.load_surface`. A file includes its prediction and is sent in the frame
            of the measured points; touches then have their places in that frame.
        predicted: (104,) V that the forward model computes for this surface untouched; None without a prediction.
        predicted_flat: (104,) V that the same model computes for the flat sheet; None takes the captured reference,
            which is right only if model and device have the same current and gain.
        timeout_s: How long to wait for the answer.
        keys: CURVE keys, required for TCP.
        skin: The skin of this surface; None for the paper's.

    Raises:
        ValueError: The cloud or the voltages are malformed; with the value and the bound.
        CloudFileError: The file holds no cloud.
        MismatchError: The file holds a cloud of another skin.
        ControlError: The runtime refused, for example because the cloud does not fit its sheet, or did not answer.

    Warns:
        CloudWarning: The runtime uses the cloud, but something about it is doubtful.
    """
    where: str | None = None
    if cloud is None:
        if isinstance(endpoint, str) and endpoint.startswith(SCHEMES):
            raise ValueError(f"send_cloud got the endpoint {endpoint} but no cloud: send_cloud(endpoint, cloud)")
        cloud = endpoint
    elif isinstance(endpoint, str):
        where = endpoint
    else:
        raise ValueError(
            f"endpoint is a {type(endpoint).__name__}, expected the text of the runtime's control endpoint: "
            "send_cloud(endpoint, cloud, predicted, predicted_flat), or send_cloud(cloud) for the default one"
        )
    if isinstance(cloud, str | PathLike):
        cloud = load_surface(Path(cloud), PAPER if skin is None else skin)
    if isinstance(cloud, Surface):
        if predicted is None:
            predicted, predicted_flat = cloud.predicted_V, cloud.predicted_flat_V
        cloud = cloud.measured_mm
    points = check_cloud(cloud, (PAPER if skin is None else skin).grid)
    fields: dict[str, object] = {"cloud": points.astype("<f4").tobytes()}
    if skin is not None:
        fields |= {"grid_id": skin.grid_id, "skin_digest": skin.digest}
    for name, voltages in (("predicted", predicted), ("predicted_flat", predicted_flat)):
        if voltages is not None:
            fields[name] = np.asarray(check_voltages(name, voltages), dtype="<f8").tobytes()
    answer = request(where, "cloud", timeout_s=timeout_s, keys=keys, **fields)
    for line in answer.get("warnings", ()):
        warnings.warn(str(line), CloudWarning, stacklevel=2)
    return int(answer["cloud"])


def _why_silent(endpoint: str) -> str:
    """Advice if a runtime does not answer."""
    path = Path(endpoint.removeprefix("ipc://"))
    of_robot = (path.parent.parent / ROBOT).exists()
    command = "eitskin run --config ROBOT.toml" if of_robot else f"eitskin run --port PORT --control {endpoint}"
    start = other_runtimes(endpoint, CONTROL) or f"is the runtime running? Start it with: {command}"
    if endpoint.startswith("ipc://") and not path.exists():
        return f"there is no {path}; {start}"
    return f"is it the control endpoint that 'eitskin run' printed, not the one of frames? Else {start}"
