"""The truth of a phantom, on the map of the skin in use; refused where it would be empty though something touches.

A phantom's scene is the true device, whose sheet may be a little longer or shorter than the map. One that is off by
more is another sheet, whose touches a solver would see elsewhere; so is one with a touch whose middle is off the map.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import Final

import numpy as np

from eitskin_proto.files.plain import quoted
from eitskin_proto.skin.grid import Grid
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.arrays import Array
from eitskin_sim.evaluation.metrics import touched_units
from eitskin_sim.scene.area import area_map
from eitskin_sim.scene.parts import Phantom, SceneError

OTHER_SHEET: Final = 0.1
"""A side that is off by a larger part of the map's is another sheet's."""


@lru_cache(maxsize=256)
def truth_map(phantom: Phantom, grid: Grid = PAPER.grid) -> Array:
    """Return the truth of a phantom, kept and not to be written to: units that are touched, or each pixel's share."""
    scene = phantom.scene
    found = area_map(scene.touches, grid, scene.sheet.conductivity_S_per_m)
    if phantom.truth == "units":
        found = np.asarray(grid.map_from_units(touched_units(found, grid).astype(np.float64)))
    found.setflags(write=False)
    return found


def check_truths(phantoms: Sequence[Phantom], skin: Skin = PAPER) -> None:
    """Raise SceneError where a phantom is of another sheet than the map, or its touches leave its truth empty.

    Args:
        phantoms: What is to be evaluated.
        skin: Whose map the truth is drawn on.
    """
    for index, phantom in enumerate(phantoms):
        where = f"phantoms[{index}] {quoted(phantom.name)}"
        _check_on_map(phantom, skin, where)
        if not phantom.scene.touches or truth_map(phantom, skin.grid).any():
            continue
        if phantom.truth == "units":
            raise SceneError(
                f"{where}: no unit is touched: its touches cover none by half; touch 'units', or give the truth 'area'"
            )
        raise SceneError(f"{where}: nothing is touched: holes remove its touches; leave out one of them")


def _check_on_map(phantom: Phantom, skin: Skin, where: str) -> None:
    length, width = skin.grid.size_mm
    along, across = phantom.scene.sheet.size_mm
    whose = f"that of skin {quoted(skin.name)}: give the skin of this sheet with --skin FILE"
    if max(abs(along / length - 1.0), abs(across / width - 1.0)) > OTHER_SHEET + 1e-9:
        raise SceneError(
            f"{where}: its sheet is {along:g} x {across:g} mm; expected {length:g} x {width:g} mm, each within a "
            f"tenth, {whose}"
        )
    for number, touch in enumerate(phantom.scene.touches):
        for shape in touch.shapes:
            x0, y0, x1, y1 = shape.bounds_mm
            x, y = (x0 + x1) / 2, (y0 + y1) / 2
            if x > length or y > width:
                raise SceneError(
                    f"{where}: touches[{number}] is off the map: its middle is ({x:g}, {y:g}) mm, on a sheet of "
                    f"{along:g} x {across:g} mm; expected {length:g} x {width:g} mm, {whose}"
                )
