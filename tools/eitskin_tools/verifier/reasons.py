"""Why a verdict is flagged, in the words of the message; nothing where it is not."""

from eitskin.messaging.verified.message import CONTESTED, TIME, UNEXPLAINED
from eitskin_proto.skin.skin import Skin
from eitskin_sim.verification.free.effort import SEARCHED as FREE_SEARCHED
from eitskin_sim.verification.free.found import FreeVerdict
from eitskin_sim.verification.free.search import DOUBT
from eitskin_sim.verification.free.seen import left_out, too_small
from eitskin_sim.verification.units import SEARCHED, UnitTouch
from eitskin_sim.verification.verdict import Verdict
from eitskin_tools.verifier.letters import Array


def of_units(verdict: Verdict[UnitTouch], budget_s: float) -> str:
    """Return why a verdict on units is flagged.

    Args:
        verdict: The verdict.
        budget_s: What it might take.
    """
    if not verdict.flagged:
        return ""
    return TIME if verdict.seconds >= SEARCHED * budget_s else UNEXPLAINED


def of_shapes(verdict: FreeVerdict, shares: Array, skin: Skin, budget_s: float) -> str:
    """Return why a verdict on touches anywhere is flagged.

    Args:
        verdict: The verdict.
        shares: (n, rows, columns) of the network's map.
        skin: Whose frame.
        budget_s: What it might take.
    """
    if not verdict.flagged:
        return ""
    late = verdict.seconds >= FREE_SEARCHED * budget_s
    if verdict.p_value < verdict.level:
        return TIME if late else UNEXPLAINED
    return TIME if late and not _contradicted(verdict, shares, skin) else CONTESTED


def _contradicted(verdict: FreeVerdict, shares: Array, skin: Skin) -> bool:
    """Return whether most of the belief lacks a touch that the network plainly shows, or has one that is too small."""
    least_mm = skin.touches.size_mm[0]
    against = sum(
        share for share, pieces in verdict.likely if left_out(pieces, shares, skin.grid) or too_small(pieces, least_mm)
    )
    return against > DOUBT
