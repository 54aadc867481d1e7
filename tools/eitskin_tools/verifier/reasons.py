"""Why a verdict is flagged, in the words of the message; nothing where it is not."""

from typing import Any

from eitskin.messaging.verified.message import CONTESTED, TIME, UNEXPLAINED
from eitskin_sim.verification.free.found import FreeVerdict
from eitskin_sim.verification.verdict import Verdict


def reason_of(verdict: Verdict[Any]) -> str:
    """Return why a verdict is flagged; of one that also is contested, that where physics explains the frame."""
    if not verdict.flagged:
        return ""
    if isinstance(verdict, FreeVerdict) and verdict.contested and verdict.p_value >= verdict.level:
        return CONTESTED
    return TIME if verdict.unfinished else UNEXPLAINED
