"""Contacts of electrodes anywhere on a mesh: the contribution of each element under one, for patches and for edges.

Electrode l at potential U_l passes the current ::

    I_l = integral over the contact of kappa (U_l - u),      kappa = 1 / z_eff per deformed area, patch
                                                             kappa = t / z     per deformed length, edge

Edges need not follow mesh lines: each element adds its covered part, so one mesh serves the electrodes of every device.
A patch passes a finite current per area, so under its edge the potential keeps a continuous slope: elements that the
edge divides lose little, and their integrals are exact, since Gauss's points lie in the covered part alone. A contact
on the sheet's edge passes a finite current per length, and covers parts of elements' sides likewise. Where it goes
round a corner the element there has two covered sides, whose integrals add up to one piece of contact.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from eitskin_sim.arrays import Array, Index
from eitskin_sim.fem.mesh import MM, Metric, TensorMesh
from eitskin_sim.fem.q2 import GAUSS, LINE_POINTS, LINE_WEIGHTS, WEIGHTS, values
from eitskin_sim.scene.electrodes import Piece, place
from eitskin_sim.scene.layer import is_uneven, relative_conductivity
from eitskin_sim.scene.parts import Electrodes, Sheet

FRINGE_SHARE: Final = 0.2
"""The share c of the layer's thickness that a face contact's current crosses."""

MIN_OVERLAP_MM: Final = 1e-6
"""An element that is covered by less along a side is not under the electrode."""


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


def contacts_of(
    mesh: TensorMesh,
    sheet: Sheet,
    electrodes: Electrodes,
    metric: Metric,
    pieces: Sequence[Piece] | None = None,
) -> Contacts:
    """Return the contacts of electrodes, one piece for each element and electrode.

    Args:
        mesh: Of any part of the sheet.
        sheet: The flat layer.
        electrodes: Of what kind and size.
        metric: The bent surface's first fundamental form.
        pieces: Where the electrodes lie; None is all of them.
    """
    pieces = place(sheet, electrodes) if pieces is None else pieces
    if electrodes.contact == "patch":
        parts = [_patches(mesh, sheet, pieces, electrodes.sizes_mm(), metric)]
    else:
        parts = [_edge(mesh, sheet, one, metric) for one in pieces]
    element, electrode, mass, load, fringe = (np.concatenate(column) for column in zip(*parts, strict=True))
    pair = np.column_stack([element, electrode])
    _, first, back = np.unique(pair, axis=0, return_index=True, return_inverse=True)
    kept = np.sort(first)
    own = np.searchsorted(kept, first[back.ravel()])
    masses, loads = np.zeros((len(kept), 9, 9)), np.zeros((len(kept), 9))
    np.add.at(masses, own, mass)
    np.add.at(loads, own, load)
    owner = electrode[kept].astype(np.intp)
    return Contacts(
        element=element[kept].astype(np.intp),
        electrode=owner,
        mass_m2=masses,
        load_m2=loads,
        area_m2=loads.sum(axis=1),
        impedance_ohm_m2=electrodes.impedances_ohm_m2()[owner],
        fringe_m=fringe[kept],
    )


def check_apart(contacts: Contacts) -> Contacts:
    """Return contacts as they are.

    Raises:
        ValueError: Two electrodes meet one element.
    """
    if len(np.unique(contacts.element)) < len(contacts.element):
        raise ValueError(
            "two electrodes meet one element; expected them further apart: make the electrodes or their uncertainties "
            "smaller"
        )
    return contacts


Part = tuple[Index, Index, Array, Array, Array]
"""Of one piece: (m,) elements, (m,) its electrode, and (m, 9, 9) masses, (m, 9) loads and (m,) fringes."""


def _elements_along(mesh: TensorMesh, side: int, steps: Index) -> Index:
    """Return the (m,) elements at a side of the sheet, 0 to 3, by the (m,) steps of the mesh along it."""
    ny, nx = mesh.shape
    return {0: steps, 1: steps * nx + nx - 1, 2: (ny - 1) * nx + steps, 3: steps * nx}[side]


def _covered(lines: Array, low: float, high: float) -> tuple[Index, Array, Array]:
    """Return which cells of lines an interval covers, and where in each, from 0 to 1."""
    first = max(int(np.searchsorted(lines, low + MIN_OVERLAP_MM, side="right")) - 1, 0)
    last = min(int(np.searchsorted(lines, high - MIN_OVERLAP_MM, side="left")), len(lines) - 1)
    cell = np.arange(first, last)
    size = lines[cell + 1] - lines[cell]
    return (
        cell,
        (np.maximum(lines[cell], low) - lines[cell]) / size,
        (np.minimum(lines[cell + 1], high) - lines[cell]) / size,
    )


def _patches(mesh: TensorMesh, sheet: Sheet, pieces: Sequence[Piece], sizes_mm: Array, metric: Metric) -> Part:
    """Return what :func:`_edge` does, of square contacts; of all at once, since each call of a metric is slow."""
    found = []
    for piece in pieces:
        x0, y0, x1, y1 = piece.patch_mm(sheet, float(sizes_mm[piece.electrode]))
        columns, left, right = _covered(mesh.x_lines_mm, x0, x1)
        rows, bottom, top = _covered(mesh.y_lines_mm, y0, y1)
        low, high = (np.stack(np.meshgrid(*ends), axis=-1).reshape(-1, 2) for ends in ((left, bottom), (right, top)))
        found.append(((rows[:, None] * mesh.shape[1] + columns).ravel(), low, high, np.full(len(low), piece.electrode)))
    element, low, high, electrode = (np.concatenate(column) for column in zip(*found, strict=True))
    unit = low[:, None, :] + GAUSS * (high - low)[:, None, :]  # (e, 9, 2)
    sizes = mesh.sizes_mm[element]
    where = mesh.corners_mm[element][:, None, :] + unit * sizes[:, None, :]
    first = metric(where.reshape(-1, 2)).reshape(len(element), len(GAUSS), 3)
    area = np.sqrt(first[..., 0] * first[..., 2] - first[..., 1] ** 2)
    covered = np.prod(sizes * (high - low), axis=1)
    weight = WEIGHTS * area * covered[:, None] * MM**2
    shapes = values(unit.reshape(-1, 2)).reshape(len(element), len(GAUSS), 9)
    load = np.einsum("eq,eqi->ei", weight, shapes)
    mass = np.einsum("eq,eqi,eqj->eij", weight, shapes, shapes)
    fringe = FRINGE_SHARE * sheet.thickness_mm * MM / (area @ WEIGHTS)
    if is_uneven(sheet):  # current crosses a layer that conducts so much better or worse
        fringe = fringe / (relative_conductivity(sheet, where, first) @ WEIGHTS)
    return element, electrode, mass, load, fringe


def _edge(mesh: TensorMesh, sheet: Sheet, piece: Piece, metric: Metric) -> Part:
    """Return a straight piece of the border."""
    along_x, far = piece.side in (0, 2), piece.side in (1, 2)
    steps, low, high = _covered(mesh.x_lines_mm if along_x else mesh.y_lines_mm, piece.start_mm, piece.stop_mm)
    element = _elements_along(mesh, piece.side, steps)
    along = low[:, None] + LINE_POINTS * (high - low)[:, None]
    across = np.full(along.shape, 1.0 if far else 0.0)
    unit = np.stack([along, across] if along_x else [across, along], axis=-1)  # (e, 3, 2)
    sizes = mesh.sizes_mm[element]
    where = mesh.corners_mm[element][:, None, :] + unit * sizes[:, None, :]
    first = metric(where.reshape(-1, 2)).reshape(*along.shape, 3)
    stretch = np.sqrt(first[..., 0 if along_x else 2])
    thickness = sheet.thickness_mm * MM / np.sqrt(first[..., 0] * first[..., 2] - first[..., 1] ** 2)
    covered = sizes[:, 0 if along_x else 1] * (high - low)
    weight = LINE_WEIGHTS * stretch * thickness * covered[:, None] * MM
    shapes = values(unit.reshape(-1, 2)).reshape(*along.shape, 9)
    load = np.einsum("eq,eqi->ei", weight, shapes)
    mass = np.einsum("eq,eqi,eqj->eij", weight, shapes, shapes)
    return element, np.full(len(element), piece.electrode), mass, load, np.zeros(len(element))
