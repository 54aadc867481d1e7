"""An independent model: the sheet as a solid, in hexahedra of scikit-fem, with contacts on its upper face.

Nothing of the sheet model is in it but the scene and the middle surface: the field may vary through the thickness, the
contact has its plain impedance z, and a bent sheet is a bent solid, its nodes moved along the surface's normal and its
thickness thinned to keep the volume. What the sheet model leaves out (the crowding under a contact, the ends of the
normal field, the strain off the middle surface) is in here.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.sparse import bmat, csc_array
from scipy.sparse.linalg import splu

from eitskin_proto.table import TABLE
from eitskin_sim.bend import metric, surface
from eitskin_sim.electrodes import place
from eitskin_sim.parts import Scene

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Resolution:
    """How fine the solid's mesh is."""

    largest_mm: float = 6.0
    contact_mm: float = 0.25
    """Beside a contact's edge, along the sheet."""
    touch_mm: float = 1.0
    growth: float = 1.6
    """Ratio of neighbouring elements, per element."""
    layers_mm: tuple[float, ...] = (1.2, 0.5, 0.2, 0.1)
    """Thickness of the layers from the lower to the upper face, for a sheet of 2 mm; scaled for others."""


def solve_slab(scene: Scene, resolution: Resolution) -> tuple[Array, int]:
    """Return the (104,) V of a scene with patch contacts and rectangular touches under 1 A, and the unknowns."""
    import skfem
    from skfem.helpers import dot, grad

    pieces = place(scene.sheet, scene.electrodes)
    boxes = [piece.patch_mm(scene.sheet, scene.electrodes.size_mm) for piece in pieces]
    flat = skfem.MeshHex.init_tensor(*_lines(scene, boxes, resolution))
    middle = flat.p[:, flat.t].mean(axis=1)
    sigma = np.full(flat.nelements, scene.sheet.conductivity_S_per_m)
    for touch in scene.touches:
        for shape in touch.shapes:
            x0, y0, x1, y1 = shape.bounds_mm
            inside = (middle[0] > x0) & (middle[0] < x1) & (middle[1] > y0) & (middle[1] < y1)
            sigma[inside] = touch.conductivity_S_per_m
    faces = flat.p[:, flat.facets].mean(axis=1)
    top = faces[2] > scene.sheet.thickness_mm - 1e-9
    bent = skfem.MeshHex(_bend(scene, flat.p) * 1e-3, flat.t, validate=False)
    basis = skfem.Basis(bent, skfem.ElementHex2(), intorder=4)

    def conduction(u: Any, v: Any, w: Any) -> Any:
        return w.sigma * dot(grad(u), grad(v))

    def mass(u: Any, v: Any, _: Any) -> Any:
        return u * v

    def load(v: Any, _: Any) -> Any:
        return 1.0 * v

    stiffness = skfem.BilinearForm(conduction).assemble(basis, sigma=sigma[:, None])
    admittance = 1.0 / scene.electrodes.contact_impedance_ohm_m2
    loads = []
    for x0, y0, x1, y1 in boxes:
        on = top & (faces[0] > x0) & (faces[0] < x1) & (faces[1] > y0) & (faces[1] < y1)
        contact = skfem.FacetBasis(bent, skfem.ElementHex2(), facets=np.flatnonzero(on), intorder=4)
        stiffness = stiffness + admittance * skfem.BilinearForm(mass).assemble(contact)
        loads.append(admittance * skfem.LinearForm(load).assemble(contact))
    return _voltages(stiffness, np.array(loads)), stiffness.shape[0]


def _voltages(stiffness: Any, loads: Array) -> Array:
    """Ground electrode 15 and solve for the other 15; scikit-fem's constants sum to one, so a load sums to its area."""
    coupling = csc_array(-loads[:-1].T)
    own = csc_array(np.diag(loads[:-1].sum(axis=1)))
    blocks: Any = [[stiffness, coupling], [coupling.T, own]]
    matrix = csc_array(bmat(blocks))
    n = stiffness.shape[0]
    currents = np.zeros((n + 15, 15))
    currents[n:] = np.eye(15)
    lu = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    impedance = np.zeros((16, 16))
    impedance[:15, :15] = lu.solve(currents)[n:]
    drives = impedance - np.roll(impedance, -1, axis=1)
    measured = (drives - np.roll(drives, -1, axis=0)).T
    return np.asarray(measured[TABLE[:, 0], TABLE[:, 1]])


def _bend(scene: Scene, points: Array) -> Array:
    """Return the (3, n) mm places of the flat solid's nodes (3, n) in the bent one."""
    xy = points[:2].T
    step = 1e-4
    sheet, bend = scene.sheet, scene.bend
    along = [
        (surface(bend, sheet, xy + step * e) - surface(bend, sheet, xy - step * e)) / (2 * step)
        for e in (np.array([1.0, 0.0]), np.array([0.0, 1.0]))
    ]
    normal = np.cross(along[0], along[1])
    first = metric(bend, sheet, xy)
    area = np.sqrt(first[:, 0] * first[:, 2] - first[:, 1] ** 2)
    height = (points[2] - sheet.thickness_mm / 2) / area
    return np.asarray((surface(bend, sheet, xy) + normal * (height / np.linalg.norm(normal, axis=1))[:, None]).T)


def _lines(
    scene: Scene, boxes: list[tuple[float, float, float, float]], fine: Resolution
) -> tuple[Array, Array, Array]:
    touched = [shape.bounds_mm for touch in scene.touches for shape in touch.shapes]
    found = []
    for axis in (0, 1):
        marks = {0.0: fine.touch_mm, scene.sheet.size_mm[axis]: fine.touch_mm}
        for corners, size in ((touched, fine.touch_mm), (boxes, fine.contact_mm)):
            for corner in corners:
                marks[round(corner[axis], 9)] = marks[round(corner[axis + 2], 9)] = size
        found.append(_geometric(sorted(marks.items()), fine))
    depths = np.concatenate([[0.0], np.cumsum(fine.layers_mm)])
    return found[0], found[1], depths * scene.sheet.thickness_mm / depths[-1]


def _geometric(marks: list[tuple[float, float]], fine: Resolution) -> Array:
    """Return lines through all marks: from both ends of each gap in geometric steps, the middle filled evenly."""
    lines = [marks[0][0]]
    for (a, from_a), (b, from_b) in pairwise(marks):
        left, right, size_a, size_b = [a], [b], from_a, from_b
        while True:
            gap = right[-1] - left[-1]
            if gap <= 1.5 * (size_a + size_b) or min(size_a, size_b) >= fine.largest_mm:
                break
            if size_a <= size_b:
                left.append(left[-1] + size_a)
                size_a = min(size_a * fine.growth, fine.largest_mm)
            else:
                right.append(right[-1] - size_b)
                size_b = min(size_b * fine.growth, fine.largest_mm)
        count = max(1, round((right[-1] - left[-1]) / max(size_a, size_b)))
        middle = np.linspace(left[-1], right[-1], count + 1)[1:-1]
        lines += [*left[1:], *middle, *right[::-1]]
    return np.array(lines)
