"""The least that a frame costs on this machine: pseudo-terminal, ZeroMQ and the scheduler, in the same run.

::

    this process --pty-->  relay  --ipc-->  listener
                  340 B            5.6 kB

The relay reads as the runtime reads and publishes as it publishes, but its message is ready made: it copies the frame's
number into it. So this is the minimum of any program of this structure on this machine at this time. The rest of the
runtime's time is decoding, normalising, gate, inference and packing.
"""

import argparse
import struct
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.table import N_ROWS
from eitskin_proto.wire.frames import frame_bytes
from eitskin_proto.wire.framing import wire_bytes
from eitskin_tools.processes.children import Child, process_group

PACKET_BYTES: Final = wire_bytes(frame_bytes(N_ROWS, 3))
"""A frame of 104 rows on the wire, 24 bit a sample."""

MESSAGE_BYTES: Final = 5632
"""A frame with its map, as it is published."""

NUMBER: Final = struct.Struct("<Q")
"""How packets and messages begin here; the rest is filling."""

END: Final = (1 << 64) - 1
"""The number that ends relay and listener."""

READY_S: Final = 30.0


def floor_ns(rate_hz: float, frames: int) -> npt.NDArray[np.int64]:
    """Return (n,) the time from before the write to the line to after the subscriber's receive, of each that came.

    Args:
        rate_hz: Packets a second.
        frames: How many are sent.

    Raises:
        SkinError: A process died, with what it said last.
        TimeoutError: A process was not ready in time.
    """
    from eitskin_tools.virtual_skin.pty import PtyPort

    sent_ns = np.zeros(frames, dtype=np.int64)
    module = "eitskin_tools.bench.line_floor"
    with tempfile.TemporaryDirectory(prefix="eitskin-floor-") as name, process_group() as children, PtyPort() as port:
        folder = Path(name)
        endpoint, result = f"ipc://{folder}/frames", folder / "received.npy"
        relay = Child("relay", module, ["relay", endpoint, str(port.path)], folder)
        children.append(relay)
        relay.line(relay.out, "ready", READY_S)
        listener = Child("listener", module, ["listener", endpoint, str(result), f"--frames={frames}"], folder)
        children.append(listener)
        relay.line(relay.out, "wanted", READY_S, children)
        filling = b"\1" * (PACKET_BYTES - NUMBER.size)
        start = time.perf_counter()
        for number in range(frames):
            time.sleep(max(start + (number + 1) / rate_hz - time.perf_counter(), 0.0))
            packet = NUMBER.pack(number) + filling
            sent_ns[number] = time.perf_counter_ns()
            port.write(packet)
        _end(port.write, listener)
        received_ns = np.load(result)
    came = received_ns > 0
    return np.asarray(received_ns[came] - sent_ns[came])


def _end(write: Callable[[bytes], bool], listener: Child) -> None:
    """Send the end until the listener has gone: a full line takes no packet."""
    packet = NUMBER.pack(END) + b"\1" * (PACKET_BYTES - NUMBER.size)
    until = time.monotonic() + READY_S
    while listener.wait(0.1) is None and time.monotonic() < until:
        write(packet)
    if listener.status != 0:
        listener.check()
        raise TimeoutError("the listener did not end")


def relay(endpoint: str, path: str) -> None:
    """Publish the number of every packet that the line brings, until the end comes."""
    from eitskin.acquisition.serial_port import SerialPort
    from eitskin.messaging.publish import Publisher

    message = bytearray(MESSAGE_BYTES)
    view, line, publisher = memoryview(message), SerialPort(path), Publisher(endpoint)
    try:
        print("ready", flush=True)
        while not publisher.wanted:
            time.sleep(0.01)
            publisher.update()
        print("wanted", flush=True)
        pending = b""
        while True:
            pending += line.read()
            while len(pending) >= PACKET_BYTES:
                message[: NUMBER.size] = pending[: NUMBER.size]
                publisher.send(view)
                pending = pending[PACKET_BYTES:]
    finally:
        publisher.close()
        line.close()


def listener(endpoint: str, path: Path, frames: int) -> None:
    """Note when each number came, and save the times; 0 for those that did not come."""
    import gc

    import zmq

    received_ns = np.zeros(frames, dtype=np.int64)
    gc.disable()
    with zmq.Context() as context, context.socket(zmq.SUB) as socket:
        socket.setsockopt(zmq.LINGER, 0)
        socket.connect(endpoint)
        socket.setsockopt(zmq.SUBSCRIBE, b"")
        while True:
            (number,) = NUMBER.unpack_from(socket.recv())
            now_ns = time.perf_counter_ns()
            if number == END:
                break
            received_ns[number] = now_ns
    np.save(path, received_ns)


def main() -> int:
    """Run one of the two processes."""
    parser = argparse.ArgumentParser(description="Relay packets, or listen to them.")
    parser.add_argument("role", choices=["relay", "listener"])
    parser.add_argument("endpoint")
    parser.add_argument("path")
    parser.add_argument("--frames", type=int, default=0)
    arguments = parser.parse_args()
    if arguments.role == "relay":
        relay(arguments.endpoint, arguments.path)
    else:
        listener(arguments.endpoint, Path(arguments.path), arguments.frames)
    return 0


if __name__ == "__main__":
    sys.exit(main())
