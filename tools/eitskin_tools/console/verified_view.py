"""What ``eitskin subscribe --verified`` prints: a line a verdict, and a line where the verifier's state changes."""

from typing import Any, Final

from eitskin.messaging.verified.message import CONTESTED, TIME, UNEXPLAINED
from eitskin.touches.force import ForceTable

FLAGGED: Final = {
    UNEXPLAINED: "FLAGGED: physics cannot explain it by these",
    CONTESTED: "FLAGGED: the network plainly shows one that is not among these, or one is too small",
    TIME: "FLAGGED: not explained, or these not confirmed, when its time was over",
}
"""By why; an older runtime does not say why."""


def describe(found: Any, table: ForceTable | None = None) -> list[str]:
    """Return the lines of a verdict, or of how the verifier is.

    Args:
        found: :class:`eitskin.VerifiedFrame`.
        table: From strength to newtons, of the user's own.
    """
    if not found.verified:
        return [f"{found.sequence} not verified: {state_text(found.state, found.why)}"]
    said = FLAGGED.get(found.why, "FLAGGED") if found.flagged else "explained"
    behind_ms = (found.host_ns["end"] - found.host_ns["publish"]) * 1e-6
    head = (
        f"{found.sequence} {said}, p {found.p_value:.3g}, chi-squared {found.chi_squared:.1f} for "
        f"{found.degrees_of_freedom}, {len(found.touches)} touches, {found.spent_s * 1e3:.1f} ms, {behind_ms:.1f} ms "
        f"behind the frame; {found.counts['checked']} checked, {found.counts['flagged']} flagged, "
        f"{found.counts['skipped']} skipped"
    )
    return [head, *(f"{found.sequence}   {touch}{force_text(touch, table)}" for touch in found.touches)]


def force_text(touch: Any, table: ForceTable | None) -> str:
    """Return the force of a touch and its standard deviation, for the end of its line; nothing without a table.

    Args:
        touch: :class:`eitskin.VerifiedTouch`.
        table: From strength to newtons, of the user's own.
    """
    if table is None:
        return ""
    force = table.newtons(touch.strength_mm2, touch.strength_error_mm2 or 0.0)
    if force is None:
        return f", force unknown: the table is of {table.rows[0][0]:g} to {table.rows[-1][0]:g} mm2"
    more = " by the table alone" if touch.strength_error_mm2 is None else ""
    return f", force {force[0]:.2f} +- {force[1]:.2f} N{more}"


def state_text(state: str, why: str) -> str:
    """Return how a verifier is, in a few words."""
    words = {
        "starting": "the verifier starts",
        "preparing": "the model of the surface in use is being made",
        "ready": "the verifier is ready, with no new verdict",
        "waiting": "the verifier has ended",
        "failed": "the verifier cannot go on",
    }
    return words[state] + (f": {why}" if why else "")
