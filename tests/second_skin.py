"""A skin that is not the paper's: other sizes, other electrodes, pixels that are no squares. Constants show on it."""

import numpy as np

from eitskin_proto.skin.parts import Map, Outline, Ring
from eitskin_proto.skin.quantity import Quantity
from eitskin_proto.skin.skin import Skin

SECOND = Skin(
    name="second",
    outline=Outline(size_mm=(220.0, 90.0)),
    electrodes=Ring(arc_length_mm=Quantity(tuple(float(arc) for arc in 10.0 + 38.75 * np.arange(16)))),
    map=Map((18, 45), (9, 15)),
)
"""220 x 90 mm; pixels of 4.89 x 5 mm."""


def rolled(skin, angle_deg):
    """Return the (3, rows, columns) mm of a sheet rolled about y, its front inside for a positive angle."""
    flat, length = skin.grid.flat_cloud_mm(), skin.outline.size_mm[0]
    curvature = np.deg2rad(angle_deg) / length
    along = curvature * (flat[0] - length / 2)
    return np.stack([np.sin(along) / curvature, flat[1], (1.0 - np.cos(along)) / curvature])
