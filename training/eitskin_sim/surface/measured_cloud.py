"""The cloud that a scanner gives of a known bend: no marks, evenly redrawn by arc length, noisy, in the agreed pose.

A cloud shows the surface and not the material. A scanner sees where the border is, and between borders rows and columns
can only be divided evenly by arc length; an uneven stretch therefore leaves no trace in the cloud. The same resampling
serves measured points (:mod:`eitskin_sim.surface.ordered_cloud`), so training sees what the robot will.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.skin.cloud import align_cloud
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.scene.bend import surface
from eitskin_sim.scene.nominal import nominal_sheet
from eitskin_sim.scene.parts import Bend, Sheet
from eitskin_sim.surface.smooth_surface import by_arc_length, nodes_of

NOISE_MM: Final = 0.1
"""Resolution of the scanner (paper section IV.A), taken as the noise of every coordinate."""


def measured_cloud(
    bend: Bend,
    rng: np.random.Generator | None = None,
    noise_mm: float = NOISE_MM,
    skin: Skin = PAPER,
    sheet: Sheet | None = None,
) -> npt.NDArray[np.float32]:
    """Return the (3, rows, columns) mm cloud of a bend.

    Args:
        bend: The sheet's shape.
        rng: Source of the noise; None leaves it out.
        noise_mm: Standard deviation of every coordinate.
        skin: What is bent.
        sheet: The true one, which may be cut longer or shorter; None is as the skin states it.
    """
    sheet = sheet or nominal_sheet(skin)
    columns, rows = (
        np.linspace(0.0, extent, 2 * n - 1) for extent, n in zip(sheet.size_mm, nodes_of(sheet.size_mm), strict=True)
    )
    x, y = np.meshgrid(columns, rows)
    points = surface(bend, sheet, np.stack([x.ravel(), y.ravel()], axis=-1))
    cloud = by_arc_length(points.T.reshape(3, len(rows), len(columns)), skin.grid.shape)
    if rng is not None:
        cloud = cloud + noise_mm * rng.standard_normal(cloud.shape)
    return align_cloud(cloud, skin.grid).astype(np.float32)
