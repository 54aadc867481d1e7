"""What ``eitskin subscribe --verified`` prints: a line a verdict, and a line where the verifier's state changes."""

from typing import Any


def describe(found: Any) -> list[str]:
    """Return the lines of a verdict, or of how the verifier is.

    Args:
        found: :class:`eitskin.VerifiedFrame`.
    """
    if not found.verified:
        return [f"{found.sequence} not verified: {state_text(found.state, found.why)}"]
    said = "FLAGGED: physics cannot explain it by these" if found.flagged else "explained"
    behind_ms = (found.host_ns["end"] - found.host_ns["publish"]) * 1e-6
    head = (
        f"{found.sequence} {said}, p {found.p_value:.3g}, chi-squared {found.chi_squared:.1f} for "
        f"{found.degrees_of_freedom}, {len(found.touches)} touches, {found.spent_s * 1e3:.1f} ms, {behind_ms:.1f} ms "
        f"behind the frame; {found.counts['checked']} checked, {found.counts['flagged']} flagged, "
        f"{found.counts['skipped']} skipped"
    )
    return [head, *(f"{found.sequence}   {touch}" for touch in found.touches)]


def state_text(state: str, why: str) -> str:
    """Return how a verifier is, in a few words."""
    words = {
        "starting": "the verifier starts",
        "preparing": "the model of the surface in use is being made",
        "ready": "nothing has changed since the last verdict",
        "waiting": "the verifier has ended",
        "failed": "the verifier cannot go on",
    }
    return words[state] + (f": {why}" if why else "")
