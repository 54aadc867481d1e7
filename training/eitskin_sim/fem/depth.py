"""The admittance of a face contact when the field varies through the layer: its depth modes, eliminated.

Conductivity does not change through the thickness t, so a solid's potential splits into modes of depth,

    u = u_0(x, y) + sqrt(2) sum over n of u_n(x, y) cos(n pi zeta),      zeta = 0 at the upper face, 1 at the lower,

and only a contact couples them. u_0 is the sheet's own field. Each other mode obeys the sheet's equation with a loss,
n^2 pi^2 sigma / t, and so ends within about t of the contact. With j the contact's current density, at its nodes,

    z j = U - u_0 - H j,      H = 2 sum over n of  R (S + n^2 pi^2 Q)^-1 R^T M,

S the sheet's stiffness around the contact, Q its loss, M the contact's mass, R the restriction to it. What the sheet
sees is the admittance Y = (z M^-1 + H M^-1)^-1 between the nodes under the contact: no number is fitted. The sum over
all modes is a sum over ten poles, because 2 sum 1 / (k^2 + n^2 pi^2) = coth(k) / k - 1 / k^2 is fitted by ten.

A window of 2.5 t around a contact is enough, on a mesh of its own that crowds at the contact's and the touches' edges.
Contacts nearer to each other than that share a window.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt
from scipy.linalg import block_diag
from scipy.optimize import nnls
from scipy.sparse import coo_array, csc_array
from scipy.sparse.linalg import splu

from eitskin_sim.arrays import Array, Index
from eitskin_sim.fem.borders.cut_elements import touch
from eitskin_sim.fem.forward import Plate, System, assemble_pieces, metric_at_points
from eitskin_sim.fem.mesh import MM, Metric, TensorMesh, graded_lines
from eitskin_sim.fem.meshing import REFERENCE_MM, touch_lines
from eitskin_sim.fem.q2 import GAUSS, WEIGHTS, values
from eitskin_sim.scene.electrodes import Piece, place
from eitskin_sim.scene.parts import Scene

Box = tuple[float, float, float, float]

REACH_THICKNESSES: Final = 2.5
"""Thicknesses around a contact: the first mode falls to exp(-2.5 pi) = 4e-4 there, and again on its way back."""
EDGE_ELEMENT: Final = 0.05
"""Elements beside a contact's edge, in thicknesses or contact sizes, whichever is less."""
MAX_ELEMENT_THICKNESSES: Final = 0.75
"""The largest elements of a window, in thicknesses."""
EXACT_POLES: Final = 2
FITTED_POLES: Final = 9
LARGEST_WAVE: Final = 200.0
"""The fit of the poles holds for wave numbers times thickness up to this: 0.03 mm at 2 mm."""


@cache
def poles() -> tuple[Array, Array]:
    """Return weights w and places p with sum w / (k^2 + p) = coth(k) / k - 1 / k^2 within 4e-4 for 0.1 < k < 200."""
    n = np.arange(1, EXACT_POLES + 1)
    k = np.geomspace(0.1, LARGEST_WAVE, 300)
    whole = 1.0 / (k * np.tanh(k)) - 1.0 / k**2
    rest = whole - np.sum(2.0 / (k[:, None] ** 2 + (n * np.pi) ** 2), axis=1)
    places = np.geomspace((EXACT_POLES + 0.7) * np.pi, 2.0 * LARGEST_WAVE, FITTED_POLES) ** 2
    weights, _ = nnls(1.0 / (k[:, None] ** 2 + places) / whole[:, None], rest / whole, maxiter=20_000)
    kept = weights > 0.0
    return np.append(np.full(EXACT_POLES, 2.0), weights[kept]), np.append((n * np.pi) ** 2, places[kept])


@dataclass(frozen=True, slots=True)
class Window:
    """A part of the sheet around contacts that are near each other."""

    system: System
    """On the window's own mesh; its contacts are the window's."""
    blocks: Array
    """(n_elements, 9, 9) S under the touches."""
    loss: Array
    """(n_elements, 9, 9) S: the integral of sigma phi_i phi_j det g / t0."""


def plates(system: System, scene: Scene, metric: Metric) -> tuple[Plate, ...]:
    """Return what the scene's contacts pass between the nodes of a system and its electrodes."""
    seen: dict[bytes, Array] = {}
    found = []
    for box, pieces in _groups(scene):
        window = _window(scene, metric, box, pieces)
        key = _key(window)
        if key not in seen:
            seen[key] = _admittance(window)
        found.append(_on_sheet(system, window, seen[key]))
    return tuple(found)


def _groups(scene: Scene) -> list[tuple[Box, list[Piece]]]:
    """Return the windows' boxes, cut off at the sheet's border, with the contacts in each."""
    reach = REACH_THICKNESSES * scene.sheet.thickness_mm
    groups: list[tuple[Box, list[Piece]]] = []
    for piece in place(scene.sheet, scene.electrodes):
        own = _box(scene, [piece], 0.0)
        near = [group for group in groups if _meet(group[0], own)]
        joined = [member for group in near for member in group[1]] + [piece]
        groups = [group for group in groups if group not in near] + [(_box(scene, joined, reach), joined)]
    return groups


def _box(scene: Scene, pieces: Sequence[Piece], reach: float) -> Box:
    sizes = scene.electrodes.sizes_mm()
    boxes = np.array([piece.patch_mm(scene.sheet, float(sizes[piece.electrode])) for piece in pieces])
    length, width = scene.sheet.size_mm
    return (
        max(float(boxes[:, 0].min()) - reach, 0.0),
        max(float(boxes[:, 1].min()) - reach, 0.0),
        min(float(boxes[:, 2].max()) + reach, length),
        min(float(boxes[:, 3].max()) + reach, width),
    )


def _meet(one: Box, other: Box) -> bool:
    return one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3]


def _window(scene: Scene, metric: Metric, box: Box, pieces: Sequence[Piece]) -> Window:
    sheet, electrodes = scene.sheet, scene.electrodes
    mesh = TensorMesh(*(_lines(scene, box, pieces, axis) for axis in (0, 1)))
    system = assemble_pieces(mesh, sheet, electrodes, metric, pieces)
    touched = touch(system, scene.touches)
    sigma = touched.sigma * system.relative
    return Window(system, touched.blocks, sigma[:, None, None] * loss_blocks(mesh, sheet.thickness_mm, metric))


def loss_blocks(mesh: TensorMesh, thickness_mm: float, metric: Metric) -> Array:
    """Return the (n_elements, 9, 9) S integrals of phi_i phi_j det g / t0: what a mode loses, times n^2 pi^2 sigma."""
    first = metric_at_points(mesh, metric)
    determinant = first[..., 0] * first[..., 2] - first[..., 1] ** 2
    weight = WEIGHTS * determinant * np.prod(mesh.sizes_mm, axis=1)[:, None] * MM / thickness_mm
    shapes = values(GAUSS)
    return np.asarray((weight @ np.einsum("qi,qj->qij", shapes, shapes).reshape(-1, 81)).reshape(-1, 9, 9))


def _lines(scene: Scene, box: Box, pieces: Sequence[Piece], axis: int) -> Array:
    """Return a window's lines along one axis: on its ends, and the contacts' and touches' edges inside."""
    low, high = box[axis], box[axis + 2]
    sizes, thickness = scene.electrodes.sizes_mm(), scene.sheet.thickness_mm
    size = float(min(sizes[piece.electrode] for piece in pieces))
    cap = max(MAX_ELEMENT_THICKNESSES * thickness, size / 6)
    edge = EDGE_ELEMENT * min(thickness, size)
    fixed = [(low, cap), (high, cap)]
    for piece in pieces:
        patch = piece.patch_mm(scene.sheet, float(sizes[piece.electrode]))
        fixed += [(patch[axis], edge), (patch[axis + 2], edge)]
    fixed += [(at, edge) for at, _ in touch_lines(scene.touches)[axis] if low < at < high]
    return graded_lines(fixed, cap, max(REFERENCE_MM / scene.element_size_mm, 1.0))


def _key(window: Window) -> bytes:
    """Return what two windows have in common whose admittances are the same, but for rounding."""
    contacts = window.system.contacts
    parts = [window.blocks, window.loss, contacts.mass_m2, contacts.impedance_ohm_m2, contacts.element]
    parts.append(contacts.electrode - contacts.electrode[0])
    return repr(window.system.mesh.shape).encode() + b"".join(_rounded(part) for part in parts)


def _rounded(part: npt.NDArray[np.generic]) -> bytes:
    found = np.asarray(part, dtype=np.float64)
    scaled: Array = np.round(found / max(np.abs(found).max(), 1e-300), 9) + 0.0  # + 0.0 turns -0.0 into 0.0
    return scaled.tobytes() + np.format_float_scientific(np.abs(found).max(), 9).encode()


def _admittance(window: Window) -> Array:
    """Return the (n, n) S admittance of a window's contacts at their own nodes, contact by contact."""
    mesh = window.system.mesh
    nodes, mass, impedance = _under(window)
    own, at = np.unique(nodes, return_inverse=True)
    rest = np.setdiff1d(np.arange(mesh.n_nodes), own)
    stiffness, loss = gathered(mesh, window.blocks), gathered(mesh, window.loss)
    both = stiffness + loss
    filled = rest[np.argsort(_lu(both[rest][:, rest], "MMD_AT_PLUS_A").perm_c)]
    order = np.concatenate([filled, own])
    stiffness, loss = stiffness[order][:, order], loss[order][:, order]
    drop = np.zeros((len(own), len(own)))
    for weight, pole in zip(*poles(), strict=True):
        lu, first = _lu(stiffness + pole * loss, "NATURAL"), len(rest)
        if not np.array_equal(lu.perm_c[first:], np.arange(first, mesh.n_nodes)):
            raise AssertionError("the contact's nodes must be eliminated last")
        # What is left of the matrix after all other nodes are eliminated is the contact's own: L's and U's last block.
        drop += weight * np.linalg.inv(lu.L[first:, first:].toarray() @ lu.U[first:, first:].toarray())
    whole = drop[at][:, at] + impedance[:, None] * np.linalg.inv(mass)
    found = np.linalg.inv((whole + whole.T) / 2)
    return np.asarray((found + found.T) / 2)


def _lu(matrix: csc_array, order: Literal["NATURAL", "MMD_AT_PLUS_A"]) -> Any:
    return splu(csc_array(matrix), permc_spec=order, diag_pivot_thresh=0.0, options={"SymmetricMode": True})


def gathered(mesh: TensorMesh, blocks: Array) -> csc_array:
    """Return the (n_nodes, n_nodes) sum of the elements' (n_elements, 9, 9) blocks."""
    rows, columns = np.repeat(mesh.element_nodes, 9, axis=1).ravel(), np.tile(mesh.element_nodes, (1, 9)).ravel()
    return coo_array((blocks.ravel(), (rows, columns)), (mesh.n_nodes, mesh.n_nodes)).tocsc()


def _under(window: Window) -> tuple[Index, Array, Array]:
    """Return the nodes under each contact in turn.

    Returns:
        The (n,) window nodes, the (n, n) m^2 mass between those of one contact, and its (n,) impedance.
    """
    contacts, mesh = window.system.contacts, window.system.mesh
    owner = contacts.electrode[:, None] * mesh.n_nodes + mesh.element_nodes[contacts.element]
    keys, local = np.unique(owner, return_inverse=True)
    local = local.reshape(owner.shape)
    mass = np.zeros((len(keys), len(keys)))
    np.add.at(mass, (local[:, :, None], local[:, None, :]), contacts.mass_m2)
    impedance = np.zeros(len(keys))
    impedance[local] = contacts.impedance_ohm_m2[:, None]
    return keys % mesh.n_nodes, mass, impedance


def _on_sheet(system: System, window: Window, admittance: Array) -> Plate:
    """Return an admittance between the sheet's nodes: its biquadratic field is read at the window's nodes."""
    fine, own, mesh = window.system.contacts, window.system.mesh, system.mesh
    nodes, electrodes, rows = [], [], []
    for electrode in np.unique(fine.electrode):
        under = np.unique(own.element_nodes[fine.element[fine.electrode == electrode]])
        above = np.unique(mesh.element_nodes[system.contacts.element[system.contacts.electrode == electrode]])
        nodes.append(above)
        electrodes.append(np.full(len(above), electrode))
        rows.append(_interpolation(mesh, above, own.nodes_mm[under]))
    reading = block_diag(*rows)
    return Plate(
        nodes=np.concatenate(nodes),
        electrodes=np.concatenate(electrodes).astype(np.intp),
        admittance=np.asarray(reading.T @ admittance @ reading),
    )


def _interpolation(mesh: TensorMesh, nodes: Index, points: Array) -> Array:
    """Return the (points, nodes) values of the sheet's shape functions at points that lie among these nodes."""
    inside = mesh.nodes_mm[nodes]
    cell = []
    for axis, lines in enumerate((mesh.x_lines_mm, mesh.y_lines_mm)):
        middle = np.clip(points[:, axis], inside[:, axis].min() + 1e-6, inside[:, axis].max() - 1e-6)
        cell.append(np.searchsorted(lines, middle) - 1)
    element = cell[1] * mesh.shape[1] + cell[0]
    shapes = values((points - mesh.corners_mm[element]) / mesh.sizes_mm[element])
    found = np.zeros((len(points), len(nodes)))
    columns = np.searchsorted(nodes, mesh.element_nodes[element])
    np.put_along_axis(found, columns, shapes, axis=1)
    return found
