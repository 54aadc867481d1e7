"""Makes a scene's mesh: lines on every electrode's and touch's edges, fine where the field is singular.

The sizes below are those at ``element_size_mm`` = 1.5; another value scales them all, with the lines fixed in place.
The size that a person names is the spacing of nodes in the open sheet; a biquadratic element has three nodes a side,
so elements there are twice as large.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np

from eitskin_sim.fem.mesh import TensorMesh, graded_lines
from eitskin_sim.scene.electrodes import place
from eitskin_sim.scene.parts import Electrodes, Scene, SceneError, Sheet, Touch
from eitskin_sim.scene.shapes import Rect, Shape

REFERENCE_MM: Final = 1.5
"""The element size at which the sizes below hold."""

CAP_MM: Final = 2.0 * REFERENCE_MM
PATCH_EDGE_MM: Final = 0.2
"""Beside a face contact's edge: the current leaves it over sqrt(z_eff sigma T), about 1 mm."""
EDGE_END_MM: Final = 0.02
"""Beside a border contact's end: the current crowds there over z sigma, about 0.1 mm."""
EDGE_DEPTH_MM: Final = 0.03
"""Behind the border, for the same reason."""
TOUCH_EDGE_MM: Final = 0.5
"""Beside a touch's border, whose corners are weak singularities."""
MAX_ELEMENTS: Final = 120_000
"""As many take :func:`eitskin_sim.fem.solve.solve_scene` 1.3 GB and 10 s of one core; 0.5 mm in the open sheet have
71,000. The law "modes" takes several times that: 71,000 take it 2.2 GB and 90 s, and the limit does not bound it."""
CURVED_MM: Final = 1.0
"""Inside a touch whose border the mesh cannot follow: the laminate's own size."""
GRADED_MM: Final = 0.5
"""The least of them across a graded border; half of its width where that is more."""

MAX_PATCH_GAP_MM: Final = 3.5
"""Patches that are no further apart have a line between them where a mesh serves devices with electrodes off it."""

Fixed = list[tuple[float, float]]


def electrode_lines(sheet: Sheet, electrodes: Electrodes) -> tuple[Fixed, Fixed]:
    """Return the lines (position, size) along x and along y that the electrodes need, the sheet's ends among them."""
    length, width = sheet.size_mm
    patch, sizes = electrodes.contact == "patch", electrodes.sizes_mm()
    border = PATCH_EDGE_MM * 2 if patch else EDGE_DEPTH_MM
    x: Fixed = [(0.0, border), (length, border)]
    y: Fixed = [(0.0, border), (width, border)]
    for piece in place(sheet, electrodes):
        if patch:
            x0, y0, x1, y1 = piece.patch_mm(sheet, float(sizes[piece.electrode]))
            x += [(x0, PATCH_EDGE_MM), (x1, PATCH_EDGE_MM)]
            y += [(y0, PATCH_EDGE_MM), (y1, PATCH_EDGE_MM)]
        else:
            lines = x if piece.side in (0, 2) else y
            lines += [(piece.start_mm, EDGE_END_MM), (piece.stop_mm, EDGE_END_MM)]
    return x, y


def lines_between(sheet: Sheet, electrodes: Electrodes) -> tuple[list[float], list[float]]:
    """Return places along x and along y, mm, of lines halfway between neighbouring patches that are close.

    A single element there would lie under both, if they were a little larger or nearer than stated.
    """
    if electrodes.contact != "patch":
        return [], []
    sizes = electrodes.sizes_mm()
    boxes = np.array([one.patch_mm(sheet, float(sizes[one.electrode])) for one in place(sheet, electrodes)])
    found: tuple[list[float], list[float]] = [], []
    for one, other in zip(boxes, np.roll(boxes, -1, axis=0), strict=True):
        low, high = np.minimum(one[2:], other[2:]), np.maximum(one[:2], other[:2])
        axis = int(np.argmax(high - low))
        if 0.0 < high[axis] - low[axis] <= MAX_PATCH_GAP_MM:
            found[axis].append(float(low[axis] + high[axis]) / 2.0)
    return found


def touch_lines(touches: Sequence[Touch]) -> tuple[Fixed, Fixed]:
    """Return the lines (position, size) along x and along y that the touches ask for."""
    x: Fixed = []
    y: Fixed = []
    for touch in touches:
        for shape in touch.shapes:
            x0, y0, x1, y1 = shape.bounds_mm
            x += _span(shape, x0, x1, touch.border_mm)
            y += _span(shape, y0, y1, touch.border_mm)
    return x, y


def _span(shape: Shape, low: float, high: float, border_mm: float) -> Fixed:
    if isinstance(shape, Rect):
        edge = min(TOUCH_EDGE_MM, border_mm / 4) if border_mm else TOUCH_EDGE_MM
        ends = (-border_mm / 2, 0.0, border_mm / 2) if border_mm else (0.0,)
        return [(at + end, edge) for at in (low, high) for end in ends]
    step = CURVED_MM
    if border_mm:
        low, high, step = low - border_mm / 2, high + border_mm / 2, float(np.clip(border_mm / 2, GRADED_MM, CURVED_MM))
    count = max(1, int(np.ceil((high - low) / step - 1e-9)))  # whole numbers of elements in spite of rounding
    return [(float(at), step) for at in np.linspace(low, high, count + 1)]


def scene_mesh(scene: Scene) -> TensorMesh:
    """Return the mesh on which a scene is solved.

    Raises:
        SceneError: It would have too many elements.
    """
    x, y = electrode_lines(scene.sheet, scene.electrodes)
    touch_x, touch_y = touch_lines(scene.touches)
    density = REFERENCE_MM / scene.element_size_mm
    length, width = scene.sheet.size_mm
    lines = [
        graded_lines(on_sheet(f, extent), CAP_MM, density)
        for f, extent in ((x + touch_x, length), (y + touch_y, width))
    ]
    mesh = TensorMesh(*lines)
    if mesh.n_elements > MAX_ELEMENTS:
        raise SceneError(
            f"the scene needs a mesh of {mesh.n_elements} elements, expected at most {MAX_ELEMENTS}: raise "
            f"element_size_mm (it is {scene.element_size_mm:g}), or leave out touches"
        )
    return mesh


def on_sheet(fixed: Fixed, extent: float) -> Fixed:
    """Return the lines with those beyond the sheet's ends moved onto them."""
    return [(min(max(position, 0.0), extent), size) for position, size in fixed]
