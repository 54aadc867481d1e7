"""The numbers that name things on the wire: message types, flags, answer codes, events.

C gets the same numbers as a generated header, so that no list is kept twice. A number is never reused: a name that goes
away leaves its number reserved. Host to device types are below 0x80, device to host types from 0x80 on.
"""

from enum import IntEnum, IntFlag
from typing import Final

MAGIC: Final = b"EITS"
"""Opens the two messages of the handshake."""

PROTOCOL_MAJOR: Final = 1
"""Changes when an old host and a new device must refuse each other."""

PROTOCOL_MINOR: Final = 0
"""Changes when something was added that the other side may ignore."""


class MessageType(IntEnum):
    """First byte of every payload."""

    HELLO_REQUEST = 0x01
    START = 0x02
    STOP = 0x03
    SET_MODE = 0x04
    TIME_REQUEST = 0x05
    CONFIG_READ = 0x10
    CONFIG_BEGIN = 0x11
    CONFIG_WRITE = 0x12
    CONFIG_VERIFY = 0x13
    CONFIG_COMMIT = 0x14
    CONFIG_CONFIRM = 0x15
    CONFIG_ROLLBACK = 0x16
    CONFIG_ABORT = 0x17
    RESTART = 0x18
    HELLO = 0x80
    ACK = 0x81
    FRAME = 0x82
    CONFIG_DATA = 0x83
    EVENT = 0x84
    TIME = 0x85


class Code(IntEnum):
    """The result of a request in an ACK. 0 is success; ``CODE_TEXT`` says what to do about the others."""

    OK = 0
    UNKNOWN_TYPE = 1
    BAD_LENGTH = 2
    BAD_VALUE = 3
    BAD_VERSION = 4
    BUSY = 5
    NO_SESSION = 6
    WRONG_HARDWARE = 7
    DOWNGRADE = 8
    BAD_FORMAT = 9
    TOO_LARGE = 10
    BAD_OFFSET = 11
    INCOMPLETE = 12
    DIGEST_MISMATCH = 13
    INVALID_CONFIGURATION = 14
    STORAGE_FAILED = 15
    NO_PREVIOUS = 16
    NOT_CONFIRMED = 17
    WRONG_GENERATION = 18
    STREAMING = 19
    FRONT_END_FAILED = 20
    RATE_TOO_HIGH = 21


CODE_TEXT: Final[dict[Code, str]] = {
    Code.OK: "done",
    Code.UNKNOWN_TYPE: "the device does not know this message; its firmware is older than this host",
    Code.BAD_LENGTH: "the message has the wrong length for its type",
    Code.BAD_VALUE: "a field of the message is outside its range",
    Code.BAD_VERSION: "the device speaks another major version of the protocol",
    Code.BUSY: "another session holds the configuration; wait until it ends, its lock expires after 10 s of silence",
    Code.NO_SESSION: "no session with this token is open; begin one first",
    Code.WRONG_HARDWARE: "the configuration was made for other hardware",
    Code.DOWNGRADE: "the active configuration of this name has a higher revision; allow the downgrade to write it",
    Code.BAD_FORMAT: "the device does not know this format of configuration",
    Code.TOO_LARGE: "the configuration is larger than the device's slot",
    Code.BAD_OFFSET: "the chunk does not continue where the last one ended",
    Code.INCOMPLETE: "not every byte of the configuration was written",
    Code.DIGEST_MISMATCH: "the device stored other bytes than were sent",
    Code.INVALID_CONFIGURATION: "the configuration's check or one of its values is wrong",
    Code.STORAGE_FAILED: "the device's storage did not take the write",
    Code.NO_PREVIOUS: "there is no earlier configuration to roll back to",
    Code.NOT_CONFIRMED: "what runs is on trial or was rolled back; confirm it, or restart the device, first",
    Code.WRONG_GENERATION: "another generation of configuration is active",
    Code.STREAMING: "the device is streaming; stop it first",
    Code.FRONT_END_FAILED: "the analogue front end did not answer",
    Code.RATE_TOO_HIGH: "the front end or the line cannot reach this rate",
}
"""A line for people for every answer."""


class FrameFlag(IntFlag):
    """Bits of a frame's flags; unknown bits are ignored."""

    FULL = 1
    """Rows come from the full table of 208."""
    IDLE = 2
    """Scanned in the idle mode."""
    FIRST = 4
    """First frame after START."""
    TRIAL = 8
    """The configuration is not confirmed yet."""


class HelloFlag(IntFlag):
    """Bits of HELLO's flags; unknown bits are ignored."""

    FULL = 1
    """The active configuration scans the full table of 208."""
    TRIAL = 2
    """The active configuration is not confirmed yet."""
    FACTORY = 4
    """No stored configuration is usable: the one built into the firmware runs."""
    ROLLED_BACK = 8
    """This boot gave up an unconfirmed configuration."""
    STREAMING = 16
    """Frames are being sent."""
    IDLE = 32
    """The idle mode is on."""


class Mode(IntEnum):
    """The modes of SET_MODE."""

    ACTIVE = 0
    IDLE = 1


class Slot(IntEnum):
    """Which stored configuration CONFIG_READ reads."""

    ACTIVE = 0
    OTHER = 1


class EventCode(IntEnum):
    """The codes of an EVENT."""

    RESTARTING = 1
    CONFIGURATION_CHANGED = 2
    ROLLED_BACK = 3
    OVERRUN = 4
    FRONT_END_FAILED = 5
