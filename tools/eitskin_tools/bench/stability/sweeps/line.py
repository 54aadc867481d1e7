"""A line whose device does exactly what a script says: it shakes hands, starts, sends given payloads, and vanishes.

Payloads are framed as on the wire, so what passes is what a broken or hostile front end behind an intact firmware could
send. At the script's end the port is lost, which ends the runtime's loop.
"""

from collections.abc import Iterable
from dataclasses import replace

from eitskin.errors import PortLost
from eitskin_proto.wire import messages
from eitskin_proto.wire.codes import Code, MessageType
from eitskin_proto.wire.framing import Deframer, encode
from eitskin_proto.wire.messages import Ack, Hello


class ScriptedLine:
    """A transport in this process.

    Args:
        hello: What the device answers.
        payloads: What it sends after START, a packet each; bytes that are framed already go in ``raw``.
        raw: Bytes sent as they are before the payloads.
    """

    name = "scripted"
    line_bytes_per_s = 0

    def __init__(self, hello: Hello, payloads: Iterable[bytes], raw: bytes = b"") -> None:
        self._hello = hello
        self._script = [raw] if raw else []
        self._script += [encode(payload) for payload in payloads]
        self._script.reverse()
        self._answers: list[bytes] = []
        self._deframer = Deframer()
        self._started = False

    def read(self, timeout_s: float | None = None) -> bytes:
        """Return the next answer, or the next packet of the script; nothing to those who do not wait.

        Raises:
            PortLost: There is none left.
        """
        if self._answers:
            return self._answers.pop(0)
        if timeout_s is not None and timeout_s <= 0.0:
            return b""  # frames come one at a time: none waits behind another
        if self._started and self._script:
            return self._script.pop()
        raise PortLost(f"{self.name}: the script has ended")

    def write(self, data: bytes) -> None:
        """Answer requests."""
        for payload in self._deframer.feed(data):
            kind, tag = payload[0], payload[1]
            if kind == MessageType.HELLO_REQUEST:
                self._answers.append(encode(replace(self._hello, tag=tag).pack()))
            elif kind == MessageType.TIME_REQUEST:
                self._answers.append(encode(messages.Time(0, tag).pack()))
            else:
                self._started = self._started or isinstance(messages.unpack(payload), messages.Start)
                self._answers.append(encode(Ack(kind, Code.OK, 0, tag).pack()))

    def cancel(self) -> None:
        """Do nothing: nobody waits here."""

    def report(self) -> list[str]:
        """Return nothing to report."""
        return []

    def close(self) -> None:
        """Do nothing: there is nothing to give back."""
