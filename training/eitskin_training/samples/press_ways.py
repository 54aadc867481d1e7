"""Which way recorded presses change conductance: each is held against the same press on the skin's model.

No row alone tells: pressed, some of them rise and others fall. So what a press changed, without what is common to all
rows, is compared with what a stamp that lowers conductance changes at that place. Where a press was elsewhere than it
is said to have been, the two have little to do with each other, and nothing is told.
"""

from typing import Final

import numpy as np

from eitskin_proto.errors import MismatchError, SkinError
from eitskin_proto.skin.skin import Skin
from eitskin_proto.skin.touch_kind import TouchKind, knows
from eitskin_sim.calibration.recording import Recording
from eitskin_sim.freeform.sheet import inverted_sheet
from eitskin_sim.freeform.voltages import set_voltages
from eitskin_sim.scene.parts import Bend
from eitskin_sim.scene.touch_table import gather
from eitskin_training.samples.presses import directions, piece, ratios, told

LOWERED: Final = 0.5
"""Contrast of the model's presses."""

SURE: Final = 0.5
"""Cosine of what was read and what the model reads: from here on the way is told."""


def check_ways(recording: Recording, skin: Skin, known: TouchKind, who: str) -> None:
    """Refuse presses that go opposite ways on a skin of one kind of touches, or a way that skin or bundle do not know.

    A skin's raising touches are not held against presses: its file also has them where it says nothing.

    Args:
        recording: With presses.
        skin: Whose sheet it is.
        known: Which touches the bundle knows.
        who: What to call the bundle.

    Raises:
        SkinError: Two contradict each other, or a row has turned its sign; in one line, with the presses.
        MismatchError: One goes a way that the bundle, or a skin whose touches lower conductance, does not know.
    """
    found = ways(recording, skin)
    lower, higher = ([k for k, way in enumerate(found) if way == one] for one in ("lower", "raise"))
    if lower and higher and skin.touch_kind != "both":
        fewer, more = sorted((lower, higher), key=len)
        one, other = ("lowers", "raises") if fewer is lower else ("raises", "lowers")
        raise SkinError(
            f"{told(recording, fewer[0])} {one} conductance and {told(recording, more[0])} {other} it; leave out the "
            f"one that is wrong, or say in the file of skin {skin.name} that touches do both: [touches] kind"
        )
    knowing: list[tuple[TouchKind, str]] = [(known, f"as {who} knows")]
    if skin.touch_kind == "lower":
        knowing.insert(0, ("lower", f"as [touches] of skin {skin.name} says"))
    hint = "take a bundle and a skin that know such, or leave --presses out"
    ways_of: list[tuple[list[int], TouchKind]] = [(lower, "lower"), (higher, "raise")]
    for numbers, way in ways_of:
        for kind, source in knowing if numbers else ():
            if not knows(kind, way):
                what = f"{told(recording, numbers[0])}: touches"
                raise MismatchError(what, found=way, expected=f"{kind}, {source}", hint=hint)


def ways(recording: Recording, skin: Skin) -> list[TouchKind | None]:
    """Return which way each press changed conductance; None where that cannot be told.

    Args:
        recording: With presses.
        skin: Whose sheet it is.

    Raises:
        SkinError: A row has turned its sign.
    """
    read, sheet = directions(ratios(recording)), inverted_sheet(Bend(), skin=skin)
    table = gather([piece(one, LOWERED) for one in recording.presses])
    lowered = directions(set_voltages([sheet], table, skin=skin)[0] / sheet.untouched_V)
    alike = np.sum(read * lowered, axis=1)
    return ["lower" if one > SURE else "raise" if one < -SURE else None for one in alike]
