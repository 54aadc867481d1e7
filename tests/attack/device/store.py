"""Stored configurations of the device, from section 6 of SPEC.md alone: two slots, a lock, and requests for them."""

import struct
import time
from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple

from . import codec
from .codec import crc32c

HARDWARE: Final = 0x45533136
SLOT: Final = 84
LOCK_S: Final = 10.0
Answer = tuple[int, int]
"""Code and detail of an ACK."""


class Configuration(NamedTuple):
    """The fields of a blob."""

    magic: bytes
    format: int
    rows: int
    size: int
    hardware_id: int
    revision: int
    name: bytes
    frequency_Hz: int
    rate_mHz: int
    idle_rate_mHz: int
    current_uA: int
    settle_us: int
    averages: int
    gain: int
    drives: int
    idle_drives: int
    sample_bytes: int
    reserved: int
    crc: int

    @classmethod
    def read(cls, blob: bytes) -> "Configuration":
        """Return the fields of 64 bytes."""
        return cls(*struct.unpack(codec.CONFIGURATION, blob))


def blob(**changes: Any) -> bytes:
    """Return a configuration: 104 rows of 24 bit, 200 a second, unless changed."""
    usual: dict[str, Any] = dict(
        magic=codec.BLOB_MAGIC, format=1, rows=104, size=64, hardware_id=HARDWARE, revision=1, name=b"own"
    )
    usual |= dict(frequency_Hz=20_000, rate_mHz=200_000, idle_rate_mHz=20_000, current_uA=1000, settle_us=100)
    usual |= dict(averages=5, gain=8, drives=0xFFFF, idle_drives=0x000F, sample_bytes=3, reserved=0)
    packed = struct.pack(codec.CONFIGURATION, *Configuration(**(usual | changes), crc=0))[:-4]
    return packed + struct.pack("<I", crc32c(packed))


def scan_us(found: Configuration) -> float:
    """Return how long a scan takes."""
    with_rows = range(14 if found.rows == 104 else 16)
    drives = sum(found.drives >> k & 1 for k in with_rows)
    return 20 + drives * (found.settle_us + -(-found.averages * 1_000_000 // found.frequency_Hz))


class Store:
    """Two slots and who holds the lock."""

    def __init__(self, first: bytes) -> None:
        self.slots = [bytearray(b"\xff" * SLOT), bytearray(b"\xff" * SLOT)]
        self.built_in = first
        self._program(0, 0, first)
        self._commit(0, 1)
        self._program(0, 76, struct.pack("<I", ~self._word(0, 68) & 0xFFFFFFFF))
        self._token = 0
        self._until_s = 0.0
        self._announced: tuple[Any, ...] = ()
        self._written = 0
        self._committed = False
        self.active: int | None = None
        self.trial = self.gave_up = False
        self.boot()

    def boot(self) -> None:
        """Choose what runs."""
        self._token, self._announced = 0, ()
        valid = sorted((slot for slot in (0, 1) if self.valid(slot)), key=self.generation_of, reverse=True)
        self.active, self.trial, self.gave_up = None, False, False
        for slot in valid:
            if self.confirmed(slot):
                self.active = slot
                return
            if slot == valid[0] and self._word(slot, 72) == 0xFFFFFFFF:
                self._program(slot, 72, bytes(4))
                self.active, self.trial = slot, True
                return
            self.gave_up = True

    @property
    def running(self) -> bytes:
        """The blob that runs."""
        return self.built_in if self.active is None else bytes(self.slots[self.active][:64])

    @property
    def generation(self) -> int:
        """Of what runs; 0 of the built-in one."""
        return 0 if self.active is None else self.generation_of(self.active)

    def generation_of(self, slot: int) -> int:
        """Return a slot's."""
        return self._word(slot, 64)

    def valid(self, slot: int) -> bool:
        """Return whether blob and commit are right and it is not revoked."""
        held = self.slots[slot]
        right = crc32c(bytes(held[:60])) == self._word(slot, 60) and held[:4] == codec.BLOB_MAGIC
        return right and self._word(slot, 68) == crc32c(bytes(held[60:68])) and self._word(slot, 80) == 0xFFFFFFFF

    def confirmed(self, slot: int) -> bool:
        """Return whether a valid slot's trial has ended well."""
        return self.valid(slot) and self._word(slot, 76) == ~self._word(slot, 68) & 0xFFFFFFFF

    def answer(self, kind: int, fields: tuple[Any, ...], streaming: bool) -> "Answer | bytes":
        """Return code and detail of the answer to a request of section 6, or the payload of a CONFIG_DATA."""
        handlers: Mapping[int, Callable[..., Answer | bytes]] = {
            codec.READ: self._read,
            codec.BEGIN: self._begin,
            codec.WRITE: self._write,
            codec.VERIFY: self._verify,
            codec.COMMIT: self._verify,
            codec.CONFIRM: self._confirm,
            codec.ROLLBACK: self._rollback,
            codec.ABORT: self._abort,
            codec.RESTART: self._restart,
        }
        if kind in (codec.BEGIN, codec.ROLLBACK) and streaming:
            return codec.STREAMING, 0
        in_session = kind in (codec.WRITE, codec.VERIFY, codec.COMMIT, codec.ABORT) or (
            kind == codec.RESTART and fields[1]
        )
        if in_session and (refused := self._holds(fields[1])) is not None:
            return refused
        return handlers[kind](*fields)

    def _holds(self, token: int) -> Answer | None:
        left_s = self._until_s - time.monotonic()
        if not self._token or left_s <= 0:
            self._token = 0
            return codec.NO_SESSION, 0
        if token != self._token:
            return codec.BUSY, int(left_s * 1000)
        self._until_s = time.monotonic() + LOCK_S
        return None

    def _take(self, token: int) -> Answer | None:
        if token == 0:
            return codec.BAD_VALUE, 0
        refused = self._holds(token)
        if refused is not None and refused[0] == codec.BUSY:
            return refused
        self._token, self._until_s = token, time.monotonic() + LOCK_S
        return None

    def _other(self) -> int:
        return 1 if self.active == 0 else 0

    def _read(self, tag: int, slot: int, offset: int, length: int) -> "Answer | bytes":
        if slot > 1 or length > 32 or offset + length > 64:
            return codec.BAD_VALUE, 0
        session = bool(self._token) and self._until_s > time.monotonic()
        if slot == 0:
            held, generation = self.running, self.generation
        elif session or self.valid(self._other()):
            held, generation = bytes(self.slots[self._other()][:64]), self.generation_of(self._other())
        else:
            return codec.NO_PREVIOUS, 0
        return codec.pack(codec.CONFIG_DATA, tag, slot, generation, offset, 64, tail=held[offset : offset + length])

    def _begin(self, tag: int, token: int, *announced: Any) -> Answer:
        size, _, hardware, revision, layout, downgrade, name = announced
        runs = Configuration.read(self.running)
        if hardware != HARDWARE:
            return codec.WRONG_HARDWARE, HARDWARE
        if layout != 1:
            return codec.BAD_FORMAT, 1
        if size != 64:
            return codec.TOO_LARGE, 64
        if name == runs.name and revision < runs.revision and not downgrade:
            return codec.DOWNGRADE, runs.revision
        if self.trial:
            return codec.NOT_CONFIRMED, self.generation
        if (refused := self._take(token)) is not None:
            return refused
        other = self._other()
        self._program(other, 68, bytes(4))
        self.slots[other][:] = b"\xff" * SLOT
        self._announced, self._written, self._committed = announced, 0, False
        return codec.OK, 0

    def _write(self, tag: int, token: int, offset: int, data: bytes) -> Answer:
        if not self._announced or self._committed:
            return codec.NO_SESSION, 0
        if not data or len(data) % 4 or offset % 4 or offset + len(data) > 64:
            return codec.BAD_VALUE, 0
        if offset + len(data) == self._written:  # the last chunk again
            return codec.OK, self._written
        if offset != self._written:
            return codec.BAD_OFFSET, self._written
        self._program(self._other(), offset, data)
        self._written += len(data)
        return codec.OK, self._written

    def _verify(self, tag: int, token: int, digest: int | None = None) -> Answer:
        other = self._other()
        if self._committed:
            return codec.OK, self.generation_of(other) if digest is not None else self._word(other, 60)
        if self._written < 64:
            return codec.INCOMPLETE, self._written
        held = bytes(self.slots[other][:64])
        found = Configuration.read(held)
        if found.magic != codec.BLOB_MAGIC:
            return codec.DIGEST_MISMATCH, found.crc
        if found.format != 1:
            return codec.BAD_FORMAT, 1
        if crc32c(held[:60]) != found.crc:
            return codec.DIGEST_MISMATCH, found.crc
        if found.size != 64 or found.reserved:
            return codec.INVALID_CONFIGURATION, 0
        if found.hardware_id != HARDWARE:
            return codec.WRONG_HARDWARE, HARDWARE
        whole = found.rows in (104, 208) and found.sample_bytes in (2, 3, 4) and found.drives and found.rate_mHz
        if not whole or not found.frequency_Hz or bool(found.idle_drives) != bool(found.idle_rate_mHz):
            return codec.INVALID_CONFIGURATION, 0
        if found.rate_mHz * scan_us(found) > 1e9:
            return codec.RATE_TOO_HIGH, 0
        if found.crc != self._announced[1] or digest not in (None, found.crc):
            return codec.DIGEST_MISMATCH, found.crc
        if digest is None:
            return codec.OK, found.crc
        seen = [self.generation_of(slot) for slot in (0, 1)]
        self._commit(other, 1 + max(generation for generation in (*seen, 0) if generation != 0xFFFFFFFF))
        self._committed = True
        return codec.OK, self.generation_of(other)

    def _confirm(self, tag: int, generation: int, digest: int) -> Answer:
        if self.active is None or (generation, digest) != (self.generation, self._word(self.active, 60)):
            return codec.WRONG_GENERATION, self.generation
        self._program(self.active, 76, struct.pack("<I", ~self._word(self.active, 68) & 0xFFFFFFFF))
        self.trial = False
        return codec.OK, self.generation

    def _rollback(self, tag: int, token: int, generation: int) -> Answer:
        if generation != self.generation or self.active is None:
            return codec.WRONG_GENERATION, self.generation
        if (refused := self._take(token)) is not None:
            return refused
        if not self.confirmed(self._other()):
            self._token = 0
            return codec.NO_PREVIOUS, 0
        self._program(self.active, 80, bytes(4))
        return codec.OK, generation

    def _abort(self, tag: int, token: int) -> Answer:
        self._token, self._announced = 0, ()
        return codec.OK, 0

    def _restart(self, tag: int, token: int) -> Answer:
        self._token = 0
        return codec.OK, 0

    def _word(self, slot: int, at: int) -> int:
        return int.from_bytes(self.slots[slot][at : at + 4], "little")

    def _program(self, slot: int, at: int, data: bytes) -> None:
        held = self.slots[slot]
        for i, byte in enumerate(data):
            held[at + i] &= byte

    def _commit(self, slot: int, generation: int) -> None:
        self._program(slot, 64, struct.pack("<I", generation))
        self._program(slot, 68, struct.pack("<I", crc32c(bytes(self.slots[slot][60:68]))))
