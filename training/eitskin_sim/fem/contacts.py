"""Contacts of electrodes on a mesh: the contribution of each element under one, for patches and for edges.

Electrode l at potential U_l passes the current ::

    I_l = integral over the contact of kappa (U_l - u),      kappa = 1 / z_eff per deformed area, patch
                                                             kappa = t / z     per deformed length, edge
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from eitskin_sim.arrays import Array, Index
from eitskin_sim.fem.mesh import MM, Metric, TensorMesh
from eitskin_sim.fem.q2 import GAUSS, WEIGHTS, edge_integrals, values
from eitskin_sim.scene.electrodes import Piece
from eitskin_sim.scene.parts import Electrodes, Sheet

FRINGE_SHARE: Final = 0.2
"""The share c of the layer's thickness that a face contact's current crosses."""

SHAPES: Final[Array] = values(GAUSS)
"""(9 points, 9 nodes) of a whole element."""

SQUARES: Final[Array] = np.einsum("qi,qj->qij", SHAPES, SHAPES).reshape(-1, 81)
"""(9 points, 81) their products."""


@dataclass(frozen=True, slots=True)
class Contacts:
    """What each element under an electrode adds; m pieces of contact in all.

    A piece of conductance density kappa adds kappa * mass to its element's block, -kappa * load between its nodes and
    its electrode, and kappa * area to the electrode's diagonal. Nodes off the contact have zero rows.
    """

    element: Index
    """(m,)"""
    electrode: Index
    """(m,)"""
    mass_m2: Array
    """(m, 9, 9) integral of phi_i phi_j over the contact."""
    load_m2: Array
    """(m, 9) integral of phi_i."""
    area_m2: Array
    """(m,) deformed area; for an edge contact the border's length times the layer's thickness."""
    impedance_ohm_m2: Array
    """(m,) of the electrode above."""
    fringe_m: Array
    """(m,) FRINGE_SHARE times the deformed thickness for a patch, 0 for an edge."""

    def density(self, sigma: Array) -> Array:
        """Return the (m,) conductance per area, S/m^2, where element ``element[i]`` has conductivity ``sigma[i]``."""
        return np.asarray(1.0 / (self.impedance_ohm_m2 + self.fringe_m / sigma))


def _line(lines: Array, position: float, what: str) -> int:
    index = int(np.argmin(np.abs(lines - position)))
    if abs(lines[index] - position) > 2e-6:
        raise ValueError(
            f"{what} is at {position:g} mm; the mesh's nearest line is at {lines[index]:g}: add a line there"
        )
    return index


def contacts_of(
    mesh: TensorMesh, sheet: Sheet, electrodes: Electrodes, metric: Metric, area: Array, pieces: Sequence[Piece]
) -> Contacts:
    """Return the contacts of electrodes on a mesh whose lines hold their edges.

    Args:
        mesh: Of any part of the sheet.
        sheet: The flat layer.
        electrodes: Of what kind and size.
        metric: The bent surface's first fundamental form.
        area: (n_elements, 9) deformed area per flat area at every element's points of Gauss.
        pieces: Where the electrodes lie.

    Raises:
        ValueError: An electrode's edge is no line of the mesh.
    """
    if electrodes.contact == "patch":
        sizes = electrodes.sizes_mm()
        return gathered([_patch(mesh, sheet, one, float(sizes[one.electrode]), area) for one in pieces], electrodes)
    return gathered([_edge(mesh, sheet, one, metric) for one in pieces], electrodes)


Part = tuple[Index, Index, Array, Array, Array]
"""Of one piece: (m,) elements, (m,) its electrode, and (m, 9, 9) masses, (m, 9) loads and (m,) fringes."""


def gathered(parts: Sequence[Part], electrodes: Electrodes) -> Contacts:
    """Return the contacts of electrodes from what each of their pieces adds."""
    element, electrode, mass, load, fringe = (np.concatenate(column) for column in zip(*parts, strict=True))
    return Contacts(
        element=element.astype(np.intp),
        electrode=electrode.astype(np.intp),
        mass_m2=mass,
        load_m2=load,
        area_m2=load.sum(axis=1),
        impedance_ohm_m2=electrodes.impedances_ohm_m2()[electrode.astype(np.intp)],
        fringe_m=fringe,
    )


def elements_along(mesh: TensorMesh, side: int, steps: Index) -> Index:
    """Return the (m,) elements at a side of the sheet, 0 to 3, by the (m,) steps of the mesh along it."""
    ny, nx = mesh.shape
    return {0: steps, 1: steps * nx + nx - 1, 2: (ny - 1) * nx + steps, 3: steps * nx}[side]


def _patch(mesh: TensorMesh, sheet: Sheet, piece: Piece, size_mm: float, area: Array) -> Part:
    x0, y0, x1, y1 = piece.patch_mm(sheet, size_mm)
    what = f"electrode {piece.electrode}'s edge"
    columns = np.arange(_line(mesh.x_lines_mm, x0, what), _line(mesh.x_lines_mm, x1, what))
    rows = np.arange(_line(mesh.y_lines_mm, y0, what), _line(mesh.y_lines_mm, y1, what))
    element = (rows[:, None] * mesh.shape[1] + columns).ravel()
    size = np.multiply.outer(np.diff(mesh.y_lines_mm)[rows], np.diff(mesh.x_lines_mm)[columns]).ravel()
    weight = WEIGHTS * area[element] * size[:, None] * MM**2
    mass = (weight @ SQUARES).reshape(-1, 9, 9)
    fringe = FRINGE_SHARE * sheet.thickness_mm * MM / (area[element] @ WEIGHTS)
    return element, np.full(len(element), piece.electrode), mass, weight @ SHAPES, fringe


def _edge(mesh: TensorMesh, sheet: Sheet, piece: Piece, metric: Metric) -> Part:
    along_x = piece.side in (0, 2)
    lines = mesh.x_lines_mm if along_x else mesh.y_lines_mm
    what = f"electrode {piece.electrode}'s end"
    steps = np.arange(_line(lines, piece.start_mm, what), _line(lines, piece.stop_mm, what))
    element = elements_along(mesh, piece.side, steps)
    points, weights, shapes = edge_integrals(piece.side)
    where = mesh.corners_mm[element][:, None, :] + points * mesh.sizes_mm[element][:, None, :]
    first = metric(where.reshape(-1, 2)).reshape(len(element), len(points), 3)
    stretch = np.sqrt(first[..., 0] if along_x else first[..., 2])
    thickness = sheet.thickness_mm * MM / np.sqrt(first[..., 0] * first[..., 2] - first[..., 1] ** 2)
    size = mesh.sizes_mm[element][:, 0 if along_x else 1]
    weight = weights * stretch * thickness * size[:, None] * MM
    mass = (weight @ np.einsum("qi,qj->qij", shapes, shapes).reshape(-1, 81)).reshape(-1, 9, 9)
    return element, np.full(len(element), piece.electrode), mass, weight @ shapes, np.zeros(len(element))
