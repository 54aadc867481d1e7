"""Contacts of electrodes whose edges do not follow mesh lines: each element adds its covered part.

One mesh then serves the electrodes of every device, and a touch's geometry, which depends on the mesh, serves them all.
A patch passes a finite current per area, so under its edge the potential keeps a continuous slope: elements that the
edge divides lose little, and their integrals are exact, since Gauss's points lie in the covered part alone. A contact
on the sheet's edge passes a finite current per length, and covers parts of elements' sides likewise. Where it goes
round a corner the element there has two covered sides, whose integrals add up to one piece of contact.
"""

from dataclasses import replace

import numpy as np

from eitskin_sim.arrays import Array, Index
from eitskin_sim.fem.contacts import FRINGE_SHARE, Contacts, Part, elements_along, gathered
from eitskin_sim.fem.forward import System, assemble
from eitskin_sim.fem.mesh import MM, Metric, TensorMesh
from eitskin_sim.fem.q2 import GAUSS, LINE_POINTS, LINE_WEIGHTS, WEIGHTS, values
from eitskin_sim.scene.electrodes import Piece, place
from eitskin_sim.scene.layer import is_uneven, relative_conductivity
from eitskin_sim.scene.parts import Electrodes, Sheet

MIN_OVERLAP_MM = 1e-6
"""An element that is covered by less along a side is not under the electrode."""


def system_on(mesh: TensorMesh, sheet: Sheet, electrodes: Electrodes, metric: Metric, nominal: Electrodes) -> System:
    """Return the system of a mesh whose lines hold the edges of the nominal electrodes, for any electrodes.

    Args:
        mesh: Covers the sheet.
        sheet: The flat layer.
        electrodes: Where current enters.
        metric: The bent surface's first fundamental form.
        nominal: Whose edges the lines hold.

    Raises:
        ValueError: Two electrodes beside the mesh's lines meet one element.
    """
    if electrodes == nominal:
        system = assemble(mesh, sheet, electrodes, metric)
        return replace(system, contacts=one_an_element(system.contacts))
    system = assemble(mesh, sheet, nominal, metric)
    return replace(system, contacts=loose_contacts(mesh, sheet, electrodes, metric))


def loose_contacts(mesh: TensorMesh, sheet: Sheet, electrodes: Electrodes, metric: Metric) -> Contacts:
    """Return the contacts of electrodes anywhere on the border, on any mesh of the sheet.

    Raises:
        ValueError: Two electrodes meet one element.
    """
    pieces = place(sheet, electrodes)
    if electrodes.contact == "patch":
        sizes = electrodes.sizes_mm()
        parts = [_patch(mesh, sheet, piece, float(sizes[piece.electrode]), metric) for piece in pieces]
    else:
        parts = [_edge(mesh, sheet, piece, metric) for piece in pieces]
    return check_apart(one_an_element(gathered(parts, electrodes)))


def one_an_element(contacts: Contacts) -> Contacts:
    """Return contacts with one piece for each element and electrode: a corner's two sides are added up."""
    pair = np.column_stack([contacts.element, contacts.electrode])
    unique, first, back = np.unique(pair, axis=0, return_index=True, return_inverse=True)
    if len(unique) == len(pair):
        return contacts
    order = np.argsort(first)
    place = np.argsort(order)[back.ravel()]
    mass, load, area = (np.zeros((len(unique), *one.shape[1:])) for one in (contacts.mass_m2, contacts.load_m2, back))
    np.add.at(mass, place, contacts.mass_m2)
    np.add.at(load, place, contacts.load_m2)
    np.add.at(area, place, contacts.area_m2)
    kept = first[order]
    return Contacts(
        element=contacts.element[kept],
        electrode=contacts.electrode[kept],
        mass_m2=mass,
        load_m2=load,
        area_m2=area,
        impedance_ohm_m2=contacts.impedance_ohm_m2[kept],
        fringe_m=contacts.fringe_m[kept],
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


def _patch(mesh: TensorMesh, sheet: Sheet, piece: Piece, size_mm: float, metric: Metric) -> Part:
    x0, y0, x1, y1 = piece.patch_mm(sheet, size_mm)
    columns, left, right = _covered(mesh.x_lines_mm, x0, x1)
    rows, bottom, top = _covered(mesh.y_lines_mm, y0, y1)
    element = (rows[:, None] * mesh.shape[1] + columns).ravel()
    low = np.stack([a.ravel() for a in np.meshgrid(left, bottom)], axis=-1)
    high = np.stack([a.ravel() for a in np.meshgrid(right, top)], axis=-1)
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
    return element, np.full(len(element), piece.electrode), mass, load, fringe


def _edge(mesh: TensorMesh, sheet: Sheet, piece: Piece, metric: Metric) -> Part:
    """Return what :func:`_patch` does, of a straight piece of the border."""
    along_x, far = piece.side in (0, 2), piece.side in (1, 2)
    steps, low, high = _covered(mesh.x_lines_mm if along_x else mesh.y_lines_mm, piece.start_mm, piece.stop_mm)
    element = elements_along(mesh, piece.side, steps)
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
