"""A look at the map itself, now and then: a gate that is wrong must not hide a touch and say nothing.

Of the frames that the gate calls untouched, one in ``AUDIT_FRAMES`` is inferred all the same. If the network's map then
shows a strong touch, the gate is overruled: the frame is published with its map, the event ``gate_overruled`` says so,
and every frame is looked at until a map shows no strong touch any more. What a wrong gate can hide is thus a touch for
``AUDIT_FRAMES`` frames, or one that the network does not see either. Where rows are missing, which a gate needs more
than a network that learned without them, one in ``WITHOUT_ROWS`` is looked at.

How many pixels make a strong touch is known when the bundle is made: more than the network ever shows of an untouched
sheet. A bundle that does not say (``audit_pixels`` in gate.npz) is not looked after.
"""

from collections.abc import Mapping
from typing import Final, Protocol

import numpy as np
import numpy.typing as npt

from eitskin.errors import BundleError

AUDIT_FRAMES: Final = 50
"""Of so many untouched frames one is inferred: four a second at 200 frames/s, for 2 % of an inference a frame."""

WITHOUT_ROWS: Final = 4
"""The same while rows are missing: then the gates of random devices miss more of the light touches, beside the gap."""

STRONG_VALUE: Final = 0.5
"""A pixel above it is touched."""


def audit_pixels(arrays: Mapping[str, npt.NDArray[np.generic]] | None, n_pixels: int) -> int | None:
    """Return how many pixels make a strong touch, by a bundle's gate.npz, or None if it does not say.

    Args:
        arrays: Of gate.npz.
        n_pixels: Of a map.

    Raises:
        BundleError: It says nonsense.
    """
    if arrays is None or "audit_pixels" not in arrays:
        return None
    found = np.asarray(arrays["audit_pixels"])
    if found.size != 1 or found.dtype.kind not in "iu" or not 1 <= int(found.reshape(-1)[0]) <= n_pixels:
        raise BundleError(
            f"gate.npz: audit_pixels is {found.tolist()}, expected one whole number from 1 to {n_pixels}; make the "
            "bundle again with 'eitskin export'"
        )
    return int(found.reshape(-1)[0])


class Rows(Protocol):
    """Who knows whether rows are missing."""

    @property
    def lacks_rows(self) -> bool:
        """Whether some are filled in."""


class GateAudit:
    """Counts untouched frames and judges the maps of those that are looked at; allocates nothing a frame.

    Args:
        pixels: A map with at least so many pixels above ``STRONG_VALUE`` shows a strong touch; None to look at none.
        n_pixels: Of a map.
    """

    __slots__ = ("_above", "_pixels", "_since_look", "_suspicious", "overruled")

    def __init__(self, pixels: int | None, n_pixels: int) -> None:
        self._pixels = pixels
        self._above = np.zeros(n_pixels, dtype=np.bool_)
        self._since_look = 0
        self._suspicious = False
        self.overruled = 0
        """Frames in which a map overruled the gate so far."""

    def looks(self, rows: Rows | None) -> bool:
        """Return whether an untouched frame is to be inferred all the same; asked once for each of them.

        Args:
            rows: Knows whether some are missing; None where nobody does.
        """
        if self._pixels is None:
            return False
        self._since_look += 1
        each = AUDIT_FRAMES if rows is None or not rows.lacks_rows else WITHOUT_ROWS
        if self._suspicious or self._since_look >= each:
            self._since_look = 0
            return True
        return False

    def overrules(self, touch_map: npt.NDArray[np.float32]) -> bool:
        """Return whether the map of a frame that was to be looked at shows a strong touch.

        Args:
            touch_map: (pixels,) of a network; a projection's is scaled to 1 whatever it shows, and says nothing.
        """
        np.greater(touch_map, STRONG_VALUE, out=self._above)
        self._suspicious = self._pixels is not None and int(np.count_nonzero(self._above)) >= self._pixels
        self.overruled += self._suspicious
        return self._suspicious
