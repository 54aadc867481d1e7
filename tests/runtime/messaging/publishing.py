"""How tests publish a frame, wait until somebody takes them, and subscribe without libzmq."""

import socket
import time
from contextlib import suppress

from eitskin.messaging.frame import EVERY_FRAME


def send(publisher, packer, number, age_us=100):
    packer.put("n", number)
    packer.put("seq", number)
    packer.put("age_us", age_us)
    packer.put("publish", time.perf_counter_ns())
    publisher.update()
    publisher.send(packer.message())


def wait_until_wanted(publisher):
    """Wait for one more subscriber to every frame."""
    wait_for(publisher, lambda: publisher.joined and EVERY_FRAME in publisher.topics)
    publisher.joined = False


def wait_for(publisher, condition):
    """Wait until a condition holds, while the publisher looks who subscribes."""
    end = time.perf_counter() + 60
    while not condition() and time.perf_counter() < end:
        publisher.update()
        time.sleep(0.002)
    assert condition()


class Peer:
    """A subscriber of bare sockets: it says what libzmq's own clients never say, and the kernel keeps what came."""

    def __init__(self, publisher):
        self.stream = socket.socket(socket.AF_UNIX)
        self.stream.connect(publisher.endpoint.removeprefix("ipc://"))
        self.stream.sendall(b"\xff" + bytes(8) + b"\x7f\x03\x00NULL" + bytes(48))
        self.stream.sendall(b"\x04\x19\x05READY\x0bSocket-Type\x00\x00\x00\x03SUB")
        self.stream.setblocking(False)
        self.received = b""
        wait_for(publisher, self._greeted)  # until the other side is ready, libzmq takes no message
        self.received = b""

    def _greeted(self):
        self.take()
        return len(self.received) > 66 and len(self.received) >= 66 + self.received[65]

    def take(self):
        """Read what came, and return how many bytes that is in all."""
        with suppress(BlockingIOError):
            while came := self.stream.recv(1 << 16):
                self.received += came
        return len(self.received)

    def send(self, *bodies):
        self.stream.sendall(b"".join(bytes([0, len(body)]) + body for body in bodies))

    def subscribe(self, *topics):
        self.send(*(b"\x01" + topic for topic in topics))

    def close(self):
        self.stream.close()
