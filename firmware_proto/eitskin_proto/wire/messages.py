"""Every message of the wire as a frozen value that packs itself, and ``unpack``, which accepts nothing doubtful.

Requests carry a ``tag`` that their answer repeats, so that an answer that comes late or twice is recognised. ::

    host -> device                              device -> host
    HelloRequest                                Hello
    Start, Stop, SetMode                        Ack (code, detail); then Frame, Frame, ...
    TimeRequest                                 Time
    ConfigRead                                  ConfigData, or Ack with an error
    ConfigBegin .. Write .. Verify .. Commit    Ack each
    Restart, then ConfigConfirm                 Ack each, Event
    ConfigRollback, ConfigAbort                 Ack

Unknown types and versions are named in the error. The frame lives in :mod:`eitskin_proto.wire.frames`.
"""

from typing import Final

from eitskin_proto.errors import ProtocolError
from eitskin_proto.wire.answers import Ack, Event, Hello, Time
from eitskin_proto.wire.codes import PROTOCOL_MAJOR, PROTOCOL_MINOR, MessageType
from eitskin_proto.wire.configuring import (
    CHUNK_BYTES,
    ConfigAbort,
    ConfigBegin,
    ConfigCommit,
    ConfigConfirm,
    ConfigData,
    ConfigRead,
    ConfigRollback,
    ConfigVerify,
    ConfigWrite,
    Restart,
)
from eitskin_proto.wire.frames import Frame
from eitskin_proto.wire.layout import Packed
from eitskin_proto.wire.requests import HelloRequest, SetMode, Start, Stop, TimeRequest

__all__ = [
    "CHUNK_BYTES",
    "PLAIN",
    "Ack",
    "ConfigAbort",
    "ConfigBegin",
    "ConfigCommit",
    "ConfigConfirm",
    "ConfigData",
    "ConfigRead",
    "ConfigRollback",
    "ConfigVerify",
    "ConfigWrite",
    "Event",
    "Frame",
    "Hello",
    "HelloRequest",
    "Message",
    "Request",
    "Restart",
    "SetMode",
    "Start",
    "Stop",
    "Time",
    "TimeRequest",
    "unpack",
]

Request = (
    HelloRequest | Start | Stop | SetMode | TimeRequest | ConfigRead | ConfigBegin | ConfigWrite | ConfigVerify
    | ConfigCommit | ConfigConfirm | ConfigRollback | ConfigAbort | Restart
)  # fmt: skip
"""What a host sends."""

Message = Request | Hello | Ack | Frame | ConfigData | Event | Time
"""Anything on the wire."""

PLAIN: Final[tuple[type[Packed], ...]] = (
    HelloRequest, Start, Stop, SetMode, TimeRequest, ConfigRead, ConfigBegin, ConfigWrite, ConfigVerify, ConfigCommit,
    ConfigConfirm, ConfigRollback, ConfigAbort, Restart, Hello, Ack, ConfigData, Event, Time,
)  # fmt: skip
"""Every message that a layout describes, in the order of the types; the frame is the only other one."""

_BY_TYPE: Final = {int(kind.LAYOUT.type): kind for kind in PLAIN}


def unpack(payload: bytes) -> Message:
    """Return the message of an intact payload.

    Raises:
        ProtocolError: The type is unknown, or the payload is not exactly that message.
    """
    if not payload:
        raise ProtocolError("an empty payload is no message; expected a type byte")
    if payload[0] == MessageType.FRAME:
        return Frame.unpack(payload)
    kind = _BY_TYPE.get(payload[0])
    if kind is None:
        raise ProtocolError(
            f"message type 0x{payload[0]:02x} is unknown to protocol {PROTOCOL_MAJOR}.{PROTOCOL_MINOR}; "
            "the other side is newer, or it is not an eitskin device"
        )
    return kind.unpack(payload)  # type: ignore[return-value]
