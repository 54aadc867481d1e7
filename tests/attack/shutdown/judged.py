"""What was wrong with the end of a runtime that was told to end."""

import signal
from typing import Final

from .exit_time import MOST_S, ExitTime

LAST: Final = 700
"""Characters of what it said last that are shown."""

WRONG: Final = ("Traceback", "terminate called", "Fatal Python", "Assertion", "Exception ignored")


def judge(life: str, number: int, status: int, took: ExitTime, text: str) -> str:
    """Return what was wrong with an end; nothing if all was well."""
    last = text.strip()[-LAST:]
    if took.own_s > MOST_S:
        return f"it took {took.own_s:.2f} s of its own, {took.raw_s:.2f} by the clock"
    if _interrupted_early(number, status, text) or (status == -number and "firmware" not in text and not _wrong(text)):
        return ""  # it had opened nothing yet
    if _wrong(text):
        return f"it said: {last}"
    if status != 0:
        return f"its exit status was {status}: {last}"
    if life != "start" and '"frames"' not in text:
        return f"it printed no summary: {last}"
    return ""


def _wrong(text: str) -> bool:
    return any(word in text for word in WRONG)


def _interrupted_early(number: int, status: int, text: str) -> bool:
    """Return whether Ctrl-C met Python while it started, whose own ways hold until ``eitskin run`` has begun."""
    if number != signal.SIGINT:
        return False
    return (status == 128 + number and not text) or ("KeyboardInterrupt" in text and "live/run.py" not in text)
