"""A runtime's stream and control, by pyzmq and msgpack alone, as firmware_proto/SPEC.md defines them (sections 7, 8).

It needs neither ROS nor eitskin, and runs on Python 3.10.
"""

import os
import struct
import time
from array import array
from pathlib import Path
from typing import Any, NamedTuple

import msgpack
import zmq
import zmq.auth

MAPS, TOUCHES, CLOUDS = b"\xde\x00", b"\xdf", b"\x86\xa5cloud"
"""How messages begin: to subscribe to, and to tell them apart."""

VERSIONS = {0xDE: 1, 0xDF: 2}
"""Of a frame with its map, and of one with its touches alone, by the first byte."""

TOUCH = struct.Struct("<II24f")
NAMES = (
    "id", "parent", "age_s", "centre_x", "centre_y", "major", "minor", "angle", "area", "peak", "strength",
    "confidence", "x", "y", "z", "nx", "ny", "nz", "surface", "error_x", "error_y", "amplitude", "log_likelihood_ratio",
    "sign", "velocity_x", "velocity_y",
)  # fmt: skip
"""Of a touch's fields: lengths in mm, x to nz on the bent surface."""

UNKNOWN = struct.pack("<7f", *[float("nan")] * 7)
"""The last fields, which old runtimes do not send."""


class StreamError(Exception):
    """An endpoint, a key, a message or a request cannot be used; the text says why."""


class Frame(NamedTuple):
    """A frame with its touches, or with its map of float32, row by row; ``fields`` has the rest of its message."""

    fields: dict[str, Any]
    touches: list[dict[str, float]]
    map: array
    same_host: bool
    received_ns: int

    @property
    def age_s(self) -> float:
        """Seconds since the end of the scan; from another machine without the time on the network."""
        since_ns = self.fields["host_ns"]["publish"] if self.same_host else self.received_ns
        return 1e-6 * self.fields["age_us"] + 1e-9 * max(time.monotonic_ns() - since_ns, 0)


class Cloud(NamedTuple):
    """Where the pixels are: x, y, z in m and a 0 of each, row by row."""

    points: array


def decode_frame(message: bytes, host: str = "", received_ns: int = 0) -> Frame:
    """Return the frame of a message; ``host`` is this machine's boot id.

    Raises:
        StreamError: It is no frame, or one of another version.
    """
    try:
        fields, expected = msgpack.unpackb(message), VERSIONS[message[0]]
        if fields["v"] != expected:
            raise StreamError(f"frames of version {fields['v']}; this package reads {expected}: update it")
        rows, columns = fields["shape"] if expected == 1 else (0, 0)
        values, raw, size = (
            array("f", fields.get("map", b"")),
            fields.get("touches", b""),
            fields.get("touch_bytes", 92),
        )
        counts = [fields[name] for name in ("n", "seq", "age_us", "cloud")]
        counts += [fields["host_ns"][name] for name in ("read", "publish")] + list(fields["counts"].values())
        texts = [fields[name] for name in ("run", "serial", "host")] + fields["events"] + fields.get("electrodes", [])
        fit = len(values) == rows * columns and size >= 76 and len(raw) % size == 0 and len(raw) <= 16 * size
        if (
            not fit
            or {*map(type, counts)} != {int}
            or {*map(type, texts)} != {str}
            or type(fields["touched"]) is not bool
        ):
            raise ValueError("a field of another kind")
        touches = [_touch(raw[at : at + size]) for at in range(0, len(raw), size)]
    except StreamError:
        raise
    except Exception as error:  # whatever Python makes of bytes of any origin
        raise StreamError(f"a message that is no frame ({type(error).__name__}: {error})") from error
    return Frame(fields, touches, values, fields["host"] == host, received_ns)


def _touch(raw: bytes) -> dict[str, float]:
    whole = raw + UNKNOWN[len(raw) - 76 :]  # what an old runtime does not send
    return dict(zip(NAMES, TOUCH.unpack_from(whole), strict=True))


def default_endpoint(name: str) -> str:
    """Return the endpoint ``frames`` or ``control`` of ``eitskin run`` without options."""
    session = os.environ.get("XDG_RUNTIME_DIR", "")
    return f"ipc://{session}/eitskin/{name}" if os.path.isdir(session) else f"ipc:///tmp/eitskin-{os.getuid()}/{name}"


def connect(context: zmq.Context, kind: int, endpoint: str, keys: tuple[str, str]) -> zmq.Socket:
    """Return a connected socket; ``keys`` name the files server.key and client.key_secret, which TCP needs.

    Raises:
        StreamError: The endpoint is none, or a key is missing.
    """
    socket = context.socket(kind)
    socket.linger = 0
    try:
        if endpoint.startswith("tcp://"):
            server, client = keys
            socket.curve_serverkey = zmq.auth.load_certificate(server)[0]
            socket.curve_publickey, socket.curve_secretkey = zmq.auth.load_certificate(client)
        socket.connect(endpoint)
    except (zmq.ZMQError, OSError, ValueError, TypeError) as error:
        socket.close()
        raise StreamError(
            f"{endpoint!r} cannot be connected to: {error}; expected ipc:///path, or tcp://address:port with the "
            f"parameters server_key and client_key, found {keys}"
        ) from error
    return socket


def request(endpoint: str, keys: tuple[str, str], timeout_s: float, command: str, **fields: Any) -> dict[str, Any]:
    """Send a control request (SPEC.md, section 8), and return the answer.

    Raises:
        StreamError: The runtime refused, or did not answer in time.
    """
    with zmq.Context() as context, connect(context, zmq.REQ, endpoint, keys) as socket:
        socket.send(msgpack.packb({"command": command, **fields}))
        if not socket.poll(round(1000 * timeout_s)):
            raise StreamError(f"no answer from {endpoint} within {timeout_s:g} s: is `eitskin run` running there?")
        answer = msgpack.unpackb(socket.recv())
    if not answer.get("ok"):
        raise StreamError(str(answer.get("error", "refused without a reason")))
    return answer


class Stream:
    """Every frame of a runtime, in order; arguments as of :func:`connect`. One thread uses it."""

    def __init__(self, endpoint: str, keys: tuple[str, str] = ("", "")) -> None:
        host = Path("/proc/sys/kernel/random/boot_id")
        self._host = host.read_text().strip() if host.exists() else "unknown"
        self.endpoint, self.lost = endpoint, 0
        self.wrong = ""  # why the last message could not be read
        self._context = zmq.Context()
        self._topics: set[bytes] = set()
        self._parts, self._last, self._heard_s = b"", ("", 0), time.monotonic()
        self._socket = connect(self._context, zmq.SUB, endpoint, keys)
        self.want({TOUCHES})

    def want(self, topics: set[bytes]) -> None:
        """Subscribe to these topics and to no others."""
        for topic in topics ^ self._topics:
            self._socket.set(zmq.SUBSCRIBE if topic in topics else zmq.UNSUBSCRIBE, topic)
        self._topics = topics

    def next(self, timeout_s: float) -> Frame | Cloud | None:
        """Return what comes next; None if nothing does in time, or it cannot be read."""
        if not self._socket.poll(round(1000 * timeout_s)):
            if time.monotonic() - self._heard_s > 2.0:  # libzmq gives up an address where another program answered
                self._socket.disconnect(self.endpoint)
                self._socket.connect(self.endpoint)
                self._heard_s = time.monotonic()
            return None
        message, self._heard_s, self.wrong = self._socket.recv(), time.monotonic(), ""
        try:
            if message.startswith(CLOUDS):
                return self._cloud(msgpack.unpackb(message))
            frame = decode_frame(message, self._host, time.monotonic_ns())
        except (StreamError, ValueError, LookupError, TypeError) as error:
            self.wrong = str(error)
            return None
        if message.startswith(TOUCHES):
            run, number = frame.fields["run"], frame.fields["n"]
            self.lost += max(number - self._last[1] - 1, 0) if run == self._last[0] else 0
            self._last = run, number
        return frame

    def _cloud(self, head: dict[str, Any]) -> Cloud | None:
        self._parts = (self._parts if head["part"] else b"") + head["body"]
        if head["part"] + 1 < head["parts"]:
            return None
        body = msgpack.unpackb(self._parts)
        xyz_mm = array("f", body["cloud"])
        count = len(xyz_mm) // 3
        points = array("f", bytes(16 * count))
        for axis in range(3):
            points[axis::4] = array("f", [1e-3 * value for value in xyz_mm[axis * count :][:count]])
        return Cloud(points)

    def close(self) -> None:
        """Leave the runtime."""
        self._socket.close()
        self._context.term()
