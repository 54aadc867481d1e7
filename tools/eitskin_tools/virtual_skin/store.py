"""Two slots of configuration in memory, and the steps that change them without ever leaving the device with neither.

::

    Begin(token) -> Write ... -> Verify -> Commit -> Restart -> [trial] -> Confirm
      lock, erase                          newest                 |
      the other slot                       slot to try            +-- boot without Confirm -> the slot before

The rules, and the order in which a request is refused, are SPEC.md's, section 6: a committed slot runs if it is
confirmed, or once on trial; otherwise the other slot if that is confirmed, otherwise the factory configuration,
generation 0. Every operation answers (code, detail) and changes nothing unless the code is OK.
"""

from dataclasses import dataclass
from typing import Final

from eitskin_proto.errors import ProtocolError
from eitskin_proto.wire import hardware, messages
from eitskin_proto.wire.codes import Code, Slot
from eitskin_proto.wire.config import BLOB_BYTES, BLOB_MAGIC, FORMAT, HAS_SKIN, Configuration
from eitskin_proto.wire.framing import crc32c

LOCK_NS: Final = 10_000_000_000
"""A session that is silent for this long loses its lock."""

Answer = tuple[Code, int]


@dataclass(slots=True)
class _Slot:
    blob: bytes = b""
    generation: int = 0
    committed: bool = False
    attempted: bool = False
    confirmed: bool = False
    revoked: bool = False

    def configuration(self) -> Configuration | None:
        """Return what the slot holds, or None if it does not count."""
        return Configuration.from_blob(self.blob) if self.committed and not self.revoked else None


@dataclass(slots=True)
class _Session:
    """The holder of the lock; ``begin`` is None if it was taken for a rollback."""

    token: int
    heard_ns: int
    begin: messages.ConfigBegin | None = None
    committed: int = 0
    """Generation of what this session committed; 0 for nothing yet."""


class ConfigurationStore:
    """The device's configurations; owns both slots and the lock of the one session that may change them.

    Args:
        factory: What runs when no slot is usable.
    """

    def __init__(self, factory: Configuration) -> None:
        self.factory = factory
        self.configuration = factory
        """What runs since the last boot."""
        self.generation = 0
        """Of what runs; 0 for the factory's."""
        self.rolled_back = False
        """Whether the last boot gave up an unconfirmed configuration."""
        self._slots = [_Slot(), _Slot()]
        self._session: _Session | None = None
        self._running: int | None = None
        self._next_generation = 1

    @property
    def on_trial(self) -> bool:
        """Whether the running configuration waits for its confirmation."""
        return self._running is not None and not self._slots[self._running].confirmed

    @property
    def revoked(self) -> bool:
        """Whether the running configuration was rolled back, so that the next boot runs the other one."""
        return self._running is not None and self._slots[self._running].revoked

    def boot(self) -> None:
        """Choose what runs: the newest usable slot, unless its one trial is over."""
        self._session = None
        self.rolled_back = False
        self._running, self.configuration, self.generation = None, self.factory, 0
        self._next_generation = 1 + max(slot.generation for slot in self._slots)
        usable = [index for index in (0, 1) if self._slots[index].configuration() is not None]
        for index in sorted(usable, key=lambda index: -self._slots[index].generation):
            slot = self._slots[index]
            if slot.confirmed or (index == self._newest(usable) and not slot.attempted):
                slot.attempted = True
                stored = slot.configuration()
                assert stored is not None
                self._running, self.configuration, self.generation = index, stored, slot.generation
                return
            self.rolled_back |= index == self._newest(usable)

    def _newest(self, usable: list[int]) -> int:
        return max(usable, key=lambda index: self._slots[index].generation)

    def read(self, request: messages.ConfigRead, now_ns: int) -> messages.ConfigData | Answer:
        """Return a piece of a stored configuration."""
        self._left_ms(now_ns)  # a session that has expired is over
        fits = 1 <= request.length <= messages.CHUNK_BYTES and request.offset + request.length <= BLOB_BYTES
        if request.slot not in (Slot.ACTIVE, Slot.OTHER) or not fits:
            return Code.BAD_VALUE, BLOB_BYTES
        other, session = self._slots[self._other()], self._session
        if request.slot == Slot.ACTIVE:
            blob, generation = self.configuration.to_blob(), 0 if self.revoked else self.generation
        elif session is not None and session.begin is not None:
            blob, generation = other.blob.ljust(BLOB_BYTES, b"\xff"), session.committed  # as the storage holds it
        elif other.configuration() is not None:
            blob, generation = other.blob, other.generation
        else:
            return Code.NO_PREVIOUS, 0
        piece = blob[request.offset : request.offset + request.length]
        return messages.ConfigData(request.slot, generation, request.offset, BLOB_BYTES, piece, request.tag)

    def begin(self, request: messages.ConfigBegin, now_ns: int) -> Answer:
        """Take the lock and erase the slot that does not run."""
        active = self.configuration
        if request.hardware_id != hardware.EITSKIN_16.id:
            return Code.WRONG_HARDWARE, hardware.EITSKIN_16.id
        if request.format != FORMAT:
            return Code.BAD_FORMAT, FORMAT
        if request.size != BLOB_BYTES:
            return Code.TOO_LARGE, BLOB_BYTES
        if not request.allow_downgrade and request.revision < active.revision and request.name == active.name:
            return Code.DOWNGRADE, active.revision
        if self.on_trial or self.revoked:  # the other slot is what boots next, and the only one that is confirmed
            return Code.NOT_CONFIRMED, self.generation
        refused = self._lock_refusal(request.token, now_ns)
        if refused is not None:
            return refused
        self._session = _Session(request.token, now_ns, request)
        self._slots[self._other()] = _Slot()
        return Code.OK, BLOB_BYTES

    def write(self, request: messages.ConfigWrite, now_ns: int) -> Answer:
        """Append a piece to the slot that does not run; the last piece may come again."""
        session, refused = self._open_session(request.token, now_ns)
        if session is None:
            return refused
        slot, end = self._slots[self._other()], request.offset + len(request.data)
        if not request.data or len(request.data) % 4:
            return Code.BAD_VALUE, len(request.data)
        if end == len(slot.blob) and slot.blob.endswith(request.data):
            return Code.OK, len(slot.blob)
        if request.offset != len(slot.blob) or end > BLOB_BYTES:
            return Code.BAD_OFFSET, len(slot.blob)
        slot.blob += request.data
        return Code.OK, len(slot.blob)

    def verify(self, request: messages.ConfigVerify, now_ns: int) -> Answer:
        """Read the written slot back; the detail is the digest that it has."""
        session, refused = self._open_session(request.token, now_ns)
        return refused if session is None else self._verified(session)

    def _verified(self, session: _Session) -> Answer:
        blob = self._slots[self._other()].blob
        if len(blob) != BLOB_BYTES:
            return Code.INCOMPLETE, len(blob)
        code = judge(blob)
        if code != Code.OK:
            return code, 0
        digest = int.from_bytes(blob[-4:], "little")
        assert session.begin is not None
        return (Code.OK if digest == session.begin.digest else Code.DIGEST_MISMATCH), digest

    def commit(self, request: messages.ConfigCommit, now_ns: int) -> Answer:
        """Make the written slot the newest; it runs on trial from the next boot. Asked again, it answers the same."""
        session, refused = self._open_session(request.token, now_ns)
        if session is None:
            return refused
        assert session.begin is not None
        if session.committed and request.digest == session.begin.digest:
            return Code.OK, session.committed
        code, digest = self._verified(session)
        if code != Code.OK:
            return code, digest
        if digest != request.digest:
            return Code.DIGEST_MISMATCH, digest
        slot = self._slots[self._other()]
        slot.generation, slot.committed = self._next_generation, True
        self._next_generation += 1
        session.committed = slot.generation
        return Code.OK, slot.generation

    def confirm(self, request: messages.ConfigConfirm, now_ns: int) -> Answer:
        """End the trial of the running configuration."""
        if (request.generation, request.digest) != (self.generation, self.configuration.digest):
            return Code.WRONG_GENERATION, self.generation
        if self.revoked:
            return Code.NOT_CONFIRMED, self.generation
        if self._running is not None:
            self._slots[self._running].confirmed = True
        return Code.OK, self.generation

    def rollback(self, request: messages.ConfigRollback, now_ns: int) -> Answer:
        """Revoke the running generation, so that the next boot runs the slot before."""
        if request.generation != self.generation:
            return Code.WRONG_GENERATION, self.generation
        refused = self._lock_refusal(request.token, now_ns)
        if refused is not None:
            return refused
        self._session = _Session(request.token, now_ns)
        other = self._slots[self._other()]
        if self._running is None or other.configuration() is None or not other.confirmed:
            self._session = None
            return Code.NO_PREVIOUS, self.generation
        self._slots[self._running].revoked = True
        return Code.OK, self.generation

    def abort(self, request: messages.ConfigAbort, now_ns: int) -> Answer:
        """Give the lock back; what was written and not committed counts for nothing."""
        session, refused = self._open_session(request.token, now_ns)
        if session is None:
            return refused
        self._session = None
        return Code.OK, 0

    def may_restart(self, token: int, now_ns: int) -> Answer:
        """Return OK for the holder of the lock, and for token 0 while it is free."""
        left_ms = self._left_ms(now_ns)
        if left_ms and self._session is not None and token != self._session.token:
            return Code.BUSY, left_ms
        if not left_ms and token != 0:
            return Code.NO_SESSION, 0
        return Code.OK, 0

    def _left_ms(self, now_ns: int) -> int:
        """Return the milliseconds until the lock expires; 0 if it is free."""
        if self._session is None:
            return 0
        silent_ns = now_ns - self._session.heard_ns
        if silent_ns >= LOCK_NS:
            self._session = None
            return 0
        return 1 + (LOCK_NS - silent_ns) // 1_000_000

    def _lock_refusal(self, token: int, now_ns: int) -> Answer | None:
        """Return why this token cannot have the lock; None if it can."""
        left_ms = self._left_ms(now_ns)
        if token == 0:
            return Code.BAD_VALUE, 0
        if self._session is not None and token != self._session.token:
            return Code.BUSY, left_ms
        return None

    def _open_session(self, token: int, now_ns: int) -> tuple[_Session | None, Answer]:
        """Return the open session of this token, kept alive; or None and the answer."""
        left_ms = self._left_ms(now_ns)
        session = self._session
        if session is not None and token != session.token:
            return None, (Code.BUSY, left_ms)
        if session is None or session.begin is None:
            return None, (Code.NO_SESSION, 0)
        session.heard_ns = now_ns
        return session, (Code.OK, 0)

    def _other(self) -> int:
        return 1 if self._running == 0 else 0


def judge(blob: bytes) -> Code:
    """Return what is wrong with a blob of full length, in the order in which the firmware looks; OK if nothing is."""
    if blob[:4] != BLOB_MAGIC:
        return Code.DIGEST_MISMATCH
    if blob[4] != FORMAT:
        return Code.BAD_FORMAT
    if crc32c(blob[:-4]) != int.from_bytes(blob[-4:], "little"):
        return Code.DIGEST_MISMATCH
    if int.from_bytes(blob[6:8], "little") != BLOB_BYTES or blob[59] > HAS_SKIN:
        return Code.INVALID_CONFIGURATION
    if int.from_bytes(blob[8:12], "little") != hardware.EITSKIN_16.id:
        return Code.WRONG_HARDWARE
    try:
        found = Configuration.from_blob(blob)
    except ProtocolError:
        return Code.INVALID_CONFIGURATION
    try:
        found.check()
    except ValueError:
        modes = [(found.drives, found.rate_mHz), (found.idle_drives, found.idle_rate_mHz)]
        slow = any(drives and rate * found.scan_us(drives) > 10**9 for drives, rate in modes)
        return Code.RATE_TOO_HIGH if slow and _values_fit(found) else Code.INVALID_CONFIGURATION
    return Code.OK


def _values_fit(found: Configuration) -> bool:
    """Return whether the electronics have every value but the rates."""
    can = hardware.hardware_of(found.hardware_id)
    return (
        can.min_frequency_hz <= found.frequency_hz <= can.max_frequency_hz
        and found.current_ua <= can.max_current_ua
        and found.gain in can.gains
        and found.settle_us >= can.min_settle_us
    )
