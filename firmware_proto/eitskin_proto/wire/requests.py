"""What a host sends to a device that it reads. Every request carries a ``tag`` that its answer repeats.

Those about the stored configuration are in :mod:`eitskin_proto.wire.configuring`, which a runtime does not load.
"""

from dataclasses import dataclass
from typing import ClassVar

from eitskin_proto.wire.codes import PROTOCOL_MAJOR, PROTOCOL_MINOR, MessageType, Mode
from eitskin_proto.wire.layout import Layout, Packed


@dataclass(frozen=True, slots=True)
class HelloRequest(Packed):
    """Asks who is there; the first thing that a host sends."""

    LAYOUT: ClassVar = Layout(
        MessageType.HELLO_REQUEST,
        (("tag", "u8"), ("magic", "magic"), ("protocol_major", "u8"), ("protocol_minor", "u8")),
    )
    tag: int = 0
    protocol_major: int = PROTOCOL_MAJOR
    protocol_minor: int = PROTOCOL_MINOR


@dataclass(frozen=True, slots=True)
class Start(Packed):
    """Starts streaming."""

    LAYOUT: ClassVar = Layout(MessageType.START, (("tag", "u8"), ("frames", "u32")))
    tag: int = 0
    frames: int = 0
    """How many frames to send; 0 for as many as there are until STOP."""


@dataclass(frozen=True, slots=True)
class Stop(Packed):
    """Stops streaming; the sequence number keeps its value."""

    LAYOUT: ClassVar = Layout(MessageType.STOP, (("tag", "u8"),))
    tag: int = 0


@dataclass(frozen=True, slots=True)
class SetMode(Packed):
    """Switches between the whole scan and the idle subset, at once and without touching the stored configuration."""

    LAYOUT: ClassVar = Layout(MessageType.SET_MODE, (("tag", "u8"), ("mode", "u8")))
    tag: int = 0
    mode: int = Mode.ACTIVE


@dataclass(frozen=True, slots=True)
class TimeRequest(Packed):
    """Asks for the device's clock; the round trip bounds the offset between the clocks."""

    LAYOUT: ClassVar = Layout(MessageType.TIME_REQUEST, (("tag", "u8"),))
    tag: int = 0
