"""Requests and answers over a line that may lose either: each request is repeated until its tag comes back.

An answer with another tag is one that came late or twice, and is dropped. Every request of the protocol may be asked
twice without harm (SPEC.md, section 6), so that a lost answer costs time and nothing else.
"""

import time
from typing import Any, Final

from eitskin.acquisition.transport import Transport
from eitskin.errors import HandshakeError
from eitskin_proto.errors import ProtocolError
from eitskin_proto.wire import framing, messages
from eitskin_proto.wire.codes import Code, MessageType
from eitskin_proto.wire.config import BLOB_BYTES

ANSWER_TIMEOUT_S: Final = 0.6
"""A device answers within 0.5 s (SPEC.md, section 3)."""

KNOWN_TYPES: Final = frozenset(int(kind) for kind in MessageType)
"""Newer firmware may send others."""

ATTEMPTS: Final = 4
"""How often a request is sent before the device counts as silent."""


class Refused(HandshakeError):  # noqa: N818 - a refusal is called one
    """The device refused a request.

    Args:
        ack: Its answer.
        request: What was asked.
    """

    def __init__(self, ack: messages.Ack, request: str) -> None:
        detail = f" (detail {ack.detail})" if ack.detail else ""
        super().__init__(f"the device refused {request}: {ack.text}{detail}")
        self.ack = ack


class Silent(HandshakeError):  # noqa: N818 - as above
    """The device did not answer."""


class Exchange:
    """Asks one request at a time.

    Args:
        transport: An open line; the caller closes it.
        timeout_s: How long one attempt waits.
        attempts: How often a request is sent.
    """

    def __init__(self, transport: Transport, timeout_s: float = ANSWER_TIMEOUT_S, attempts: int = ATTEMPTS) -> None:
        self.transport = transport
        self._timeout_s = timeout_s
        self._attempts = attempts
        self._tag = 0
        self._deframer = framing.Deframer()

    def replace(self, transport: Transport) -> None:
        """Go on over another line, after the old one vanished."""
        self.transport = transport
        self._deframer.reset()

    def hello(self, attempts: int | None = None) -> messages.Hello:
        """Return the device's HELLO, with its protocol and grid checked.

        Raises:
            Silent: No answer.
            MismatchError: It measures something else.
        """
        answer = self._request(lambda tag: messages.HelloRequest(tag=tag), "HELLO_REQUEST", attempts)
        if not isinstance(answer, messages.Hello):
            raise ProtocolError(f"the device answered HELLO_REQUEST with {type(answer).__name__}, expected Hello")
        answer.check()
        return answer

    def command(self, kind: type[messages.Request], **fields: Any) -> messages.Ack:
        """Return the ACK of a request.

        Args:
            kind: Its class in :mod:`eitskin_proto.wire.messages`.
            **fields: Its fields without the tag.

        Raises:
            Refused: The ACK carries an error.
            Silent: No answer.
        """
        answer = self._request(lambda tag: kind(tag=tag, **fields), kind.LAYOUT.type.name)
        if not isinstance(answer, messages.Ack):
            raise ProtocolError(f"the device answered {kind.LAYOUT.type.name} with {type(answer).__name__}")
        return answer

    def read(self, slot: int, offset: int, length: int) -> messages.ConfigData:
        """Return a piece of a stored configuration: all of it that was asked for, or it is an error.

        Raises:
            Refused: There is none in this slot.
            Silent: No answer.
            ProtocolError: The answer is not of this piece.
        """
        answer = self._request(
            lambda tag: messages.ConfigRead(tag=tag, slot=slot, offset=offset, length=length), "CONFIG_READ"
        )
        if not isinstance(answer, messages.ConfigData):
            raise ProtocolError(f"the device answered CONFIG_READ with {type(answer).__name__}, expected ConfigData")
        for what, found, expected in (
            ("slot", answer.slot, slot), ("offset", answer.offset, offset), ("total", answer.total, BLOB_BYTES),
            ("so many bytes:", len(answer.data), length),
        ):  # fmt: skip
            if found != expected:
                raise ProtocolError(
                    f"the device answered CONFIG_READ with {what} {found}, expected {expected}: its firmware violates "
                    "the protocol"
                )
        return answer

    def _request(self, make: Any, name: str, attempts: int | None = None) -> messages.Message:
        self._tag = self._tag % 255 + 1
        packet = framing.encode(make(self._tag).pack())
        tried = self._attempts if attempts is None else attempts
        for _ in range(tried):
            self.transport.write(b"\0" + packet)
            answer = self._answer(self._tag, time.perf_counter() + self._timeout_s)
            if answer is None:
                continue
            if isinstance(answer, messages.Ack):
                if answer.request != MessageType[name]:
                    raise ProtocolError(
                        f"the device answered {name} with an ACK of request 0x{answer.request:02x}, expected "
                        f"0x{MessageType[name]:02x}"
                    )
                if answer.code != Code.OK:
                    raise Refused(answer, name)
            return answer
        raise Silent(
            f"{self.transport.name} did not answer {name} in {tried} attempts: is it an eitskin device, is it "
            "switched on, and does another program use it?"
        )

    def _answer(self, tag: int, deadline_s: float) -> messages.Message | None:
        """Return the answer with this tag; None when the time is up."""
        while (left_s := deadline_s - time.perf_counter()) > 0:
            data = self.transport.read(left_s)
            if not data:
                return None
            found = None
            for payload in self._deframer.feed(data):
                if payload[0] not in KNOWN_TYPES:
                    continue  # newer firmware may say more than this host understands (SPEC.md, section 2)
                message = messages.unpack(payload)
                if getattr(message, "tag", None) == tag:
                    found = message
            if found is not None:
                return found
        return None
