"""Skins of every set of mirror images: four, one of each kind beside the skin itself, none."""

from collections.abc import Iterable

from tests.second_skin import SECOND

from eitskin_proto.skin.parts import Map, Outline, Ring
from eitskin_proto.skin.quantity import Quantity
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.scene.parts import Electrodes, Sheet


def skin(name: str, size_mm: tuple[float, float], arcs_mm: Iterable[float], of: Map) -> Skin:
    """Return a skin with electrodes at arc lengths that may be negative."""
    perimeter = 2 * sum(size_mm)
    arcs = tuple(sorted(arc % perimeter for arc in arcs_mm))
    return Skin(name=name, outline=Outline(size_mm=size_mm), electrodes=Ring(arc_length_mm=Quantity(arcs)), map=of)


_HALF = [15.0 + 38.0 * k for k in range(8)]
_UNEVEN = [5.0 + 38.75 * k + 5.0 * (k % 3) for k in range(16)]

SKINS = {
    "four, odd rows and columns": skin("four", (96.0, 72.0), [6.0 + 21.0 * k for k in range(16)], Map((9, 15), (3, 5))),
    "x": skin("x", (220.0, 90.0), [110.0 + s * d for d in _HALF for s in (1, -1)], Map((18, 45), (9, 15))),
    "y": skin("y", (220.0, 90.0), [-45.0 + s * d for d in _HALF for s in (1, -1)], Map((9, 24), (3, 8))),
    "both at once": SECOND,
    "both at once, odd": skin("odd", (220.0, 90.0), SECOND.arc_length_mm, Map((9, 15), (3, 5))),
    "none": skin("none", (220.0, 90.0), _UNEVEN, Map((12, 30), (4, 10))),
}
"""Skins that are not the paper's, by which of x and y may be mirrored."""

ALL = {"paper": PAPER, **SKINS}


def built(of: Skin) -> tuple[Sheet, Electrodes]:
    """Return the sheet and the electrodes of a skin."""
    return Sheet(size_mm=of.outline.size_mm), Electrodes(arc_length_mm=tuple(of.arc_length_mm.tolist()))
