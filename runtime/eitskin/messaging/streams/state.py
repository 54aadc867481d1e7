"""The device, the runtime and their status, sent on changes and once a second."""

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Self

import msgpack  # type: ignore[import-untyped]

from eitskin.messaging.streams.envelope import STATE
from eitskin.messaging.streams.measured import MAX_TEXT, Received
from eitskin.messaging.unpacking import fields_of, require
from eitskin_proto.errors import ProtocolError
from eitskin_proto.fields import Fields
from eitskin_proto.wire.volts import LARGEST_VOLTS, unpack_hello

LARGEST_REFERENCE: Final = 1 << 20
"""Bytes; as of a reference's file."""

MOST_EVENTS: Final = 64
"""Of one message."""

DEEPEST: Final = 4
"""Lists and maps within each other in the status."""

LARGEST_HELLO: Final = LARGEST_VOLTS

Event = tuple[int, str]
"""``seq`` of a published frame, and an event of it (SPEC.md, section 7)."""

_TEXTS: Final = ("host", "serial", "configuration", "bundle", "skin", "protocol_id", "grid_id", "version")


@dataclass(frozen=True, slots=True, eq=False)
class SkinState(Received):
    """The device, the runtime and their status.

    Attributes:
        hello: HELLO of the device (SPEC.md, section 5).
        host: Boot id of the runtime's machine.
        serial: Serial number of the device.
        configuration: Name and digest of the device's configuration.
        bundle: Id of the bundle.
        skin: Name and digest of the skin's description.
        protocol_id: Id of the table of rows and its normalisation.
        grid_id: Id of the map and the electrodes.
        version: Version of the runtime.
        solvers: Solvers of this runtime, from the most accurate to the fastest.
        status: The answer to the control request ``status``: counts, electrodes, drift, level, trouble, ...
        reference_sha256: SHA-256 of the reference file; empty without a reference.
        reference: The reference file, as ``eitskin reference`` writes it; None until it has come.
        events: Events of frames since the previous message, the last 64.
        made_ns: ``perf_counter_ns`` of the runtime's machine when it made this message.
        utc_ns: Wall clock at the same moment.
    """

    hello: bytes
    host: str
    serial: str
    configuration: str
    bundle: str
    skin: str
    protocol_id: str
    grid_id: str
    version: str
    solvers: tuple[str, ...]
    status: Mapping[str, Any]
    reference_sha256: str
    reference: bytes | None
    events: tuple[Event, ...]
    made_ns: int
    utc_ns: int

    def body(self) -> bytes:
        """Return it as a stream carries it."""
        found: bytes = msgpack.packb(
            {**{name: getattr(self, name) for name in _TEXTS}, "hello": self.hello, "solvers": list(self.solvers),
             "status": dict(self.status), "reference_sha256": self.reference_sha256, "reference": self.reference,
             "events": [list(event) for event in self.events], "made_ns": self.made_ns, "utc_ns": self.utc_ns}
        )  # fmt: skip
        return found

    @classmethod
    def of(cls, body: bytes) -> Self:
        """Return the state of a body.

        Raises:
            FrameError: It is malformed, or the reference is not the one that it names.
        """
        fields = fields_of(body, f"stream {STATE}")
        reference = None if fields.is_nil("reference") else fields.raw("reference", most=LARGEST_REFERENCE)
        digest = fields.text("reference_sha256", least=0)
        if reference is not None and hashlib.sha256(reference).hexdigest() != digest:
            raise fields.wrong("reference_sha256", "that of the reference beside it")
        hello = fields.raw("hello", most=LARGEST_HELLO)
        try:
            unpack_hello(hello)
        except ProtocolError as error:
            raise fields.wrong("hello", "a HELLO of this protocol") from error
        require(fields, "solvers", "events")
        status = fields.value("status")
        if not isinstance(status, dict) or not _is_plain(status, DEEPEST):
            raise fields.wrong("status", "a map of plain values")
        events = fields.entries("events", most=MOST_EVENTS, of="events")
        texts: dict[str, Any] = {name: fields.text(name, least=0, longest=MAX_TEXT) for name in _TEXTS}
        return cls(
            **texts,
            hello=hello,
            solvers=fields.texts("solvers", most=16),
            status=status,
            reference_sha256=digest,
            reference=reference,
            events=tuple(_event(events, place) for place in events),
            made_ns=fields.whole("made_ns"),
            utc_ns=fields.whole("utc_ns"),
        )

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON, without the reference file; HELLO as hexadecimal digits and as fields."""
        hello = unpack_hello(self.hello)
        hidden = "magic", "tag", "electrodes"
        named = {name: getattr(hello, name) for name, _ in hello.LAYOUT.fields if name not in hidden}
        return {
            **{name: getattr(self, name) for name in ("n", "run", "made_ns", "utc_ns", *_TEXTS)},
            "solvers": list(self.solvers),
            "reference_sha256": self.reference_sha256,
            "hello": {**named, "firmware_version": list(hello.firmware_version)},
            "hello_hex": self.hello.hex(),
            "status": dict(self.status),
            "events": [list(event) for event in self.events],
        }


def _event(events: Fields, place: int) -> Event:
    match events.value(place):
        case [int(seq), str(text)] if seq >= 0 and len(text) <= 128:
            return seq, text
    raise events.wrong(place, "[seq, text]")


def _is_plain(value: object, depth: int) -> bool:
    """Return whether a value has texts, numbers, lists and maps of them, and nothing binary."""
    if value is None or isinstance(value, bool | int):
        return True
    if isinstance(value, float):
        return math.isfinite(value)
    if isinstance(value, str):
        return len(value) <= MAX_TEXT
    if depth and isinstance(value, list):
        return all(_is_plain(item, depth - 1) for item in value)
    if depth and isinstance(value, dict):
        return all(isinstance(key, str) and _is_plain(item, depth - 1) for key, item in value.items())
    return False
