"""A look at the map itself, now and then: a gate that is wrong must not hide a touch and say nothing.

Of the frames that the gate calls untouched, one in ``AUDIT_FRAMES`` is inferred all the same. If the network's map then
shows a strong touch, the gate is overruled: the frame is published with its map, the event ``gate_overruled`` says so,
and every frame is looked at until a map shows no strong touch any more. What a wrong gate can hide is thus a touch for
``AUDIT_FRAMES`` frames, or one that the network does not see either.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.grid import N_PIXELS

AUDIT_FRAMES: Final = 50
"""Of so many untouched frames one is inferred: four a second at 200 frames/s, for 2 % of an inference a frame."""

STRONG_VALUE: Final = 0.5
STRONG_PIXELS: Final = 9
"""A map with at least so many pixels above the value, 10 mm square, shows a strong touch."""


class Watch:
    """Counts untouched frames and judges the maps of those that are looked at; allocates nothing a frame."""

    __slots__ = ("_above", "_since_look", "_suspicious", "overruled")

    def __init__(self) -> None:
        self._above = np.zeros(N_PIXELS, dtype=np.bool_)
        self._since_look = 0
        self._suspicious = False
        self.overruled = 0
        """Frames in which a map overruled the gate so far."""

    def looks(self) -> bool:
        """Return whether an untouched frame is to be inferred all the same; asked once for each of them."""
        self._since_look += 1
        if self._suspicious or self._since_look >= AUDIT_FRAMES:
            self._since_look = 0
            return True
        return False

    def overrules(self, touch_map: npt.NDArray[np.float32]) -> bool:
        """Return whether the map of a frame that was to be looked at shows a strong touch.

        Args:
            touch_map: (1350,) of a network; a projection's is scaled to 1 whatever it shows, and says nothing.
        """
        np.greater(touch_map, STRONG_VALUE, out=self._above)
        self._suspicious = int(np.count_nonzero(self._above)) >= STRONG_PIXELS
        self.overruled += self._suspicious
        return self._suspicious
