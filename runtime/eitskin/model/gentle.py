"""Touches that a network hardly shows are drawn by another one, which knows what a frame allows of those alone.

A touch of 10 mm that doubles the conductance answers as one of 6 mm that raises it fifty times: the frame tells the
product of size and contrast, as long as a touch is small. A network that learned hard touches draws the second one,
and one that learned both draws hard ones worse (decision 137). So the bundle's own network answers first. Where nothing
that it shows fills a window of 15 mm, a second one, which learned all contrasts alike, takes its place ::

    shown = most of the touched area of the map in any window, mm2

              SURE[1] <= shown                         the own map
    SURE[0] <  shown  <  SURE[1]                       both, each by its share
    NOTHING <= shown  <= SURE[0]                       the gentle network's map
               shown  <  NOTHING                       the own map, with no touch in it

A frame with a firm touch costs sums over the map besides, 20 us; one with faint touches alone costs both networks.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin.model.buffers import Engine
from eitskin_proto.skin.skin import Skin

WINDOW_MM: Final = 15.0
"""Side of the window: a touch of 10 mm between pixels lies in it."""

SURE: Final = (65.0, 85.0)
"""Bounds of what is shown, mm2: a touch of 10 mm has 100."""

NOTHING: Final = 1.0
"""Less than so many mm2 is no touch."""

Map = npt.NDArray[np.float32]


class GentleEngine:
    """A network's head, and another one's for frames in which it shows faint touches alone.

    Args:
        own: The first; frames are called by its name.
        gentle: The second, which fills the same map.
        whole: (1, pixels) that map.
        skin: Whose map it is.
    """

    __slots__ = ("_across", "_down", "_first", "_gentle", "_map", "_pixel_mm2", "name", "own")

    def __init__(self, own: Engine, gentle: Engine, whole: Map, skin: Skin) -> None:
        self.name = own.name
        self.own, self._gentle = own, gentle
        rows, columns = skin.grid.shape
        width_mm, height_mm = skin.grid.size_mm
        self._map = whole.reshape(rows, columns)
        self._first = np.empty_like(self._map)
        self._pixel_mm2 = width_mm * height_mm / (rows * columns)
        self._down = _Windows(self._map, round(WINDOW_MM * rows / height_mm), 0)
        self._across = _Windows(self._down.found, round(WINDOW_MM * columns / width_mm), 1)

    def shown_mm2(self) -> float:
        """Return the most of the touched area that the map has in any window."""
        self._down.add_up()
        self._across.add_up()
        return float(self._across.found.max()) * self._pixel_mm2

    def infer_both(self) -> None:
        """Do all that a frame may take, whatever the map shows."""
        self.own.infer()
        self._gentle.infer()
        self.shown_mm2()

    def infer(self) -> None:
        """Fill the map."""
        self.own.infer()
        shown = self.shown_mm2()
        if not NOTHING <= shown < SURE[1]:
            return
        np.copyto(self._first, self._map)
        self._gentle.infer()
        share = (shown - SURE[0]) / (SURE[1] - SURE[0])
        if share > 0.0:
            self._map *= 1.0 - share
            self._first *= share
            self._map += self._first


class _Windows:
    """Sums over every window along one axis, in memory of their own."""

    __slots__ = ("_after", "_axis", "_from", "_to", "_values", "found")

    def __init__(self, values: Map, window: int, axis: int) -> None:
        self._values, self._axis = values, axis
        window = min(max(window, 1), values.shape[axis])
        shape = list(values.shape)
        shape[axis] += 1
        sums = np.zeros(shape, dtype=np.float32)
        along = sums if axis == 0 else sums.T
        parts = along[1:], along[:-window], along[window:]
        self._after, self._from, self._to = parts if axis == 0 else tuple(part.T for part in parts)
        self.found: Map = np.empty(self._to.shape, dtype=np.float32)

    def add_up(self) -> None:
        """Bring the sums up to date."""
        np.cumsum(self._values, axis=self._axis, out=self._after)
        np.subtract(self._to, self._from, out=self.found)
