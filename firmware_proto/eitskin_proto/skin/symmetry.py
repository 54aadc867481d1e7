"""The mirror images of a skin: which of x, y and both take it onto itself, and what they do to the electrodes.

A skin whose ring is mirror-symmetric gives the same voltages, in another order, for the mirror image of a touch on the
mirror image of a bend; so a network need learn a quarter, or a half, of it. Whether it is so is computed from the
stated places, sizes and impedances of the electrodes. A disc is held against the same two mirrors.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.table import N_ELECTRODES
from eitskin_proto.skin.skin import Skin

SAME_MM = 1e-6
"""Places that differ by less are one."""


@dataclass(frozen=True, slots=True)
class Image:
    """One mirror image of a skin that is the skin itself: electrode k lies where ``electrodes[k]`` was."""

    x: bool
    """Whether x is mirrored (x -> length - x)."""
    y: bool
    """Whether y is mirrored."""
    electrodes: tuple[int, ...]
    """(16,) the image of each electrode; an involution."""


def images(skin: Skin) -> tuple[Image, ...]:
    """Return the images of a skin, itself first: four, two or one."""
    found = (_image(skin, x, y) for x, y in ((False, False), (True, False), (False, True), (True, True)))
    return tuple(image for image in found if image is not None)


def mirrored_arc_mm(skin: Skin, x: bool, y: bool) -> npt.NDArray[np.float64]:
    """Return the (16,) arc lengths of the mirror images of the electrodes' centres."""
    arc, perimeter = skin.arc_length_mm, skin.outline.perimeter_mm
    length, width = skin.outline.size_mm
    if x:  # the corner (0, 0) goes to (length, 0), and the way round turns
        arc = (perimeter / 2 if skin.outline.kind == "disc" else length) - arc
    if y:
        arc = (0.0 if skin.outline.kind == "disc" else -width) - arc
    return np.asarray(arc % perimeter)


def _image(skin: Skin, x: bool, y: bool) -> Image | None:
    perimeter = skin.outline.perimeter_mm
    apart = np.abs(mirrored_arc_mm(skin, x, y)[:, None] - skin.arc_length_mm)
    apart = np.minimum(apart, perimeter - apart)
    onto = apart.argmin(axis=1)
    if apart.min(axis=1).max() > SAME_MM or len(set(onto.tolist())) != N_ELECTRODES:
        return None
    for quantity in (skin.electrodes.size_mm, skin.electrodes.contact_impedance_ohm_m2):
        stated = quantity.nominal(N_ELECTRODES)
        if not np.allclose(stated[onto], stated, rtol=1e-9):
            return None
    return Image(x, y, tuple(onto.tolist()))
