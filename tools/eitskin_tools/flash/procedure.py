"""Show, write, verify and roll back a device's configuration, so that it always runs the old one or the new one.

::

    check on the host -> begin -> chunks -> verify -> read back -> commit -> restart -> hello -> confirm
    ------ the old configuration is untouched ------------------>| on trial ----------------->| the new one

Whatever fails before ``confirm``, the device goes back by itself: at the next boot, or after 30 s on trial.
"""

import secrets
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Final

from eitskin.acquisition.transport import Transport
from eitskin.errors import SkinError, TransportError
from eitskin_proto.wire import messages
from eitskin_proto.wire.codes import Code, HelloFlag, Slot
from eitskin_proto.wire.config import BLOB_BYTES, FORMAT, Configuration
from eitskin_proto.wire.hardware import name_of
from eitskin_tools.flash.exchange import Exchange, Refused, Silent


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
    """Whether the other slot is being written."""

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
            return "not confirmed: it failed its trial, or the next boot tries it"
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
            f"gave generation {generation}, digest {active.digest:08x}: was it flashed in the meantime? Try again"
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


BOOT_TIMEOUT_S: Final = 10.0
"""A device that has not come back by then is reported; it goes back to the old configuration by itself."""

BOOT_TRIES: Final = 200
"""One in 0.05 s; a device that talks without end would else be asked as fast as it answers."""

UNCHANGED: Final = "the device keeps its old configuration"
STATE_AFTER: Final = {
    **dict.fromkeys(("begin", "write", "verify"), UNCHANGED),
    **dict.fromkeys(("commit", "restart"), f"{UNCHANGED}, or tries the new one when it boots and goes back by itself"),
    "boot": "the device goes back to its old configuration by itself, 30 s after its restart",
    "confirm": "the device goes back to its old configuration by itself within 30 s, if it did not confirm the new one",
    "done": "the device runs the new configuration",
}
"""What an interrupted :func:`write` leaves, by the step that was begun last."""

Progress = Callable[[str], None]
"""Called with the name of the step that begins."""


def differences(old: Configuration, new: Configuration) -> list[tuple[str, object, object]]:
    """Return (field, old, new) of every field that differs."""
    before, after = old.published(), new.published()
    return [(name, before[name], after[name]) for name in before if before[name] != after[name]]


def check(hello: messages.Hello, configuration: Configuration, host_bytes_per_s: int = 0) -> None:
    """Refuse what this device cannot run.

    Args:
        hello: What the device said, with what its line carries.
        configuration: What it is to run.
        host_bytes_per_s: What the host's end of the line carries; 0 if it is no limit.

    Raises:
        FlashError: Made for other hardware.
        ValueError: A value or a rate that electronics or line cannot reach; the largest that works is given.
    """
    if configuration.hardware_id != hello.hardware_id:
        names = [name_of(configuration.hardware_id), name_of(hello.hardware_id)]
        raise FlashError(
            f"configuration {configuration.name!r} is for {names[0]}, the device is {names[1]}: nothing was written"
        )
    configuration.check(min((line for line in (hello.line_bytes_per_s, host_bytes_per_s) if line), default=0))


def write(
    exchange: Exchange,
    configuration: Configuration,
    *,
    allow_downgrade: bool = False,
    progress: Progress = lambda step: None,
    reopen: Callable[[], Transport] | None = None,
) -> Stored:
    """Flash a configuration and return it as the device holds it afterwards.

    Args:
        exchange: An open line to the device.
        configuration: What to write.
        allow_downgrade: Write even a lower revision of the same name.
        progress: Called with every step.
        reopen: Opens the line again if it vanishes with the restart.

    Raises:
        FlashError: It failed; the text says which configuration the device has.
        Refused: The device refused before anything changed.
    """
    hello = exchange.hello()
    check(hello, configuration, exchange.transport.line_bytes_per_s)
    if hello.flags & HelloFlag.STREAMING:
        exchange.command(messages.Stop)
    blob, token = configuration.to_blob(), secrets.randbelow(0xFFFFFFFF) + 1
    pieces = range(0, len(blob), messages.CHUNK_BYTES)
    progress("begin")
    exchange.command(
        messages.ConfigBegin, token=token, size=len(blob), digest=configuration.digest, format=FORMAT,
        hardware_id=configuration.hardware_id, revision=configuration.revision, name=configuration.name,
        allow_downgrade=int(allow_downgrade),
    )  # fmt: skip
    try:
        progress("write")
        for at in pieces:
            piece = blob[at : at + messages.CHUNK_BYTES]
            written = exchange.command(messages.ConfigWrite, token=token, offset=at, data=piece).detail
            if written != at + len(piece):
                raise FlashError(f"the device reports {written} bytes, expected {at + len(piece)}")
        progress("verify")
        found = exchange.command(messages.ConfigVerify, token=token).detail
        if found != configuration.digest:
            raise FlashError(f"the device found digest {found:08x}, expected {configuration.digest:08x}")
        _, read_back = read_stored(exchange, Slot.OTHER)
        if read_back != blob:
            raise FlashError("the device stored other bytes than were sent")
        progress("commit")
        generation = exchange.command(messages.ConfigCommit, token=token, digest=configuration.digest).detail
    except (SkinError, KeyboardInterrupt) as error:
        with suppress(SkinError):  # without it the device would refuse others for ten seconds
            exchange.command(messages.ConfigAbort, token=token)
        if isinstance(error, KeyboardInterrupt):
            raise
        raise FlashError(f"{error}; {UNCHANGED}") from error
    progress("restart")
    try:
        restart(exchange, token)
    except SkinError as error:
        raise FlashError(
            f"{error}; the next boot tries the new configuration, the one after that rolls back"
        ) from error
    _confirm(exchange, generation, configuration.digest, progress, reopen)
    return Stored(configuration, generation)


def restart(exchange: Exchange, token: int) -> None:
    """Tell the device to restart; a lost answer is no failure, since what it boots is looked at afterwards."""
    try:
        exchange.command(messages.Restart, token=token)
    except Refused as error:
        if error.ack.code != Code.NO_SESSION:  # which is what a device says that has restarted already
            raise
    except (Silent, TransportError):
        return


def _confirm(
    exchange: Exchange,
    generation: int,
    digest: int,
    progress: Progress,
    reopen: Callable[[], Transport] | None,
) -> None:
    progress("boot")
    hello = wait_for_boot(exchange, generation, reopen)
    if (hello.generation, hello.configuration_digest) != (generation, digest):
        raise FlashError(
            f"the device came back with generation {hello.generation} ({hello.configuration_name!r}), expected "
            f"{generation}: it rolled back to its old configuration"
        )
    progress("confirm")
    try:
        exchange.command(messages.ConfigConfirm, generation=generation, digest=digest)
    except SkinError as error:
        raise FlashError(f"{error}; the device rolls back to its old configuration within 30 s") from error
    progress("done")


def wait_for_boot(exchange: Exchange, generation: int, reopen: Callable[[], Transport] | None = None) -> messages.Hello:
    """Return the HELLO of a restarted device.

    A HELLO of before the restart still shows the old generation; it is asked again until the generation is the
    expected one or the device says that it gave a trial up.

    Raises:
        FlashError: It does not come back.
    """
    deadline_s = time.perf_counter() + BOOT_TIMEOUT_S
    last: messages.Hello | None = None
    for _ in range(BOOT_TRIES):
        if time.perf_counter() >= deadline_s:
            break
        try:
            last = exchange.hello(attempts=1)
        except Silent:
            continue
        except TransportError:
            if reopen is None:
                raise
            time.sleep(0.1)  # a USB port takes a moment to come back; nothing can be waited on meanwhile
            with suppress(TransportError):
                exchange.replace(reopen())
            continue
        if last.generation == generation or last.flags & HelloFlag.ROLLED_BACK:
            return last
        exchange.transport.read(0.05)  # let it finish: it restarts within 20 ms of its answer
    if last is not None:
        return last
    raise FlashError(
        f"{exchange.transport.name} did not come back within {BOOT_TIMEOUT_S:.0f} s of the restart; switch it off and "
        "on: it then runs the old or the new configuration"
    )


def verify(exchange: Exchange, configuration: Configuration) -> list[tuple[str, object, object]]:
    """Return what differs between the device's active configuration and a file's: nothing if they agree."""
    exchange.hello()
    _, blob = read_stored(exchange, Slot.ACTIVE)
    return differences(Configuration.from_blob(blob), configuration)


def rollback(exchange: Exchange, reopen: Callable[[], Transport] | None = None) -> messages.Hello:
    """Return to the configuration from before and return the HELLO of then.

    Raises:
        FlashError: There is none, or the device did not come back.
    """
    shown = show(exchange)
    if shown.hello.flags & HelloFlag.STREAMING:
        exchange.command(messages.Stop)
    token = secrets.randbelow(0xFFFFFFFF) + 1
    try:
        exchange.command(messages.ConfigRollback, token=token, generation=shown.hello.generation)
    except Refused as error:
        if error.ack.code == Code.NO_PREVIOUS:
            raise FlashError("found no earlier configuration to roll back to; the active one stays") from error
        raise
    restart(exchange, token)
    expected = shown.other.generation if shown.other else 0
    hello = wait_for_boot(exchange, expected, reopen)
    if hello.generation != expected:
        raise FlashError(f"the device came back with generation {hello.generation}, expected {expected}")
    return hello
