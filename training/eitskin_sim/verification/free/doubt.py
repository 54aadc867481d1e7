"""Where the network contradicts what explains a frame, and who is believed.

Physics has seen the network's touches first, and left them. Where its own explain the frame and the network's cost much
more however they are moved, nothing is left to doubt.
"""

from typing import Final

from eitskin_sim.scene.touch_table import Array
from eitskin_sim.verification.free.effort import Effort
from eitskin_sim.verification.free.fit import Fit
from eitskin_sim.verification.free.found import Likely, explained
from eitskin_sim.verification.free.improve import IMPOSSIBLE, SURER, fitted
from eitskin_sim.verification.free.seen import left_out, too_small
from eitskin_sim.verification.free.starts import starts_of, tries_of

DOUBT: Final = 0.5
"""Share of belief beyond which what contradicts the touches counts."""


def contested(fit: Fit, every: Likely, shares: Array, effort: Effort) -> bool:
    """Return whether most of what is believed lacks a touch that the network plainly shows, or has one too small.

    A gentle touch answers as a hard one that is smaller than any; at its own contrast it has its size.

    Args:
        fit: Of a frame.
        every: Its touches, and those of other contrasts that explain the frame as well.
        shares: (n, rows, columns) of the network's map, what each of its touches has of every pixel.
        effort: Of the frame.
    """
    grid, least_mm = fit.frame.model.skin.grid, fit.frame.model.skin.touches.size_mm[0]
    small = [too_small(pieces, least_mm) for _, pieces in every]
    lacking = [left_out(pieces, shares, grid) for _, pieces in every]

    def share_of(wrong: list[bool]) -> float:
        return sum(share for (share, _), one in zip(every, wrong, strict=True) if one)

    if share_of([one or other for one, other in zip(small, lacking, strict=True)]) <= DOUBT:
        return False
    return share_of(small) > DOUBT or not _surer(fit, shares, effort)


def _surer(fit: Fit, shares: Array, effort: Effort) -> bool:
    """Return whether a fit explains its frame, and so much better than what the network shows, of usual contrast."""
    if not explained(fit) or effort.searched():
        return False
    shown = starts_of(shares, fit.frame.model.skin.grid)
    usual = tries_of(shown, None, fit.frame.usual)[0] if len(shown) else shown
    try:
        other = fitted(fit.frame, usual, bool(usual[:, 5].any()), effort, effort.searched)
    except IMPOSSIBLE:
        return False
    return other.cost > fit.cost + SURER
