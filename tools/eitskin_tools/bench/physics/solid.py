"""An independent model: the sheet as a solid, in hexahedra of scikit-fem, with contacts on its upper face.

Nothing of the sheet model is in its equations but the scene and the middle surface: the field may vary through the
thickness, the contact has its plain impedance z, and a bent sheet is a bent solid, its points moved along the surface's
normal and its thickness thinned to keep the volume. The solid is not drawn with bent elements, whose chords would err:
the mesh stays flat, and the exact map's derivatives J turn into a conductivity, det J J^-1 J^-T.

Solved by conjugate gradients, for all electrodes at once. The mesh is a tensor product, so a flat solid without
contacts falls into one plane problem for each vector of depth; their factors, and for the even one the sheet model
itself, are the preconditioner. It decides how many rounds are needed, never what they end at.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from scipy.linalg import eigh
from scipy.sparse import block_array, coo_array, csc_array, csr_array
from scipy.sparse.linalg import splu

from eitskin_proto.sensor.table import TABLE
from eitskin_sim.fem.depth import gathered, loss_blocks
from eitskin_sim.fem.forward import assemble, system_matrix
from eitskin_sim.fem.mesh import TensorMesh
from eitskin_sim.scene.bend import bend_metric, metric, surface
from eitskin_sim.scene.electrodes import place
from eitskin_sim.scene.parts import Scene, Touch
from eitskin_tools.bench.physics.solid_mesh import Resolution, solid_lines

Array = npt.NDArray[np.float64]
Box = tuple[float, float, float, float]

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
        for piece in place(scene.sheet, scene.electrodes)
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
