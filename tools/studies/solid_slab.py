"""The sheet model beside an independent solid, on the paper's sheet, flat and bent: V and dV of touches.

The solid is solved on two meshes, one of half the elements' size; their limit by Richardson is the truth, and how far
the finer mesh is from it is its error bar. Both contact laws of :func:`eitskin_sim.fem.solve.solve_scene` stand beside
it.

Nothing of the sheet model is in its equations but the scene and the middle surface: the field may vary through the
thickness, the contact has its plain impedance z, and a bent sheet is a bent solid, its points moved along the surface's
normal and its thickness thinned to keep the volume. The solid is not drawn with bent elements, whose chords would err:
the mesh stays flat, and the exact map's derivatives J turn into a conductivity, det J J^-1 J^-T.

Solved by conjugate gradients, for all electrodes at once. The mesh is a tensor product, so a flat solid without
contacts falls into one plane problem for each vector of depth; their factors, and for the even one the sheet model
itself, are the preconditioner. It decides how many rounds are needed, never what they end at.

Near a contact's edge the current turns into the layer within the sheet's thickness and crowds over z sigma, 0.1 mm; so
the elements grow from there in all three directions. Two meshes of which one has everything half as large say how far
the finer one still is from the limit: :func:`extrapolated`.
"""

import argparse
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from time import perf_counter
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from scipy.linalg import eigh
from scipy.sparse import block_array, coo_array, csc_array, csr_array
from scipy.sparse.linalg import splu

from eitskin_proto.sensor.table import TABLE
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.fem.depth import gathered, loss_blocks
from eitskin_sim.fem.forward import assemble, system_matrix
from eitskin_sim.fem.mesh import TensorMesh
from eitskin_sim.fem.solve import solve_scene
from eitskin_sim.scene.bend import bend_metric, metric, surface
from eitskin_sim.scene.electrodes import place as placed
from eitskin_sim.scene.parts import Bend, Scene, Touch
from eitskin_sim.scene.shapes import Rect
from eitskin_tools.bench.harness import Row, program, report

Array = npt.NDArray[np.float64]
Box = tuple[float, float, float, float]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--json", action="store_true", help="print one JSON object: rows and summary")


def run(arguments: argparse.Namespace) -> int:
    """Measure and print."""
    rows, summary = slab_rows(), {}
    for law in LAWS:
        of_law = [row for row in rows if row.get("law") == law]
        summary[f"slab_v_error_max_{law}"] = max(row["v_error_max"] for row in of_law if row["touch"] == "untouched")
        summary[f"slab_dv_error_corner_{law}"] = max(row["dv_error"] for row in of_law if row["touch"] == "corner")
        summary[f"slab_dv_error_max_{law}"] = max(row["dv_error"] for row in of_law if "dv_error" in row)
    return report(arguments, rows, summary)


@dataclass(frozen=True, slots=True)
class Resolution:
    """How fine the solid's mesh is, in mm."""

    contact_mm: float = 0.4
    """Beside a contact's edge, along the sheet and in depth."""
    touch_mm: float = 1.0
    largest_mm: float = 6.0
    growth: float = 2.0
    """Ratio of neighbouring elements."""

    def halved(self) -> "Resolution":
        """Return the mesh of half the elements' sizes, and of the same grading."""
        return Resolution(self.contact_mm / 2, self.touch_mm / 2, self.largest_mm / 2, float(np.sqrt(self.growth)))


def solid_lines(
    scene: Scene, boxes: Sequence[Box], touches: Sequence[Touch], fine: Resolution
) -> tuple[Array, Array, Array]:
    """Return the lines along x, y and z; z rises to the face with the contacts."""
    touched = [shape.bounds_mm for touch in touches for shape in touch.shapes]
    found = []
    for axis in (0, 1):
        marks = {0.0: fine.touch_mm, scene.sheet.size_mm[axis]: fine.touch_mm}
        for corners, size in ((touched, fine.touch_mm), (boxes, fine.contact_mm)):
            for corner in corners:
                marks[round(corner[axis], 9)] = marks[round(corner[axis + 2], 9)] = size
        edges = np.array([box[i] for box in boxes for i in (axis, axis + 2)])
        for at in marks:  # a touch's border under or beside a contact is as sharp as the contact's own edge
            if np.abs(edges - at).min() < scene.sheet.thickness_mm:
                marks[at] = fine.contact_mm
        found.append(geometric(sorted(marks.items()), fine.largest_mm, fine.growth))
    thickness = scene.sheet.thickness_mm
    return found[0], found[1], geometric([(0.0, thickness), (thickness, fine.contact_mm)], thickness, fine.growth)


def geometric(marks: Sequence[tuple[float, float]], largest: float, growth: float) -> Array:
    """Return lines through all marks (place, size there): equal steps of a size that grows linearly from both ends."""
    slope = np.log(growth)
    lines = [np.array([marks[0][0]])]
    for (a, from_a), (b, from_b) in pairwise(marks):
        at = np.linspace(a, b, 2001)
        size = np.minimum(np.minimum(from_a + slope * (at - a), from_b + slope * (b - at)), largest)
        steps = np.concatenate([[0.0], np.cumsum(0.5 * (1 / size[1:] + 1 / size[:-1]) * np.diff(at))])
        count = max(1, round(float(steps[-1])))
        lines.append(np.interp(np.arange(1, count + 1) * steps[-1] / count, steps, at))
        lines[-1][-1] = b
    return np.concatenate(lines)


ORDER: Final = 2.0
"""Of the voltages' error with all elements halved: a contact's edge holds biquadratic elements to this (measured)."""


def extrapolated(coarse: Array, fine: Array) -> tuple[Array, Array]:
    """Return Richardson's limit of two solutions, and how far the finer one is from it."""
    gain = (fine - coarse) / (2.0**ORDER - 1.0)
    return fine + gain, np.abs(gain)


MM: Final = 1e-3
RESIDUAL: Final = 1e-5
"""Where the rounds end, relative to the first residual in the preconditioner's norm; the voltages are energies of what
is found, so their error is its square."""
ROUNDS: Final = 200


@dataclass(frozen=True, slots=True)
class Solid:
    """A bent sheet as a solid of conductivity 1 S/m, ready for touches whose borders its mesh follows."""

    scene: Scene
    lines: tuple[Array, Array, Array]
    """mm; z rises to the face with the contacts."""
    rows: npt.NDArray[np.int64]
    columns: npt.NDArray[np.int64]
    stiffness: Array
    """(entries,) S of the elements' blocks, element fastest."""
    mass: csr_array
    """S between nodes under contacts."""
    loads: Array
    """(16, nodes) S."""

    @property
    def shape(self) -> tuple[int, int, int]:
        """Nodes along z, y, x; numbered along x first."""
        x, y, z = (2 * len(lines) - 1 for lines in self.lines)
        return z, y, x

    def voltages(self, touches: Sequence[Touch]) -> tuple[Array, int]:
        """Return the (104,) V under 1 A and the rounds that it took."""
        sigma = self._sigma(touches)
        matrix = self._matrix(sigma)
        loads = self.loads[:-1]
        own = loads.sum(axis=1)
        whole = csr_array(
            block_array([[matrix + self.mass, csr_array(-loads.T)], [csr_array(-loads), csr_array(np.diag(own))]])
        )
        currents = np.zeros((whole.shape[0], 15))
        currents[-15:] = np.eye(15)
        found, rounds = _conjugate_gradients(whole, _Depths(self, sigma), currents)
        straight = found[-15:]
        return _differences(straight + straight.T - found.T @ (whole @ found)), rounds

    def _sigma(self, touches: Sequence[Touch]) -> Array:
        """Return the (ny, nx) S/m of the columns of elements."""
        x, y = (0.5 * (lines[1:] + lines[:-1]) for lines in self.lines[:2])
        sigma = np.full((len(y), len(x)), self.scene.sheet.conductivity_S_per_m)
        for touch in touches:
            for shape in touch.shapes:
                x0, y0, x1, y1 = shape.bounds_mm
                inside = ((y > y0) & (y < y1))[:, None] & (x > x0) & (x < x1)
                sigma[inside] = touch.conductivity_S_per_m
        return sigma

    def _matrix(self, sigma: Array) -> csr_array:
        each = np.tile(sigma.ravel(), len(self.lines[2]) - 1)
        n = int(np.prod(self.shape))
        values = (self.stiffness.reshape(-1, len(each)) * each).ravel()
        return csr_array(coo_array((values, (self.rows, self.columns)), (n, n)))


def build_solid(scene: Scene, resolution: Resolution, touches: Sequence[Touch]) -> Solid:
    """Return the solid of a scene, on a mesh that follows the borders of the given touches."""
    import skfem

    boxes = contact_boxes(scene)
    lines = solid_lines(scene, boxes, touches, resolution)
    mesh = skfem.MeshHex.init_tensor(*lines)
    basis = skfem.Basis(mesh, skfem.ElementHex2(), intorder=4)
    number = _tensor_numbers(basis.doflocs, lines)
    dofs = number[basis.element_dofs]  # (27, elements)
    order = _element_order(mesh, lines)
    dofs = dofs[:, order]
    stiffness = _blocks(scene, basis)[:, :, order]
    faces = mesh.p[:, mesh.facets].mean(axis=1)
    top = faces[2] > scene.sheet.thickness_mm - 1e-9
    n = len(number)
    mass, loads = csr_array((n, n)), []
    admittances = 1.0 / scene.electrodes.impedances_ohm_m2()
    for (x0, y0, x1, y1), admittance in zip(boxes, admittances, strict=True):
        on = top & (faces[0] > x0) & (faces[0] < x1) & (faces[1] > y0) & (faces[1] < y1)
        contact = skfem.FacetBasis(mesh, skfem.ElementHex2(), facets=np.flatnonzero(on), intorder=4)
        area = admittance * _upper_area(scene, _points(contact)) * MM**2
        own = skfem.BilinearForm(lambda u, v, w: w["a"] * u * v).assemble(contact, a=area).tocoo()
        mass = mass + csr_array(coo_array((own.data, (number[own.row], number[own.col])), (n, n)))
        load = np.zeros(n)
        load[number] = skfem.LinearForm(lambda v, w: w["a"] * v).assemble(contact, a=area)
        loads.append(load)
    rows, columns = (part.ravel() for part in np.broadcast_arrays(dofs[:, None], dofs[None]))
    return Solid(scene, lines, rows, columns, stiffness.ravel(), mass, np.array(loads))


def contact_boxes(scene: Scene) -> list[Box]:
    """Return the contacts' rectangles in mm, electrode by electrode."""
    return [
        piece.patch_mm(scene.sheet, float(scene.electrodes.sizes_mm()[piece.electrode]))
        for piece in placed(scene.sheet, scene.electrodes)
    ]


def _points(basis: Any) -> Array:
    return np.asarray(basis.global_coordinates())


def _tensor_numbers(places: Array, lines: tuple[Array, Array, Array]) -> npt.NDArray[np.int64]:
    """Return each node's number along x, then y, then z, from the (3, n) mm places of scikit-fem's nodes."""
    x, y, z = (np.sort(np.concatenate([one, (one[1:] + one[:-1]) / 2])) for one in lines)
    i, j, k = (np.searchsorted(one, at - 1e-7) for one, at in zip((x, y, z), places, strict=True))
    return np.asarray((k * len(y) + j) * len(x) + i)


def _element_order(mesh: Any, lines: tuple[Array, Array, Array]) -> npt.NDArray[np.int64]:
    middle = mesh.p[:, mesh.t].mean(axis=1)
    x, y, z = (np.searchsorted(one, at) for one, at in zip(lines, middle, strict=True))
    return np.lexsort((x, y, z))


def _blocks(scene: Scene, basis: Any) -> Array:
    """Return the (27, 27, elements) S integrals of det J J^-1 J^-T grad phi_i . grad phi_j, at 1 S/m."""
    slopes = np.stack([field[0].grad for field in basis.basis], axis=-1)  # (3, elements, points, 27)
    jacobian = _derivatives(scene, _points(basis))
    inverse = np.linalg.inv(jacobian)
    weight = np.linalg.det(jacobian) * basis.dx * MM
    bent = np.einsum("eqba,aeqi->eqbi", np.swapaxes(inverse, 2, 3), slopes, optimize=True)
    bent *= np.sqrt(weight)[..., None, None]
    bent = bent.reshape(len(bent), -1, bent.shape[-1])
    return np.ascontiguousarray(np.moveaxis(np.swapaxes(bent, 1, 2) @ bent, 0, -1))


def _upper_area(scene: Scene, points: Array) -> Array:
    jacobian = _derivatives(scene, points)
    return np.asarray(np.linalg.norm(np.cross(jacobian[..., 0], jacobian[..., 1]), axis=-1))


def _derivatives(scene: Scene, points: Array) -> Array:
    """Return the (..., 3, 3) derivatives of the bent solid's map at flat points (3, ...) in mm."""
    flat = points.reshape(3, -1)
    plan, column = np.unique(np.round(flat[:2].T, 9), axis=0, return_inverse=True)
    column = column.ravel()
    height = flat[2] - scene.sheet.thickness_mm / 2
    step = 1e-3
    found = np.empty((flat.shape[1], 3, 3))
    for axis in (0, 1):
        shift = step * np.eye(2)[axis]
        (middle_a, rise_a), (middle_b, rise_b) = _layer(scene, plan + shift), _layer(scene, plan - shift)
        along, turn = (middle_a - middle_b) / (2 * step), (rise_a - rise_b) / (2 * step)
        found[:, :, axis] = along[column] + height[:, None] * turn[column]
    found[:, :, 2] = _layer(scene, plan)[1][column]
    return found.reshape(*points.shape[1:], 3, 3)


def _layer(scene: Scene, xy: Array) -> tuple[Array, Array]:
    """Return the (n, 3) middle surface and the step along its normal for each mm of the flat solid's height."""
    step = 1e-3
    sheet, bend = scene.sheet, scene.bend
    along = [
        (surface(bend, sheet, xy + step * e) - surface(bend, sheet, xy - step * e)) / (2 * step)
        for e in (np.array([1.0, 0.0]), np.array([0.0, 1.0]))
    ]
    normal = np.cross(along[0], along[1])
    first = metric(bend, sheet, xy)
    thinning = np.sqrt(first[:, 0] * first[:, 2] - first[:, 1] ** 2)
    return surface(bend, sheet, xy), normal / (np.linalg.norm(normal, axis=1) * thinning)[:, None]


class _Depths:
    """The preconditioner: a plane problem for each eigenvector of depth, the even one being the sheet model."""

    def __init__(self, solid: Solid, sigma: Array) -> None:
        scene, self.layers = solid.scene, solid.shape[0]
        first = bend_metric(scene.bend, scene.sheet)
        mesh = TensorMesh(*solid.lines[:2])
        system = assemble(mesh, scene.sheet, scene.electrodes, first)
        blocks = sigma.ravel()[:, None, None] * system.stiffness
        density = system.contacts.density(sigma.ravel()[system.contacts.element])
        self.even = _factor(system_matrix(mesh, system.contacts, blocks, density))
        rates, self.vectors = eigh(*_line_matrices(solid.lines[2] / scene.sheet.thickness_mm))
        losses = sigma.ravel()[:, None, None] * loss_blocks(mesh, scene.sheet.thickness_mm, first)
        self.odd = [_factor(gathered(mesh, blocks + rate * losses)) for rate in rates[1:]]

    def __call__(self, residual: Array) -> Array:
        """Return the approximate solutions (n + 15, m) of right-hand sides (n + 15, m)."""
        count = residual.shape[1]
        modes = (self.vectors.T @ residual[:-15].reshape(self.layers, -1)).reshape(self.layers, -1, count)
        sign = self.vectors[0, 0]  # the even vector is 1 or -1 all through
        even = self.even.solve(np.concatenate([sign * modes[0], residual[-15:]]))
        modes[0] = sign * even[:-15]
        for k, factor in enumerate(self.odd, start=1):
            modes[k] = factor.solve(modes[k])
        back = (self.vectors @ modes.reshape(self.layers, -1)).reshape(-1, count)
        return np.concatenate([back, even[-15:]])


def _factor(matrix: csc_array) -> Any:
    return splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})


def _line_matrices(lines: Array) -> tuple[Array, Array]:
    """Return the (n, n) stiffness and mass of quadratic elements on a line of length 1."""
    n = 2 * len(lines) - 1
    stiffness, mass = np.zeros((n, n)), np.zeros((n, n))
    for k, size in enumerate(np.diff(lines)):
        at = np.ix_(range(2 * k, 2 * k + 3), range(2 * k, 2 * k + 3))
        stiffness[at] += np.array([[7, -8, 1], [-8, 16, -8], [1, -8, 7]]) / (3 * size)
        mass[at] += np.array([[4, 2, -1], [2, 16, 2], [-1, 2, 4]]) * size / 30
    return stiffness, mass


def _conjugate_gradients(matrix: csr_array, preconditioner: _Depths, right: Array) -> tuple[Array, int]:
    """Return the solutions (n, m) of a symmetric system, all right-hand sides at once, and the rounds."""
    found, residual = np.zeros_like(right), right.copy()
    better = preconditioner(residual)
    direction = better.copy()
    product = np.einsum("nm,nm->m", residual, better)
    target = RESIDUAL**2 * product
    for count in range(1, ROUNDS + 1):
        image = matrix @ direction
        step = product / np.einsum("nm,nm->m", direction, image)
        found += step * direction
        residual -= step * image
        better = preconditioner(residual)
        ahead = np.einsum("nm,nm->m", residual, better)
        if np.all(ahead <= target):
            return found, count
        direction = better + ahead / product * direction
        product = ahead
    raise RuntimeError(f"the solid's equations did not settle within {ROUNDS} rounds")


def _differences(potentials: Array) -> Array:
    """Return the (104,) V from (15, 15) potentials of the electrodes but the last, which is the ground."""
    impedance = np.zeros((16, 16))
    impedance[:15, :15] = potentials
    drives = impedance - np.roll(impedance, -1, axis=1)
    measured = (drives - np.roll(drives, -1, axis=0)).T
    return np.asarray(measured[TABLE[:, 0], TABLE[:, 1]])


FLAT: Final = Bend()
BENT: Final = Bend(angle_deg=120, axis_deg=20, stretch_along=1.1)
PLACES: Final[Mapping[str, tuple[float, float, float, float]]] = {
    "interior": PAPER.grid.unit_rect_mm(6, 4),
    "edge": PAPER.grid.unit_rect_mm(6, 0),
    "corner": PAPER.grid.unit_rect_mm(0, 0),
    "under a contact": (8.0, 0.0, 18.0, 10.0),
}
"""The edge unit's border halves a contact, the corner unit's cuts 0.2 mm off one; the last covers one."""
COARSE_RESOLUTION: Final = Resolution(contact_mm=0.8, touch_mm=2.0, largest_mm=12.0, growth=4.0)
LAWS: Final = ("constant", "modes")


@dataclass(frozen=True, slots=True)
class Truth:
    """What two solids say of one sheet: voltages by place, extrapolated, and the finer one's distance from that."""

    voltages: dict[str, Array]
    error: dict[str, Array]
    change: dict[str, Array]
    """dV / V of each touch."""
    change_error: dict[str, float]
    """Relative, of the finer mesh."""
    unknowns: int
    rounds: int


def slab_rows() -> list[Row]:
    """Return the rows of the flat and the bent sheet."""
    rows: list[Row] = []
    for name, bend in (("flat", FLAT), ("bent", BENT)):
        scene = Scene(bend=bend)
        start = perf_counter()
        truth = solve_truth(scene, PLACES, COARSE_RESOLUTION)
        seconds = perf_counter() - start
        print(f"slab: {name}, {truth.unknowns} unknowns, {truth.rounds} rounds, {seconds:.0f} s", file=sys.stderr)
        rows += compare(scene, PLACES, truth, name)
    return rows


def solve_truth(scene: Scene, places: Mapping[str, tuple[float, float, float, float]], coarse: Resolution) -> Truth:
    """Return what a solid of twice the given fineness says, and how sure that is."""
    touches = {"untouched": (), **{place: (Touch((Rect(*box),)),) for place, box in places.items()}}
    every = tuple(touch for some in touches.values() for touch in some)
    found: list[dict[str, Array]] = []
    rounds, unknowns = 0, 0
    for resolution in (coarse, coarse.halved()):
        solid = build_solid(scene, resolution, every)
        unknowns = int(np.prod(solid.shape)) + 15
        solutions = {place: solid.voltages(some) for place, some in touches.items()}
        rounds = max(count for _, count in solutions.values())
        found.append({place: voltages for place, (voltages, _) in solutions.items()})
    limits = {place: extrapolated(found[0][place], found[1][place]) for place in touches}
    changes = [{place: voltages / one["untouched"] - 1 for place, voltages in one.items()} for one in found]
    change, off = {}, {}
    for place in places:
        change[place], gap = extrapolated(changes[0][place], changes[1][place])
        off[place] = float(np.linalg.norm(gap) / np.linalg.norm(change[place]))
    return Truth(
        {place: limit for place, (limit, _) in limits.items()},
        {place: np.abs(gap / limit) for place, (limit, gap) in limits.items()},
        change,
        off,
        unknowns,
        rounds,
    )


def compare(
    scene: Scene, places: Mapping[str, tuple[float, float, float, float]], truth: Truth, name: str
) -> list[Row]:
    """Return a row for each contact law and each place."""
    rows = []
    for law in LAWS:
        base = solve_scene(scene, law).voltages
        rows.append({"what": "slab", "sheet": name, "law": law, "touch": "untouched", **_voltage_errors(base, truth)})
        for place, box in places.items():
            touched = solve_scene(replace(scene, touches=(Touch((Rect(*box),)),)), law).voltages
            expected = truth.change[place]
            error = np.linalg.norm(touched / base - 1 - expected) / np.linalg.norm(expected)
            row: Row = {"what": "slab", "sheet": name, "law": law, "touch": place}
            row |= _voltage_errors(touched, truth, place)
            rows.append({**row, "dv_error": float(error), "dv_error_of_solid": truth.change_error[place]})
    return rows


def _voltage_errors(voltages: Array, truth: Truth, place: str = "untouched") -> Row:
    off = voltages / truth.voltages[place] - 1
    return {
        "v_error_max": float(np.abs(off).max()),
        "v_error_rms": float(np.sqrt(np.mean(off**2))),
        "v_error_of_solid_max": float(truth.error[place].max()),
    }


if __name__ == "__main__":
    sys.exit(program(__doc__, add_arguments, run))
