"""Why a verdict is flagged, in the words of the message; nothing where it is not."""

from typing import Any

from eitskin.messaging.streams.verified import TIME, UNEXPLAINED
from eitskin_sim.verification.verdict import Verdict


def reason_of(verdict: Verdict[Any]) -> str:
    """Return why a verdict is flagged."""
    if not verdict.flagged:
        return ""
    return TIME if verdict.unfinished else UNEXPLAINED
