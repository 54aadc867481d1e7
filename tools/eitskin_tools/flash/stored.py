"""What a device holds: the configuration that runs, the one beside it, and what becomes of either."""

from dataclasses import dataclass

from eitskin.errors import SkinError
from eitskin_proto.wire import messages
from eitskin_proto.wire.codes import Code, HelloFlag, Slot
from eitskin_proto.wire.config import BLOB_BYTES, Configuration
from eitskin_tools.flash.exchange import Exchange, Refused


class FlashError(SkinError):
    """Flashing failed; the text says which configuration the device is left with."""


@dataclass(frozen=True, slots=True)
class Stored:
    """A configuration as a device holds it."""

    configuration: Configuration
    generation: int


@dataclass(frozen=True, slots=True)
class Shown:
    """What a device says about itself and its configurations."""

    hello: messages.Hello
    active: Stored
    other: Stored | None
    """What the other slot holds; None if that counts for nothing."""
    revoked: bool = False
    """Whether the active one was rolled back and only runs until the restart."""
    being_written: bool = False
    """Whether somebody writes the other slot."""

    @property
    def active_state(self) -> str:
        """What becomes of the active configuration, for people."""
        if self.hello.flags & HelloFlag.FACTORY:
            return "running, built in"
        if self.revoked:
            return "running, rolled back: the next boot runs the other"
        return "running, on trial" if self.hello.flags & HelloFlag.TRIAL else "running, confirmed"

    @property
    def other_state(self) -> str:
        """What may become of the other one, for people. Only the newest can be unconfirmed (SPEC.md, section 6)."""
        if self.being_written:
            return "being written"
        if self.other is None:
            return "nothing to go back to: empty, rolled back or not intact"
        if self.revoked:
            return "confirmed: the next boot runs it"
        if self.other.generation < self.active.generation:
            return "confirmed: a rollback returns to it"
        if self.hello.flags & HelloFlag.ROLLED_BACK:
            return "not confirmed: its trial was given up, or the next boot tries it"
        return "not confirmed: the next boot tries it"


def read_stored(exchange: Exchange, slot: int) -> tuple[int, bytes]:
    """Return generation and blob of a slot.

    Raises:
        Refused: Nothing is stored there.
        FlashError: Its generation changed meanwhile.
    """
    pieces = [
        exchange.read(slot, at, min(messages.CHUNK_BYTES, BLOB_BYTES - at))
        for at in range(0, BLOB_BYTES, messages.CHUNK_BYTES)
    ]
    generations = {piece.generation for piece in pieces}
    if len(generations) > 1:
        raise FlashError(f"slot {slot} changed while it was read, from generation to generation {sorted(generations)}")
    return generations.pop(), b"".join(piece.data for piece in pieces)


def show(exchange: Exchange) -> Shown:
    """Return what the device runs, and what it could go back to.

    Raises:
        FlashError: What is stored is not what HELLO names.
    """
    hello = exchange.hello()
    generation, blob = read_stored(exchange, Slot.ACTIVE)
    active = Configuration.from_blob(blob)
    if generation not in (hello.generation, 0) or active.digest != hello.configuration_digest:
        raise FlashError(
            f"the device runs generation {hello.generation}, digest {hello.configuration_digest:08x}, but CONFIG_READ "
            f"gave generation {generation}, digest {active.digest:08x}: was it flashed meanwhile? Try again"
        )
    other, other_generation = None, None
    try:
        other_generation, other_blob = read_stored(exchange, Slot.OTHER)
    except Refused as error:
        if error.ack.code != Code.NO_PREVIOUS:
            raise
    if other_generation:
        other = Stored(Configuration.from_blob(other_blob), other_generation)
    return Shown(
        hello,
        Stored(active, hello.generation),
        other,
        revoked=generation == 0 != hello.generation,
        being_written=other_generation == 0,
    )
