"""Requests about the stored configuration and the restart that makes it run, and the one answer of their own."""

from dataclasses import dataclass
from typing import ClassVar, Final

from eitskin_proto.wire.codes import MessageType, Slot
from eitskin_proto.wire.layout import Layout, Packed

CHUNK_BYTES: Final = 32
"""Most configuration bytes in one CONFIG_WRITE or CONFIG_DATA."""


@dataclass(frozen=True, slots=True)
class ConfigRead(Packed):
    """Asks for a piece of a stored configuration."""

    LAYOUT: ClassVar = Layout(
        MessageType.CONFIG_READ, (("tag", "u8"), ("slot", "u8"), ("offset", "u16"), ("length", "u8"))
    )
    tag: int = 0
    slot: int = Slot.ACTIVE
    offset: int = 0
    length: int = CHUNK_BYTES


@dataclass(frozen=True, slots=True)
class ConfigBegin(Packed):
    """Takes the lock with a token, says what will come, and erases the inactive slot."""

    LAYOUT: ClassVar = Layout(
        MessageType.CONFIG_BEGIN,
        (
            ("tag", "u8"), ("token", "u32"), ("size", "u16"), ("digest", "u32"), ("hardware_id", "u32"),
            ("revision", "u32"), ("format", "u8"), ("allow_downgrade", "u8"), ("name", "text16"),
        ),
    )  # fmt: skip
    token: int
    size: int
    digest: int
    hardware_id: int
    revision: int
    name: str
    format: int
    allow_downgrade: int = 0
    tag: int = 0


@dataclass(frozen=True, slots=True)
class ConfigWrite(Packed):
    """Writes the next piece into the inactive slot."""

    LAYOUT: ClassVar = Layout(
        MessageType.CONFIG_WRITE, (("tag", "u8"), ("token", "u32"), ("offset", "u16"), ("data", "tail")), CHUNK_BYTES
    )
    token: int
    offset: int
    data: bytes
    tag: int = 0


@dataclass(frozen=True, slots=True)
class ConfigVerify(Packed):
    """Asks the device to read the inactive slot back; the answer's detail is the digest found there."""

    LAYOUT: ClassVar = Layout(MessageType.CONFIG_VERIFY, (("tag", "u8"), ("token", "u32")))
    token: int
    tag: int = 0


@dataclass(frozen=True, slots=True)
class ConfigCommit(Packed):
    """Makes the inactive slot the one to try at the next boot; the answer's detail is its generation."""

    LAYOUT: ClassVar = Layout(MessageType.CONFIG_COMMIT, (("tag", "u8"), ("token", "u32"), ("digest", "u32")))
    token: int
    digest: int
    tag: int = 0


@dataclass(frozen=True, slots=True)
class ConfigConfirm(Packed):
    """Ends the trial of the running configuration; without it the next boot rolls back."""

    LAYOUT: ClassVar = Layout(MessageType.CONFIG_CONFIRM, (("tag", "u8"), ("generation", "u32"), ("digest", "u32")))
    generation: int
    digest: int
    tag: int = 0


@dataclass(frozen=True, slots=True)
class ConfigRollback(Packed):
    """Revokes the given generation, so that the next boot runs the other slot."""

    LAYOUT: ClassVar = Layout(MessageType.CONFIG_ROLLBACK, (("tag", "u8"), ("token", "u32"), ("generation", "u32")))
    token: int
    generation: int
    tag: int = 0


@dataclass(frozen=True, slots=True)
class ConfigAbort(Packed):
    """Gives the lock back without committing."""

    LAYOUT: ClassVar = Layout(MessageType.CONFIG_ABORT, (("tag", "u8"), ("token", "u32")))
    token: int
    tag: int = 0


@dataclass(frozen=True, slots=True)
class Restart(Packed):
    """Boots the device again, after the answer has left."""

    LAYOUT: ClassVar = Layout(MessageType.RESTART, (("tag", "u8"), ("token", "u32")))
    token: int = 0
    tag: int = 0


@dataclass(frozen=True, slots=True)
class ConfigData(Packed):
    """A piece of a stored configuration."""

    LAYOUT: ClassVar = Layout(
        MessageType.CONFIG_DATA,
        (("tag", "u8"), ("slot", "u8"), ("generation", "u32"), ("offset", "u16"), ("total", "u16"), ("data", "tail")),
        CHUNK_BYTES,
    )
    slot: int
    generation: int
    offset: int
    total: int
    data: bytes
    tag: int = 0
