"""The voltages of a bent sheet: complete electrode model, biquadratic elements, one sparse factorisation.

In flat coordinates div(K grad u) = 0 with K^{ab} = sigma t0 g^{ab}: the layer keeps its volume, so its thickness is
t0 / sqrt(det g) and the rest of the surface measure cancels. Electrode l at potential U_l passes the current

    I_l = integral over the contact of kappa (U_l - u),      kappa = 1 / z_eff per deformed area, patch
                                                             kappa = t / z     per deformed length, edge

where a patch has z_eff = z + FRINGE * t / sigma: current leaves a face contact through the layer's own thickness, which
a sheet has lost. Stiffness is linear in sigma, so a :class:`System` keeps the element blocks at sigma = 1 and solves
for any conductivity. Where the layer is uneven, or conducts otherwise where it is stretched, sigma is multiplied by
:func:`eitskin_sim.scene.layer.relative_conductivity` at every point, under touches too.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array, csc_array
from scipy.sparse.linalg import splu

from eitskin_proto.sensor.table import FULL_TABLE, N_ELECTRODES, RECIPROCAL_IN_FULL, ROW_IN_FULL, TABLE
from eitskin_sim.arrays import Array, Index
from eitskin_sim.fem.contacts import Contacts, contacts_of
from eitskin_sim.fem.mesh import MM, Metric, TensorMesh
from eitskin_sim.fem.q2 import GAUSS, WEIGHTS, gradients
from eitskin_sim.scene.electrodes import Piece, place
from eitskin_sim.scene.layer import is_uneven, relative_conductivity
from eitskin_sim.scene.parts import Electrodes, Sheet


@dataclass(frozen=True, slots=True)
class System:
    """One mesh, one bend, one set of electrodes, ready for any conductivity."""

    mesh: TensorMesh
    contacts: Contacts
    stiffness: Array
    """(n_elements, 9, 9) S for a conductivity of 1 S/m."""
    metric: Array
    """(n_elements, 3) E, F, G at the middles."""
    thickness_mm: float
    """Before it is bent."""
    background: float
    """S/m, the untouched sheet's nominal conductivity."""
    relative: Array
    """(n_elements,) conductivity over the nominal at the middles, 1 on an even sheet; ``stiffness`` and the contacts'
    fringe have it already, so conductivities are given as if the layer were even."""

    def factorise(self, sigma: Array | None = None) -> "Factor":
        """Return the factorised system for conductivities (n_elements,) in S/m."""
        if sigma is None:
            sigma = np.full(self.mesh.n_elements, self.background)
        blocks = np.asarray(sigma)[:, None, None] * self.stiffness
        return Factor(self, blocks, self.contacts.density(np.asarray(sigma)[self.contacts.element]))


@dataclass(frozen=True, slots=True)
class Plate:
    """The contacts' admittance between n nodes and their electrodes: the current out of each node is (Y (u - U))_i."""

    nodes: Index
    """(n,); a node on the edge between two contacts stands here once for each."""
    electrodes: Index
    """(n,) the electrode over each."""
    admittance: Array
    """(n, n) S, symmetric."""


class Factor:
    """A factorised system and its fields for unit currents.

    Args:
        system: The mesh and the contacts.
        blocks: (n_elements, 9, 9) S, each element's stiffness with its conductivity.
        density: (m,) S/m^2, each piece of contact's conductance per area; zeros where plates take its place.
        plates: Contacts that join all nodes under them, as those of :mod:`eitskin_sim.fem.depth` do.
    """

    def __init__(self, system: System, blocks: Array, density: Array, plates: Sequence[Plate] = ()) -> None:
        self.system, self.blocks, self.density, self.plates = system, blocks, density, tuple(plates)
        lu = splu(
            system_matrix(system.mesh, system.contacts, blocks, density, self.plates),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
        n_nodes = system.mesh.n_nodes
        held = np.arange(N_ELECTRODES - 1)
        currents = np.zeros((n_nodes + len(held), len(held)))
        currents[n_nodes + held, held] = 1.0
        full = np.zeros((n_nodes + N_ELECTRODES, N_ELECTRODES))
        full[:-1, :-1] = lu.solve(currents)
        drives = full - np.roll(full, -1, axis=1)
        self.node_fields: Array = drives[:n_nodes]
        """(n_nodes, 16) V under each adjacent drive of 1 A: by reciprocity also the adjoint field of each measure."""
        self.electrode_fields: Array = drives[n_nodes:]
        """(16 electrodes, 16 drives) V."""

    def element_fields(self) -> Array:
        """Return the (n_elements, 9, 16) fields, each element's middle at zero: differences keep their digits."""
        fields = self.node_fields[self.system.mesh.element_nodes]
        return np.asarray(fields - fields[:, 4:5])

    def contact_drops(self) -> Array:
        """Return the (m, 9, 16) voltages between each contact element's nodes and its electrode."""
        contacts = self.system.contacts
        at = self.system.mesh.element_nodes[contacts.element]
        return np.asarray(self.node_fields[at] - self.electrode_fields[contacts.electrode][:, None, :])

    def element_powers(self, sigma: Array) -> Array:
        """Return the (n_elements, 16, 16) change of x A x by the logarithm of each element's conductivity.

        Args:
            sigma: (n_elements,) S/m under the contacts.
        """
        contacts, fields = self.system.contacts, self.element_fields()
        power = np.swapaxes(fields, 1, 2) @ (self.blocks @ fields)
        if contacts.fringe_m.any():
            drops = self.contact_drops()
            rate = self.density**2 * contacts.fringe_m / sigma[contacts.element]
            through = np.swapaxes(drops, 1, 2) @ (contacts.mass_m2 @ drops) * rate[:, None, None]
            np.add.at(power, contacts.element, through)
        return np.asarray(power)

    def contact_powers(self, contacts: Contacts, density: Array) -> Array:
        """Return the (16, 16, 16) share of x A x that each electrode's contact has, of contacts anywhere on the mesh.

        Args:
            contacts: m pieces of contact.
            density: (m,) S/m^2, their conductance per area.
        """
        at = self.system.mesh.element_nodes[contacts.element]
        drops = self.node_fields[at] - self.electrode_fields[contacts.electrode][:, None, :]
        each = np.swapaxes(drops, 1, 2) @ ((density[:, None, None] * contacts.mass_m2) @ drops)
        found = np.zeros((N_ELECTRODES, N_ELECTRODES, N_ELECTRODES))
        np.add.at(found, contacts.electrode, each)
        return found

    def differences(self) -> Array:
        """Return the (16 drives, 16 measures) voltages U[m] - U[m + 1], by b_m x_k + b_k x_m - x_k A x_m.

        The error of the fields enters this energy squared, and it is taken from differences within elements, so what
        the factorisation loses (1e-9 on the weakest channels of a steeply graded mesh) does not show.
        """
        fields, drops = self.element_fields(), self.contact_drops()
        energy = np.tensordot(fields, self.blocks @ fields, axes=([0, 1], [0, 1]))
        through = (self.density[:, None, None] * self.system.contacts.mass_m2) @ drops
        energy += np.tensordot(drops, through, axes=([0, 1], [0, 1]))
        for plate in self.plates:
            drop = self.node_fields[plate.nodes] - self.electrode_fields[plate.electrodes]
            energy += drop.T @ plate.admittance @ drop
        straight = self.electrode_fields - np.roll(self.electrode_fields, -1, axis=0)
        return np.asarray(straight.T + straight - energy.T)

    def voltages(self, table: npt.NDArray[np.uint8] = TABLE) -> Array:
        """Return the (rows,) V that a table of drives and measures reads under 1 A."""
        return np.asarray(self.differences()[table[:, 0], table[:, 1]])

    def polished(self) -> Array:
        """Return the (16 drives, 16 electrodes) potentials that :meth:`differences` add up to, of mean zero."""
        steps = np.zeros((N_ELECTRODES, N_ELECTRODES))
        steps[:, 1:] = -np.cumsum(self.differences()[:, :-1], axis=1)
        return _centred(steps)


def _centred(potentials: Array) -> Array:
    return np.asarray(potentials - potentials.mean(axis=1, keepdims=True))


def reciprocity_error(factor: Factor) -> float:
    """Return the largest relative difference between a row of the 104 and its reciprocal, row by row."""
    full = factor.voltages(FULL_TABLE)
    straight, swapped = full[ROW_IN_FULL], full[RECIPROCAL_IN_FULL]
    return float(np.max(np.abs(straight - swapped) / np.abs(straight)))


def flat_metric(xy_mm: Array) -> Array:
    """Return the metric of a sheet that is not stretched."""
    return np.tile([1.0, 0.0, 1.0], (len(xy_mm), 1))


def assemble(mesh: TensorMesh, sheet: Sheet, electrodes: Electrodes, metric: Metric = flat_metric) -> System:
    """Return the system of a mesh; it is most accurate where lines hold the electrodes' edges.

    Args:
        mesh: Covers the sheet.
        sheet: The flat layer.
        electrodes: Where current enters.
        metric: The bent surface's first fundamental form.

    Raises:
        ValueError: The mesh does not cover the sheet.
    """
    for lines, extent, name in ((mesh.x_lines_mm, sheet.size_mm[0], "x"), (mesh.y_lines_mm, sheet.size_mm[1], "y")):
        if abs(lines[0]) > 1e-9 or abs(lines[-1] - extent) > 1e-9:
            raise ValueError(
                f"mesh {name} lines go from {lines[0]:g} to {lines[-1]:g} mm; they must go from 0 to {extent:g}"
            )
    return assemble_pieces(mesh, sheet, electrodes, metric, place(sheet, electrodes))


def assemble_pieces(
    mesh: TensorMesh, sheet: Sheet, electrodes: Electrodes, metric: Metric, pieces: Sequence[Piece]
) -> System:
    """Return the system of a mesh of any part of the sheet and of the contacts that lie on it; see :func:`assemble`."""
    first, middle = metric_at_points(mesh, metric), metric(mesh.centres_mm)
    contacts = contacts_of(mesh, sheet, electrodes, metric, pieces)
    relative, at_middles = np.ones(first.shape[:2]), np.ones(mesh.n_elements)
    if is_uneven(sheet):
        relative = relative_conductivity(sheet, points_mm(mesh), first)
        at_middles = relative_conductivity(sheet, mesh.centres_mm, middle)
    return System(
        mesh=mesh,
        contacts=contacts,
        stiffness=_stiffness(mesh, sheet.thickness_mm, first, relative),
        metric=middle,
        thickness_mm=sheet.thickness_mm,
        background=sheet.conductivity_S_per_m,
        relative=at_middles,
    )


def metric_at_points(mesh: TensorMesh, metric: Metric) -> Array:
    """Return the (n_elements, 9, 3) metric at every element's points of Gauss."""
    return metric(points_mm(mesh).reshape(-1, 2)).reshape(mesh.n_elements, len(GAUSS), 3)


def points_mm(mesh: TensorMesh) -> Array:
    """Return the (n_elements, 9, 2) points of Gauss of every element."""
    return np.asarray(mesh.corners_mm[:, None, :] + GAUSS * mesh.sizes_mm[:, None, :])


def conductances(system: System) -> Array:
    """Return the (n_elements, 3) conductances xx, xy, yy of unit elements at 1 S/m, S, at the middles."""
    return conductance_of(system.metric, system) * system.relative[:, None]


def conductance_of(first: Array, system: System) -> Array:
    """Return the (n_elements, 3) conductances of unit elements for metrics (n_elements, 3), on an even layer."""
    E, F, G = first.T
    ratio = system.mesh.sizes_mm[:, 1] / system.mesh.sizes_mm[:, 0]
    return np.asarray(system.thickness_mm * MM / (E * G - F**2) * np.stack([G * ratio, -F, E / ratio])).T


def _stiffness(mesh: TensorMesh, thickness_mm: float, first: Array, relative: Array) -> Array:
    """Integrate t0 relative grad phi_i . g^-1 grad phi_j over every element."""
    determinant = first[..., 0] * first[..., 2] - first[..., 1] ** 2
    if determinant.min() <= 0.0:
        raise ValueError(f"the metric's determinant falls to {determinant.min():.3g}; it must be above 0")
    factor = thickness_mm * MM * WEIGHTS / determinant * relative
    dx, dy = mesh.sizes_mm.T
    along_x, along_y = gradients(GAUSS)  # (9 points, 9 nodes) on the unit square
    xx = np.einsum("qi,qj->qij", along_x, along_x)
    yy = np.einsum("qi,qj->qij", along_y, along_y)
    xy = np.einsum("qi,qj->qij", along_x, along_y)
    xy = xy + np.swapaxes(xy, 1, 2)
    coefficients = np.concatenate(
        [
            factor * first[..., 2] * (dy / dx)[:, None],
            -factor * first[..., 1],
            factor * first[..., 0] * (dx / dy)[:, None],
        ],
        axis=1,
    )
    table = np.concatenate([xx, xy, yy]).reshape(-1, 81)
    return np.asarray((coefficients @ table).reshape(-1, 9, 9))


def system_matrix(
    mesh: TensorMesh, contacts: Contacts, blocks: Array, density: Array, plates: Sequence[Plate] = ()
) -> csc_array:
    """Return all blocks added up, nodes first, then electrodes; electrode 15 is the ground and has no row."""
    nodes, count, last = mesh.element_nodes, mesh.n_nodes, N_ELECTRODES - 1
    total = blocks.copy()
    np.add.at(total, contacts.element, density[:, None, None] * contacts.mass_m2)
    held = contacts.electrode < last
    at = nodes[contacts.element[held]]
    load = -density[held, None] * contacts.load_m2[held]
    terminal = np.broadcast_to(count + contacts.electrode[held][:, None], at.shape)
    own: Array = np.zeros(N_ELECTRODES)
    np.add.at(own, contacts.electrode, density * contacts.area_m2)
    diagonal = count + np.arange(last)
    rows = [np.repeat(nodes, 9, axis=1).ravel(), at.ravel(), terminal.ravel(), diagonal]
    columns = [np.tile(nodes, (1, 9)).ravel(), terminal.ravel(), at.ravel(), diagonal]
    data: list[Array] = [total.ravel(), load.ravel(), load.ravel(), own[:-1]]
    for plate in plates:
        _add_plate(plate, count, rows, columns, data)
    entries = (np.concatenate(data), (np.concatenate(rows), np.concatenate(columns)))
    return coo_array(entries, (count + last, count + last)).tocsc()


def _add_plate(plate: Plate, count: int, rows: list[Index], columns: list[Index], data: list[Array]) -> None:
    """Append Y between the nodes, -Y E between nodes and electrodes, and E^T Y E between those; E says who is where."""
    at, n = plate.nodes, len(plate.nodes)
    held = np.unique(plate.electrodes[plate.electrodes < N_ELECTRODES - 1])
    over = (plate.electrodes[:, None] == held).astype(np.float64)
    terminal = count + held
    load = -plate.admittance @ over
    own = -over.T @ load
    k = len(terminal)
    rows += [np.repeat(at, n), np.repeat(at, k), np.tile(terminal, n), np.repeat(terminal, k)]
    columns += [np.tile(at, n), np.tile(terminal, n), np.repeat(at, k), np.tile(terminal, k)]
    data += [plate.admittance.ravel(), load.ravel(), load.ravel(), own.ravel()]
