"""Signals that request an end, and signals that are handled differently for a while."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any, Final

HANGUP: Final = getattr(signal, "SIGHUP", signal.SIGTERM)
"""What comes when a command's terminal is closed; Windows sends nothing then."""


def endings() -> tuple[signal.Signals, ...]:
    """Return the signals that ask a command to end: Ctrl-C, SIGTERM, and SIGHUP when its terminal is closed.

    The last one is left out where the parent process has it ignored, as ``nohup`` does.
    """
    asked = (signal.SIGINT, signal.SIGTERM)
    return asked if signal.getsignal(HANGUP) == signal.SIG_IGN else (*asked, HANGUP)


class EndRequested(KeyboardInterrupt):
    """SIGTERM or SIGHUP asked for an end, which is met as Ctrl-C is: what is half written is removed.

    Args:
        number: Of the signal.
    """

    def __init__(self, number: int) -> None:
        super().__init__()
        self.number = number


@contextmanager
def end_signals_as_interrupts() -> Iterator[None]:
    """Let SIGTERM and SIGHUP raise :class:`EndRequested` while the block lasts, and Ctrl-C a plain KeyboardInterrupt.

    Each once: a second one ends the process, because Python would raise it during the cleanup of the first. A signal
    that is ignored or has another handler stays as it is. A module in C that is interrupted while it loads raises an
    ImportError; the block then raises the interrupt in its place.
    """
    unmet = (signal.SIG_DFL, signal.default_int_handler)
    ours = [one for one in {signal.SIGINT, signal.SIGTERM, HANGUP} if signal.getsignal(one) in unmet]
    raised: list[KeyboardInterrupt] = []

    def interrupt_once(number: int, frame: FrameType | None) -> None:
        signal.signal(number, signal.SIG_DFL)
        raised.append(KeyboardInterrupt() if number == signal.SIGINT else EndRequested(number))
        raise raised[0]

    with met_by(interrupt_once, *ours):
        try:
            yield
        except ImportError as error:
            if raised:
                raise raised[0] from error
            raise


class Stopped(BaseException):
    """A request to end the process; not an Exception, so that no handler takes it for a fault."""


def raise_stopped_on_signals() -> None:
    """Let what asks for an end raise :class:`Stopped`, once."""
    for number in endings():
        signal.signal(number, stop)


def stop(number: int, frame: FrameType | None) -> None:
    """Raise :class:`Stopped`, as a handler; whatever asks once more is ignored."""
    for handled in endings():
        signal.signal(handled, signal.SIG_IGN)
    raise Stopped


@contextmanager
def met_by(handler: Any, *numbers: signal.Signals) -> Iterator[None]:
    """Meet some signals with a handler while the block lasts; outside the main thread, as before.

    Args:
        handler: As for :func:`signal.signal`: a function, ``SIG_IGN`` or ``SIG_DFL``.
        numbers: Which ones.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, one in before.items():
            signal.signal(number, one)
