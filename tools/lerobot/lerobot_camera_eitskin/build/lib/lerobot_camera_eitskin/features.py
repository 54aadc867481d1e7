"""A frame as LeRobot's observations: the map as an image, the touches as an array of fixed size."""

from collections.abc import Iterable
from typing import Any, Final

import numpy as np
import numpy.typing as npt

import eitskin

TOUCHES: Final = "observation.tactile.touches"
"""Key of the touches in a data set."""

MAX_TOUCHES: Final = 4

FIELDS: Final = ("x_mm", "y_mm", "z_mm", "nx", "ny", "nz", "area_mm2", "peak", "age_s")
"""Of a touch: place and normal on the bent surface, area on the flat sheet, highest value of the map, age."""

PIXELS: Final = 8
"""Of the image along each side of a map's pixel: video encoders want multiples of 8."""


def touch_features() -> dict[str, dict[str, Any]]:
    """Return the feature of the touches, to be merged into those of a data set."""
    return {TOUCHES: {"dtype": "float32", "shape": (MAX_TOUCHES, len(FIELDS)), "names": list(FIELDS)}}


def touch_array(touches: Iterable[eitskin.Touch]) -> npt.NDArray[np.float32]:
    """Return touches as (4, 9) with columns ``FIELDS``: the four largest, the longest lasting first, then zeros.

    ``peak`` is above 0 for every touch, so a row of zeros is no touch.
    """
    largest = sorted(touches, key=lambda touch: -touch.area_mm2)[:MAX_TOUCHES]
    found = np.zeros((MAX_TOUCHES, len(FIELDS)), dtype=np.float32)
    for row, touch in zip(found, sorted(largest, key=lambda touch: touch.id), strict=False):
        row[:] = *touch.place_mm, *touch.normal, touch.area_mm2, touch.peak, touch.age_s
    return found


def image_of(values: npt.NDArray[np.float32]) -> npt.NDArray[np.uint8]:
    """Return a map (rows, columns) as a grey image (8 rows, 8 columns, 3), 255 for 1; row 0 is y = 0."""
    grey = np.rint(255.0 * np.clip(values, 0.0, 1.0)).astype(np.uint8)
    return np.repeat(grey.repeat(PIXELS, axis=0).repeat(PIXELS, axis=1)[:, :, None], 3, axis=2)
