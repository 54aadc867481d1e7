"""Signals that are met otherwise for a while."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


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
