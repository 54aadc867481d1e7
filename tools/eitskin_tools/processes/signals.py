"""Signals that are met otherwise: for a while, or until the process ends."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any


class Stopped(BaseException):
    """The process was told to end; no Exception, so that nothing on the way out takes it for a fault."""


def stop_when_told() -> None:
    """Let SIGINT and SIGTERM raise :class:`Stopped`, each of them once."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _stop)


def _stop(number: int, frame: FrameType | None) -> None:
    signal.signal(number, signal.SIG_IGN)
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
