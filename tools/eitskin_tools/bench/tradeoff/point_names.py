"""Names beside the points of a picture, none over another name or point."""

from collections.abc import Sequence
from typing import Any, Final

POINTS_AWAY: Final = 4
"""Between a point and its name."""

PLACES: Final = (
    ("left", "bottom"),
    ("left", "top"),
    ("right", "bottom"),
    ("right", "top"),
    ("center", "bottom"),
    ("center", "top"),
)
"""Where a name's box is held by its point, the first that is free taken: right and above it, right and below, ..."""


def beside(axes: Any, points: Sequence[tuple[float, float]], names: Sequence[str], size: float = 7.0) -> list[Any]:
    """Write names beside points and return the texts, in the points' order.

    A name with no free place, or none inside the axes, stands right and above. The axes' limits, scales and place in
    the figure must be final.

    Args:
        axes: Of matplotlib.
        points: (x, y) in data units.
        names: One each.
        size: Of the letters, in points.
    """
    inside = axes.get_window_extent()
    here = axes.transData.transform(points)
    reach = POINTS_AWAY * axes.figure.dpi / 72.0
    taken = [(x - reach, y - reach, x + reach, y + reach) for x, y in here]
    found = []
    for point, name, own in zip(points, names, list(taken), strict=True):
        text = axes.annotate(name, point, fontsize=size, xytext=(0, 0), textcoords="offset points")
        others = [box for box in taken if box is not own]
        for held in (*PLACES, PLACES[0]):
            _hold(text, held)
            box = text.get_window_extent()
            within = inside.x0 < box.x0 and box.x1 < inside.x1 and inside.y0 < box.y0 and box.y1 < inside.y1
            if within and not any(_meet(box.extents, other) for other in others):
                break
        taken.append(tuple(text.get_window_extent().extents))
        found.append(text)
    return found


def _hold(text: Any, held: tuple[str, str]) -> None:
    """Move a text to where its box is held so."""
    across, along = held
    text.set_horizontalalignment(across)
    text.set_verticalalignment(along)
    sideways = {"left": POINTS_AWAY, "right": -POINTS_AWAY, "center": 0}[across]
    text.set_position((sideways, POINTS_AWAY if along == "bottom" else -POINTS_AWAY))


def _meet(one: Sequence[float], other: Sequence[float]) -> bool:
    return one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3]
