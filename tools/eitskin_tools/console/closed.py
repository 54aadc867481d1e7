"""Standard streams that whoever started us had closed, as ``eitskin run ... 2>&-`` does.

Python then has None in their place, and what is opened next gets their number: a library's warning would go down the
line to a device. So /dev/null takes the place of each before anything else is opened.
"""

import os
import sys
from typing import Final

STREAMS: Final = {0: ("stdin", "r"), 1: ("stdout", "w"), 2: ("stderr", "w")}
"""File descriptor -> name in ``sys``, and how it is opened."""


def replace_closed() -> None:
    """Put /dev/null in place of every standard stream that was closed."""
    for number, (name, mode) in STREAMS.items():
        if getattr(sys, name) is not None:
            continue
        handle = os.open(os.devnull, os.O_RDWR)  # the lowest number that is free: mostly the stream's own
        if handle != number and _free(number):
            os.dup2(handle, number)
            os.close(handle)
            handle = number
        setattr(sys, name, open(handle, mode, encoding="utf-8", closefd=False))  # noqa: SIM115 -- as long as we run


def _free(number: int) -> bool:
    try:
        os.fstat(number)
    except OSError:
        return True
    return False
