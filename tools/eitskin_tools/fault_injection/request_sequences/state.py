"""What a device is, as a value: two slots, a session, a trial; and what a boot and silence leave of it (SPEC.md, 6)."""

from typing import Final, NamedTuple

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
