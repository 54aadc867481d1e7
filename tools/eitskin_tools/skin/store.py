"""Two slots of configuration in memory, and the steps that change them without ever leaving the device with neither.

::

    Begin(token) -> Write ... -> Verify -> Commit -> Restart -> [trial] -> Confirm
      lock, erase                          newest                 |
      the other slot                       slot to try            +-- boot without Confirm -> the slot before

The rules are SPEC.md's, section 6: a committed slot runs if it is confirmed, or once on trial; otherwise the other
slot if that is confirmed, otherwise the factory configuration, generation 0. Every operation answers (code, detail)
and changes nothing unless the code is OK.
"""

from dataclasses import dataclass
from typing import Final

from eitskin_proto import messages
from eitskin_proto.codes import Code, Slot
from eitskin_proto.config import BLOB_BYTES, FORMAT, Configuration
from eitskin_proto.errors import ProtocolError
from eitskin_proto.framing import crc32c

LOCK_NS: Final = 10_000_000_000
"""A session that is silent for this long loses its lock."""

TRIAL_NS: Final = 30_000_000_000
"""A device that waits this long for CONFIG_CONFIRM restarts by itself."""

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
        if not self.committed or self.revoked:
            return None
        try:
            return Configuration.from_blob(self.blob)
        except ProtocolError:
            return None


@dataclass(slots=True)
class _Session:
    token: int
    begin: messages.ConfigBegin
    heard_ns: int
    verified: bool = False


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

    @property
    def on_trial(self) -> bool:
        """Whether the running configuration waits for its confirmation."""
        return self._running is not None and not self._slots[self._running].confirmed

    def boot(self) -> None:
        """Choose what runs: the newest usable slot, unless its one trial is over."""
        self._session = None
        self.rolled_back = False
        self._running, self.configuration, self.generation = None, self.factory, 0
        newest = max((0, 1), key=lambda i: self._slots[i].generation if self._slots[i].configuration() else -1)
        for index in (newest, 1 - newest):
            slot = self._slots[index]
            stored = slot.configuration()
            if stored is None:
                continue
            if not slot.confirmed and (slot.attempted or index != newest):
                self.rolled_back = True
                continue
            slot.attempted = True
            self._running, self.configuration, self.generation = index, stored, slot.generation
            return

    def read(self, request: messages.ConfigRead) -> messages.ConfigData | Answer:
        """Return a piece of a stored configuration."""
        if request.slot not in (Slot.ACTIVE, Slot.OTHER):
            return Code.BAD_VALUE, request.slot
        if request.slot == Slot.ACTIVE:
            blob, generation = self.configuration.to_blob(), self.generation
        else:
            other = self._slots[self._other()]
            blob, generation = other.blob, other.generation
        if not blob:
            return Code.NO_PREVIOUS, 0
        if request.offset > len(blob) or not 1 <= request.length <= messages.CHUNK_BYTES:
            return Code.BAD_VALUE, len(blob)
        piece = blob[request.offset : request.offset + request.length]
        return messages.ConfigData(request.slot, generation, request.offset, len(blob), piece, request.tag)

    def begin(self, request: messages.ConfigBegin, now_ns: int) -> Answer:
        """Take the lock and erase the slot that does not run."""
        held = self._session
        if held is not None and held.token != request.token and now_ns - held.heard_ns < LOCK_NS:
            return Code.BUSY, (LOCK_NS - (now_ns - held.heard_ns)) // 1_000_000
        active = self.configuration
        if self.on_trial:
            return Code.NOT_CONFIRMED, self.generation
        if request.hardware_id != active.hardware_id:
            return Code.WRONG_HARDWARE, active.hardware_id
        if request.format != FORMAT:
            return Code.BAD_FORMAT, FORMAT
        if request.size > BLOB_BYTES:
            return Code.TOO_LARGE, BLOB_BYTES
        if request.size < BLOB_BYTES or request.token == 0:
            return Code.BAD_VALUE, BLOB_BYTES
        if request.name == active.name and request.revision < active.revision and not request.allow_downgrade:
            return Code.DOWNGRADE, active.revision
        self._session = _Session(request.token, request, now_ns)
        self._slots[self._other()] = _Slot()
        return Code.OK, 0

    def write(self, request: messages.ConfigWrite, now_ns: int) -> Answer:
        """Append a piece to the slot that does not run; the last piece may come again."""
        session = self._hold(request.token, now_ns)
        if session is None:
            return Code.NO_SESSION, 0
        if not request.data or len(request.data) % 4:
            return Code.BAD_VALUE, 4
        slot = self._slots[self._other()]
        repeated = request.offset + len(request.data) == len(slot.blob) and slot.blob.endswith(request.data)
        if repeated:
            return Code.OK, len(slot.blob)
        if request.offset != len(slot.blob):
            return Code.BAD_OFFSET, len(slot.blob)
        if request.offset + len(request.data) > session.begin.size:
            return Code.TOO_LARGE, session.begin.size
        slot.blob += request.data
        session.verified = False
        return Code.OK, len(slot.blob)

    def verify(self, request: messages.ConfigVerify, now_ns: int) -> Answer:
        """Read the written slot back; the detail is the digest that it has."""
        session = self._hold(request.token, now_ns)
        if session is None:
            return Code.NO_SESSION, 0
        blob = self._slots[self._other()].blob
        if len(blob) != session.begin.size:
            return Code.INCOMPLETE, len(blob)
        digest = crc32c(blob[:-4])
        if digest != session.begin.digest:
            return Code.DIGEST_MISMATCH, digest
        try:
            Configuration.from_blob(blob).check()
        except (ProtocolError, ValueError):
            return Code.INVALID_CONFIGURATION, digest
        session.verified = True
        return Code.OK, digest

    def commit(self, request: messages.ConfigCommit, now_ns: int) -> Answer:
        """Make the written slot the newest; it runs on trial from the next boot."""
        session = self._hold(request.token, now_ns)
        if session is None:
            return Code.NO_SESSION, 0
        if not session.verified:
            return Code.INCOMPLETE, len(self._slots[self._other()].blob)
        if request.digest != session.begin.digest:
            return Code.DIGEST_MISMATCH, session.begin.digest
        slot = self._slots[self._other()]
        slot.generation = max(s.generation for s in self._slots) + 1
        slot.committed = True
        return Code.OK, slot.generation

    def confirm(self, request: messages.ConfigConfirm, now_ns: int) -> Answer:
        """End the trial of the running configuration."""
        if request.generation != self.generation:
            return Code.WRONG_GENERATION, self.generation
        if request.digest != self.configuration.digest:
            return Code.DIGEST_MISMATCH, self.configuration.digest
        if self._running is not None:
            self._slots[self._running].confirmed = True
        return Code.OK, self.generation

    def rollback(self, request: messages.ConfigRollback, now_ns: int) -> Answer:
        """Revoke the running generation, so that the next boot runs the slot before."""
        held = self._session
        if held is not None and held.token != request.token and now_ns - held.heard_ns < LOCK_NS:
            return Code.BUSY, (LOCK_NS - (now_ns - held.heard_ns)) // 1_000_000
        other = self._slots[self._other()]
        if self._running is None or other.configuration() is None or not other.confirmed:
            return Code.NO_PREVIOUS, 0
        if request.generation != self.generation:
            return Code.WRONG_GENERATION, self.generation
        self._slots[self._running].revoked = True
        return Code.OK, other.generation

    def abort(self, request: messages.ConfigAbort, now_ns: int) -> Answer:
        """Give the lock back; what was written and not committed is gone."""
        if self._hold(request.token, now_ns) is None:
            return Code.NO_SESSION, 0
        if not self._slots[self._other()].committed:
            self._slots[self._other()] = _Slot()
        self._session = None
        return Code.OK, 0

    def _hold(self, token: int, now_ns: int) -> _Session | None:
        session = self._session
        if session is None or session.token != token or now_ns - session.heard_ns >= LOCK_NS:
            return None
        session.heard_ns = now_ns
        return session

    def _other(self) -> int:
        return 0 if self._running is None else 1 - self._running
