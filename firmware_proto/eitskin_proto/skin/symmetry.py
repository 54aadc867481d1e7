"""The mirror symmetries of a skin, in x, y and both, and how they permute the electrodes.

A skin whose ring is mirror-symmetric gives the same voltages, in another order, for the mirror image of a touch on the
mirror image of a bend; so a network need learn only a quarter, or a half, of it. The symmetry is computed from the
stated places, sizes and impedances of the electrodes. A disc is compared with the same two mirror images.

A ring that is off by millimetres is still nearly symmetric, because dividing by the untouched voltages removes most of
the effect of the electrodes' exact places. A network with such near symmetries has a quarter of the weights, and four
times the training data for each.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.table import N_ELECTRODES
from eitskin_proto.skin.skin import Skin

SAME_MM: Final = 1e-6
"""Places that differ by less are one."""

NEAR_MM: Final = 4.0
"""Places that differ by less are nearly one: each electrode of the paper's ring still covers its image's place."""


@dataclass(frozen=True, slots=True)
class Image:
    """A mirror symmetry of a skin: electrode k is mapped to the place of ``electrodes[k]``."""

    x: bool
    """Whether x is mirrored (x -> length - x)."""
    y: bool
    """Whether y is mirrored."""
    electrodes: tuple[int, ...]
    """(16,) the image of each electrode; an involution."""


MIRRORS: Final = ((False, False), (True, False), (False, True), (True, True))
"""Whether x, and whether y, is mirrored."""


def images(skin: Skin) -> tuple[Image, ...]:
    """Return the images of a skin, itself first: four, two or one."""
    found = (_image(skin, x, y, SAME_MM) for x, y in MIRRORS)
    return tuple(image for image in found if image is not None and _alike(skin, image))


def near_images(skin: Skin) -> tuple[Image, ...]:
    """Return the images that lie on the skin within ``NEAR_MM``, whatever the electrodes' sizes and impedances.

    Where two mirrors do, what is left after both is an image as well, though it may lie farther off: what keeps two
    symmetries keeps the third. So there are four, two or one.
    """
    near = (_image(skin, x, y, NEAR_MM) for x, y in MIRRORS)
    found = tuple(image for image in near if image is not None)
    return found if len(found) < 3 else _group(*found[:3]) or found[:2]


def _group(itself: Image, one: Image, other: Image) -> tuple[Image, ...] | None:
    """Return the four images that two mirrors make; None where the order of the two makes a difference."""
    both = tuple(one.electrodes[k] for k in other.electrodes)
    if any(both[both[k]] != k for k in range(N_ELECTRODES)):
        return None
    third = Image(one.x != other.x, one.y != other.y, both)
    return tuple(sorted((itself, one, other, third), key=lambda image: MIRRORS.index((image.x, image.y))))


def mirrored_arc_mm(skin: Skin, x: bool, y: bool) -> npt.NDArray[np.float64]:
    """Return the (16,) arc lengths of the mirror images of the electrodes' centres."""
    arc, perimeter = skin.arc_length_mm, skin.outline.perimeter_mm
    length, width = skin.outline.size_mm
    if x:  # the corner (0, 0) goes to (length, 0), and the way round turns
        arc = (perimeter / 2 if skin.outline.kind == "disc" else length) - arc
    if y:
        arc = (0.0 if skin.outline.kind == "disc" else -width) - arc
    return np.asarray(arc % perimeter)


def _image(skin: Skin, x: bool, y: bool, within_mm: float) -> Image | None:
    perimeter = skin.outline.perimeter_mm
    apart = np.abs(mirrored_arc_mm(skin, x, y)[:, None] - skin.arc_length_mm)
    apart = np.minimum(apart, perimeter - apart)
    onto = apart.argmin(axis=1)
    if apart.min(axis=1).max() > within_mm or len(set(onto.tolist())) != N_ELECTRODES:
        return None
    return Image(x, y, tuple(onto.tolist()))


def _alike(skin: Skin, image: Image) -> bool:
    onto = list(image.electrodes)
    stated = (skin.electrodes.size_mm, skin.electrodes.contact_impedance_ohm_m2)
    each = [quantity.nominal(N_ELECTRODES) for quantity in stated]
    return all(np.allclose(one[onto], one, rtol=1e-9) for one in each)
