"""SPEC.md, section 6, as a state machine of values. It shares nothing with the C core and the virtual skin.

::

    answer(state, request) -> (state afterwards, what the device says)
    boot(state), wait(state, seconds) -> state afterwards

Storage that a power cut left half done is either as it was before the request or as after it (that is what SPEC.md
promises), so a player that cuts the power goes on with both states and drops the one that the device's answers refute.
"""

from typing import Any, Final, NamedTuple

from eitskin_proto.wire.codes import Code, HelloFlag
from eitskin_proto.wire.framing import crc32c

BLOB_BYTES: Final = 64
HARDWARE_ID: Final = 0x45533136
FORMAT: Final = 1
MAGIC: Final = b"EITC"

LOCK_S: Final = 10
TRIAL_S: Final = 30


class Slot(NamedTuple):
    """A slot whose commit word is right; any other is None."""

    blob: bytes
    generation: int
    tried: bool = False
    confirmed: bool = False
    revoked: bool = False


class Session(NamedTuple):
    """Who holds the lock; ``announced`` is None if it was taken for a rollback."""

    token: int
    announced: int | None = None
    written: bytes = b""
    committed: int = 0
    silent_s: int = 0


class State(NamedTuple):
    """A device: ``running`` is a slot's number, or None for the built-in configuration."""

    factory: bytes
    slots: tuple[Slot | None, Slot | None] = (None, None)
    running: int | None = None
    trial: bool = False
    gave_up: bool = False
    next_generation: int = 1
    streaming: bool = False
    session: Session | None = None
    trial_s: int = 0

    @property
    def blob(self) -> bytes:
        """Of what runs."""
        slot = None if self.running is None else self.slots[self.running]
        return self.factory if slot is None else slot.blob

    @property
    def generation(self) -> int:
        """Of what runs."""
        slot = None if self.running is None else self.slots[self.running]
        return 0 if slot is None else slot.generation

    @property
    def other(self) -> int:
        """The slot that BEGIN erases."""
        return 1 if self.running == 0 else 0

    @property
    def revoked(self) -> bool:
        """Whether what runs was rolled back, so that the next boot runs the other slot."""
        slot = None if self.running is None else self.slots[self.running]
        return slot is not None and slot.revoked

    def with_slot(self, number: int, slot: Slot | None) -> "State":
        """Return it with one slot changed."""
        return self._replace(slots=(slot, self.slots[1]) if number == 0 else (self.slots[0], slot))


def digest_of(blob: bytes) -> int:
    """Return the last word of a blob."""
    return int.from_bytes(blob[-4:], "little")


def boot(state: State) -> State:
    """Return the device after a boot: memory is lost, storage is not, and a trial is used up."""
    fresh = State(state.factory, state.slots)
    fresh = fresh._replace(next_generation=1 + max((slot.generation for slot in state.slots if slot), default=0))
    valid = [number for number in (0, 1) if (slot := state.slots[number]) is not None and not slot.revoked]
    valid.sort(key=lambda number: -slot_of(state, number).generation)
    if not valid:
        return fresh
    newest = slot_of(state, valid[0])
    if newest.confirmed:
        return fresh._replace(running=valid[0])
    if not newest.tried:
        return fresh.with_slot(valid[0], newest._replace(tried=True))._replace(running=valid[0], trial=True)
    older = next((number for number in valid[1:] if slot_of(state, number).confirmed), None)
    return fresh._replace(running=older, gave_up=True)


def wait(state: State, seconds: int) -> State:
    """Return the device after some seconds of silence; whole seconds, far from the limits."""
    session = state.session
    if session is not None:
        session = session._replace(silent_s=session.silent_s + seconds)
    state = state._replace(session=session if session and session.silent_s < LOCK_S else None)
    if state.trial and state.trial_s + seconds >= TRIAL_S:
        return boot(state)
    return state._replace(trial_s=state.trial_s + seconds)


def slot_of(state: State, number: int) -> Slot:
    """Return a slot that is known to count."""
    slot = state.slots[number]
    assert slot is not None
    return slot


Request = tuple[Any, ...]
"""Its name, and its fields in the order of SPEC.md, tag left out."""

Reply = tuple[Any, ...]
"""("ack", code, detail) or ("hello", generation, digest, flags).

A detail of None is not foretold."""


def answer(state: State, request: Request) -> tuple[State, Reply]:
    """Return the device after a request, and what it says; RESTART's boot is the caller's."""
    name, *fields = request
    made: tuple[State, Reply] = _ANSWERS[name](state, *fields)
    return made


def _ack(code: Code, detail: int | None = 0) -> Reply:
    return ("ack", int(code), detail)


def _hello(state: State) -> tuple[State, Reply]:
    flags = (
        (HelloFlag.FULL if state.blob[5] == 208 else 0)
        | (HelloFlag.TRIAL if state.trial else 0)
        | (HelloFlag.FACTORY if state.running is None else 0)
        | (HelloFlag.ROLLED_BACK if state.gave_up else 0)
        | (HelloFlag.STREAMING if state.streaming else 0)
    )
    return state, ("hello", state.generation, digest_of(state.blob), int(flags))


def _start(state: State) -> tuple[State, Reply]:
    return state._replace(streaming=True), ("ack", int(Code.OK), None)  # its detail counts scans


def _stop(state: State) -> tuple[State, Reply]:
    return state._replace(streaming=False), ("ack", int(Code.OK), None)


def _begin(
    state: State,
    token: int,
    size: int,
    digest: int,
    hardware_id: int,
    revision: int,
    form: int,
    allow_downgrade: int,
    name: bytes,
) -> tuple[State, Reply]:
    active_revision = int.from_bytes(state.blob[12:16], "little")
    if state.streaming:
        return state, _ack(Code.STREAMING)
    if hardware_id != HARDWARE_ID:
        return state, _ack(Code.WRONG_HARDWARE, HARDWARE_ID)
    if form != FORMAT:
        return state, _ack(Code.BAD_FORMAT, FORMAT)
    if size != BLOB_BYTES:
        return state, _ack(Code.TOO_LARGE, BLOB_BYTES)
    if not allow_downgrade and revision < active_revision and name.ljust(16, b"\0") == state.blob[16:32]:
        return state, _ack(Code.DOWNGRADE, active_revision)
    if state.trial or state.revoked:
        return state, _ack(Code.NOT_CONFIRMED, state.generation)
    refused = _barred(state, token)
    if refused is not None:
        return state, refused
    begun = state.with_slot(state.other, None)
    return begun._replace(session=Session(token, digest)), _ack(Code.OK, BLOB_BYTES)


def _barred(state: State, token: int) -> Reply | None:
    """Return why this token may not take the session; None if it may."""
    return _ack(Code.BAD_VALUE) if token == 0 else _others(state, token)


def _others(state: State, token: int) -> Reply | None:
    """Return that another token has the session; None if none has."""
    return _ack(Code.BUSY, None) if state.session is not None and state.session.token != token else None


def _held(state: State, token: int) -> Reply | None:
    """Return why this token has no open session; None if it has."""
    refused = _others(state, token)
    if refused is None and (state.session is None or state.session.announced is None):
        return _ack(Code.NO_SESSION)
    return refused


def _heard(state: State, **changes: Any) -> State:
    assert state.session is not None
    return state._replace(session=state.session._replace(silent_s=0, **changes))


def _write(state: State, token: int, offset: int, data: bytes) -> tuple[State, Reply]:
    refused = _held(state, token)
    if refused is not None:
        return state, refused
    state, written = _heard(state), state.session.written if state.session else b""
    if not data or len(data) % 4:
        return state, _ack(Code.BAD_VALUE, len(data))
    if offset + len(data) == len(written) and written.endswith(data):
        return state, _ack(Code.OK, len(written))
    if offset != len(written) or offset + len(data) > BLOB_BYTES:
        return state, _ack(Code.BAD_OFFSET, len(written))
    return _heard(state, written=written + data), _ack(Code.OK, len(written) + len(data))


def _judged(session: Session) -> Reply:
    blob = session.written
    if len(blob) != BLOB_BYTES:
        return _ack(Code.INCOMPLETE, len(blob))
    if blob[:4] != MAGIC or crc32c(blob[:60]) != digest_of(blob):
        return _ack(Code.DIGEST_MISMATCH)
    return _ack(Code.OK if digest_of(blob) == session.announced else Code.DIGEST_MISMATCH, digest_of(blob))


def _verify(state: State, token: int) -> tuple[State, Reply]:
    refused = _held(state, token)
    if refused is not None:
        return state, refused
    state = _heard(state)
    assert state.session is not None
    return state, _judged(state.session)


def _commit(state: State, token: int, digest: int) -> tuple[State, Reply]:
    refused = _held(state, token)
    if refused is not None:
        return state, refused
    state = _heard(state)
    session = state.session
    assert session is not None
    if session.committed and digest == session.announced:
        return state, _ack(Code.OK, session.committed)
    judged = _judged(session)
    if judged[1] != Code.OK:
        return state, judged
    if judged[2] != digest:
        return state, ("ack", int(Code.DIGEST_MISMATCH), judged[2])
    number = state.next_generation
    state = state.with_slot(state.other, Slot(session.written, number))._replace(next_generation=number + 1)
    return _heard(state, committed=number), _ack(Code.OK, number)


def _confirm(state: State, generation: int, digest: int) -> tuple[State, Reply]:
    if (generation, digest) != (state.generation, digest_of(state.blob)):
        return state, _ack(Code.WRONG_GENERATION, state.generation)
    if state.revoked:
        return state, _ack(Code.NOT_CONFIRMED, state.generation)
    if state.running is not None:
        state = state.with_slot(state.running, slot_of(state, state.running)._replace(confirmed=True))
    return state._replace(trial=False), _ack(Code.OK, state.generation)


def _rollback(state: State, token: int, generation: int) -> tuple[State, Reply]:
    if state.streaming:
        return state, _ack(Code.STREAMING)
    if generation != state.generation:
        return state, _ack(Code.WRONG_GENERATION, state.generation)
    refused = _barred(state, token)
    if refused is not None:
        return state, refused
    other = state.slots[state.other]
    if state.running is None or other is None or other.revoked or not other.confirmed:
        return state._replace(session=None), _ack(Code.NO_PREVIOUS, state.generation)
    revoked = state.with_slot(state.running, slot_of(state, state.running)._replace(revoked=True))
    return revoked._replace(session=Session(token)), _ack(Code.OK, state.generation)


def _abort(state: State, token: int) -> tuple[State, Reply]:
    refused = _held(state, token)
    return (state, refused) if refused is not None else (state._replace(session=None), _ack(Code.OK))


def _restart(state: State, token: int) -> tuple[State, Reply]:
    if state.session is not None and state.session.token != token:
        return state, _ack(Code.BUSY, None)
    if state.session is None and token:
        return state, _ack(Code.NO_SESSION)
    return state._replace(streaming=False), _ack(Code.OK)


_ANSWERS: Final[dict[str, Any]] = {
    "hello": _hello, "start": _start, "stop": _stop, "begin": _begin, "write": _write,
    "verify": _verify, "commit": _commit, "confirm": _confirm, "rollback": _rollback, "abort": _abort,
    "restart": _restart,
}  # fmt: skip
