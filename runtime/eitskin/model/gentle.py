"""A second network, trained on all contrasts alike, draws touches that the first one hardly shows or shows too small.

A touch of 10 mm that doubles the conductance answers as one of 6 mm that raises it fifty times: the frame tells the
product of size and contrast, as long as a touch is small. A network that learned hard touches draws the second one,
and one that learned both draws hard ones worse. So the bundle's own network answers first, and a second
one where that shows nothing large. A touch of 20 mm that doubles the conductance is shown as 12 mm, with edges that are
wide for a touch of that size. Where edges are, the second one is asked as well, and where it shows much more than the
first, the touch is gentle ::

    shown = most of the touched area of the map in any window, mm2        edges = how wide they are, pixels
    more  = area of the gentle network's map over that of the own one

    share of the gentle map = the larger one of
        faint   1 where shown <= SHOWN_BOUNDS_MM2[0], 0 from SHOWN_BOUNDS_MM2[1] on
        broad   1 where edges are wide and more is above what hard touches have, 0 where either is not so

There is no jump between 0 and 1. Where shown < MIN_TOUCH_MM2 the own map stays, with no touch in it. A frame of firm
touches with sharp edges also costs sums over the map, 40 us; others cost both networks.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin.model.buffers import Engine
from eitskin_proto.skin.skin import Skin

WINDOW_MM: Final = 15.0
"""Side of the window, which holds a touch of 10 mm between pixels."""

SHOWN_BOUNDS_MM2: Final = (65.0, 85.0)
"""Bounds of what is shown, mm2: a touch of 10 mm has 100."""

MIN_TOUCH_MM2: Final = 1.0
"""Smallest area of a touch, mm2."""

EDGES_PX: Final = (0.26, 0.30)
"""Bounds of an edge's width: hard touches of 10 to 20 mm have 0.22 to 0.24, gentle ones of 20 mm 0.4."""

FIRM_GROWTH: Final = ((115.0, 140.0), (2.0, 1.35))
"""How much larger the gentle network shows hard touches at most, by what is shown, mm2: small ones as what they may be
besides, large ones as they are."""

WIDE_EDGE: Final = ((0.5, 0.7), 1.1)
"""Bounds of an edge's width from where on that is no more than this: no hard touches but some on bumps have such edges,
gentle ones of 30 mm have 0.75."""

RAMP: Final = 0.3
"""About that, from where the own map is all that is drawn to where it is the gentle one."""

Map = npt.NDArray[np.float32]


class GentleEngine:
    """A network's head, and another one's for frames in which it shows faint touches, or gentle ones too small.

    Args:
        own: The first; frames are called by its name.
        gentle: The second, which fills the same map.
        whole: (1, pixels) that map.
        skin: Whose map it is.
        asks: Whether the second is asked about touches that are large already; a head that is there for its speed does
            not wait for it.
    """

    __slots__ = ("_across", "_asks", "_down", "_first", "_gentle", "_map", "_pixel_mm2", "name", "own")

    def __init__(self, own: Engine, gentle: Engine, whole: Map, skin: Skin, *, asks: bool = True) -> None:
        self.name = own.name
        self.own, self._gentle, self._asks = own, gentle, asks
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
        self.shown_mm2()
        edges_px(self._map)
        self._gentle.infer()

    def infer(self) -> None:
        """Fill the map."""
        self.own.infer()
        shown = self.shown_mm2()
        if not shown >= MIN_TOUCH_MM2:  # a map that is not finite stays so, and is withheld
            return
        faint = 1.0 - _ramp(shown, SHOWN_BOUNDS_MM2)
        edges = edges_px(self._map) if self._asks and faint < 1.0 else 0.0
        wide = _ramp(edges, EDGES_PX)
        if not (faint or wide):
            return
        np.copyto(self._first, self._map)
        self._gentle.infer()
        share = max(faint, wide * self._broad(shown, edges)) if wide else faint
        if share < 1.0:
            self._map *= share
            self._first *= 1.0 - share
            self._map += self._first

    def _broad(self, shown: float, edges: float) -> float:
        """Return 1 where the gentle network shows more than it does of hard touches, 0 where it does not."""
        own_mm2 = max(float(self._first.sum()) * self._pixel_mm2, shown)
        more, likely = float(self._map.sum()) * self._pixel_mm2 / own_mm2, float(np.interp(shown, *FIRM_GROWTH))
        likely += (WIDE_EDGE[1] - likely) * _ramp(edges, WIDE_EDGE[0])
        return _ramp(more, (likely - RAMP / 2, likely + RAMP / 2))


def edges_px(values: Map) -> float:
    """Return how wide the edges of a (rows, columns) map of touches are, in pixels; 0 if it has none.

    Across an edge from 0 to 1 steps of x add up to 1 and x (1 - x) to its width, of 1 / (1 + exp(-n / w)) to w, however
    long it is.
    """
    across = values[:-1, 1:] - values[:-1, :-1]
    down = values[1:, :-1] - values[:-1, :-1]
    steps = float(np.sqrt(across * across + down * down).sum())
    return float((values * (1.0 - values)).sum()) / steps if steps > 0.0 else 0.0


def _ramp(value: float, bounds: tuple[float, float]) -> float:
    """Return 0 up to the first bound, 1 from the second on, and linear between."""
    return min(max((value - bounds[0]) / (bounds[1] - bounds[0]), 0.0), 1.0)


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
