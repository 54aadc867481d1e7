"""Which touches a data set draws: by name, or as the skin's description says.

``hard`` are the paper's, contrast 20 to 200 and sharp; ``firm`` are such as good conductors make on a sheet of a lab,
contrast 5 to 200 with edges of up to 4 mm. ``press``, ``raise`` and ``both`` have the ranges that measured presses of
hydrogel skins have. ``skin`` takes directions, contrasts, sizes and borders from ``[touches]``; where these have all
sizes of hard touches, half of those that raise conductance have their shapes too.
"""

from dataclasses import dataclass
from typing import Final, Literal, get_args

from eitskin_proto.skin import touch_kind as ways
from eitskin_proto.skin.skin import Skin
from eitskin_sim.freeform.patterns import LARGEST_MM, SMALLEST_MM
from eitskin_sim.scene.soft_touch import LEAST_BORDER_MM

TouchKind = Literal["hard", "firm", "press", "raise", "both", "skin"]
"""The paper's touches; those of good conductors on a sheet of a lab; presses that lower conductance; touches that raise
it; both ways; as the skin says."""

TOUCH_KINDS: Final[tuple[TouchKind, ...]] = get_args(TouchKind)

WAYS: Final[dict[str, ways.TouchKind]] = {
    "hard": "raise",
    "firm": "raise",
    "raise": "raise",
    "press": "lower",
    "both": "both",
}
"""Kind of touches that were drawn -> which way they change conductance; the skin's own go the skin's way."""

LARGEST_SHARE: Final = 0.7
"""Of the sheet's shorter side that a touch may take."""

USUAL_SHARP: Final = 0.25

Range = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Ranges:
    """What touches are drawn from."""

    way: ways.TouchKind
    lowering: Range = (0.2, 0.85)
    """Contrasts of those that lower conductance, log-uniform over classes."""
    raising: Range = (1.2, 200.0)
    """Contrasts of those that raise it."""
    sizes_mm: Range = (8.0, 25.0)
    """Of discs' diameters, ellipses' axes, rectangles' sides."""
    borders_mm: Range = (LEAST_BORDER_MM, 8.0)
    """Widths of graded borders; none are graded where the upper one is too little for that."""
    sharp: float = USUAL_SHARP
    """Share of the borders that are sharp."""
    hard_shapes: bool = True
    """Whether half of those that raise conductance have the sharp shapes of hard touches, of any size."""


FIRM: Final = Ranges("raise", raising=(5.0, 200.0), borders_mm=(LEAST_BORDER_MM, 4.0))
"""Of ``firm``."""


def ranges_of(kind: str, skin: Skin) -> Ranges:
    """Return what touches of a kind are drawn from on a skin.

    Raises:
        ValueError: There are no such touches, or the skin's do not fit on its sheet.
    """
    if kind not in TOUCH_KINDS:
        raise ValueError(f"touches {kind!r} are unknown; expected one of {', '.join(TOUCH_KINDS)}")
    if kind == "firm":
        return FIRM
    if kind != "skin":
        return Ranges(WAYS[kind])
    said = skin.touches
    low, high = said.size_mm
    most = LARGEST_SHARE * min(skin.outline.size_mm)
    if low > most:
        raise ValueError(f"[touches] size_mm begins at {low:g}, expected at most {most:g} on this sheet")
    soft = max(said.border_mm[0], LEAST_BORDER_MM), max(said.border_mm[1], LEAST_BORDER_MM)
    sharp = 1.0 if said.border_mm[1] < LEAST_BORDER_MM else 0.0 if said.border_mm[0] >= LEAST_BORDER_MM else USUAL_SHARP
    sizes, shapes = (low, min(high, most)), low <= SMALLEST_MM and high >= LARGEST_MM
    return Ranges(skin.touch_kind, said.lowering_contrast, said.raising_contrast, sizes, soft, sharp, shapes)
