"""Elements that a touch's border cuts: biquadratic plus a kink, so that a touch keeps its size on any mesh.

Across the border of a touch the potential has a kink, which no polynomial has: an element with the mean conductivity
makes a touch of 10 mm look 2.5 mm too large. A cut element is therefore given two more functions of its own,

    d+(x)  and  d+(x) t(x),   each minus its biquadratic interpolant,   d+ = max(signed distance, 0), t along the border

with the conductivity inside and outside each where it belongs, and the two are eliminated within the element (their
energy is minimised), which leaves a 9 x 9 block like any other's. They vanish at the element's nodes; between them
neighbours may differ a little, as in any immersed finite element, so what counts is only what the touch changes, as in
:mod:`eitskin_sim.fem.borders.cut_blocks`:

    S = S_outside + E_touched - E_outside,       E the minimised energy with the element's own or with one conductivity

Without contrast a touch changes nothing, and S lies between the blocks of the least and the greatest conductivity. A
10 mm square keeps its size within 0.3 mm with elements of 3 mm, 0.1 mm with 2 mm (``eitskin bench physics``).

What this has in common with the generators, and the difference, is in :mod:`eitskin_sim.fem.borders.cut_rule`.

Rules. An element that no border cuts has the conductivity of the last touch that covers it. In a cut one, the touches
that cut it make one inside: where they abut with one conductivity there is no seam. Its outside is the last touch that
covers the element, or the sheet. Contacts on it pass the mean of what they would on either side. Touches with graded
borders come last and multiply what they find (:mod:`eitskin_sim.fem.borders.graded_elements`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from eitskin_sim.arrays import Array, Index
from eitskin_sim.fem.borders.cut_rule import MIN_ENERGY_SHARE, SHARE_TOLERANCE, UNIT_NODES, half_plane_share, union
from eitskin_sim.fem.borders.graded_elements import grade
from eitskin_sim.fem.forward import Factor, System
from eitskin_sim.fem.mesh import MERGE_MM, MM
from eitskin_sim.fem.q2 import gradients
from eitskin_sim.scene.parts import Touch
from eitskin_sim.scene.shapes import Shape

CELLS: Final = 4
"""Cells a side in which a cut element is integrated, with 2 x 2 points each."""


@dataclass(frozen=True, slots=True)
class Touched:
    """The elements and contacts of a system under touches."""

    system: System
    sigma: Array
    """(n_elements,) S/m, the mean over the area of each."""
    blocks: Array
    """(n_elements, 9, 9) S."""
    density: Array
    """(m,) S/m^2, each piece of contact's conductance per area."""
    cut: Index
    """(k,) elements that a border cuts."""


def factorise(system: System, touches: Sequence[Touch]) -> Factor:
    """Return the factorised system under touches, whether or not the mesh follows their borders."""
    touched = touch(system, touches)
    return Factor(system, touched.blocks, touched.density)


def touch(system: System, touches: Sequence[Touch]) -> Touched:
    """Return what touches make of a system's elements and contacts."""
    sharp = [item for item in touches if not item.border_mm]
    pieces = [(shape, item.inside_S_per_m(system.background)) for item in sharp for shape in item.shapes]
    sigma, last, cutting = _cover(system, pieces)
    blocks = sigma[:, None, None] * system.stiffness
    density = system.contacts.density(sigma[system.contacts.element])
    cutting = [elements[last[elements] < number] for number, elements in enumerate(cutting)]
    cut = np.unique(np.concatenate(cutting)) if cutting else np.zeros(0, dtype=np.intp)
    if len(cut):
        phases = _phases(system, pieces, cutting, cut, sigma[cut])
        blocks[cut] = _condensed(system, cut, phases)
        _mix_contacts(system, cut, phases, density)
        sigma[cut] = np.mean(phases.share * phases.inside + (1.0 - phases.share) * phases.outside[:, None], axis=1)
    if len(sharp) < len(touches):
        graded = [item for item in touches if item.border_mm]
        grade(system, graded, _unit_points(), sigma, blocks, density, cut)
    return Touched(system, sigma, blocks, density, cut)


_Pieces = list[tuple[Shape, float]]


def _cover(system: System, pieces: _Pieces) -> tuple[Array, Index, list[Index]]:
    """Return each element's conductivity and last whole cover (-1: none), and the elements that each piece cuts."""
    mesh = system.mesh
    centres, sizes = mesh.centres_mm, mesh.sizes_mm
    reach = np.hypot(sizes[:, 0], sizes[:, 1]) / 2
    sigma = np.full(mesh.n_elements, system.background)
    last = np.full(mesh.n_elements, -1, dtype=np.intp)
    cutting = []
    for number, (shape, conductivity) in enumerate(pieces):
        x0, y0, x1, y1 = shape.bounds_mm
        # Beyond the box by more than rounding: an element that only meets a disc's top on a line is not cut by it.
        low, high = centres - sizes / 2 + MERGE_MM, centres + sizes / 2 - MERGE_MM
        near = np.flatnonzero(np.all((high > [x0, y0]) & (low < [x1, y1]), axis=1))
        distance, normal = shape.distance_mm(centres[near])
        share = half_plane_share(distance, normal, sizes[near])
        crossed = np.abs(distance) < reach[near]
        whole = np.where(crossed, share > 1.0 - SHARE_TOLERANCE, distance < 0.0)
        sigma[near[whole]] = conductivity
        last[near[whole]] = number
        cutting.append(near[crossed & ~whole & (share > SHARE_TOLERANCE)])
    return sigma, last, cutting


@dataclass(frozen=True, slots=True)
class _Phases:
    """Both sides of the border at the q points of each of k cut elements."""

    points: Array
    """(k, q, 2) mm."""
    share: Array
    """(k, q) of the point's cell that lies inside."""
    inside: Array
    """(k, q) S/m."""
    outside: Array
    """(k,) S/m."""
    distance: Array
    """(k, q) mm from the nearest of the borders, negative inside."""
    normal: Array
    """(k, q, 2)"""
    node_distance: Array
    """(k, 9) mm, at the element's nodes."""
    along: Array
    """(k, 2) unit vector along the border."""


def _unit_points() -> Array:
    offsets = 0.5 + np.array([-0.5, 0.5]) / np.sqrt(3.0)
    line = ((np.arange(CELLS)[:, None] + offsets) / CELLS).ravel()
    return np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)


def _phases(system: System, pieces: _Pieces, cutting: list[Index], cut: Index, outside: Array) -> _Phases:
    mesh = system.mesh
    sizes = mesh.sizes_mm[cut]
    points = mesh.corners_mm[cut][:, None, :] + _unit_points() * sizes[:, None, :]
    nodes = _node_positions(system, cut)
    # The last column is the middle: it gives the direction along the border.
    where = np.concatenate([points, nodes, mesh.centres_mm[cut][:, None, :]], axis=1)
    distance, normal = np.full(where.shape[:2], np.inf), np.zeros(where.shape)
    count = points.shape[1]
    share, inside = np.zeros((len(cut), count)), np.repeat(outside[:, None], count, axis=1)
    for (shape, conductivity), elements in zip(pieces, cutting, strict=True):
        if not len(elements):
            continue
        rows = np.searchsorted(cut, elements)
        d, nu = shape.distance_mm(where[rows])
        own = half_plane_share(d[:, :count], nu[:, :count], sizes[rows][:, None, :] / (2 * CELLS))
        nearer = d < distance[rows]
        inside[rows] = np.where((own >= 0.5) | nearer[:, :count] & (share[rows] < 0.5), conductivity, inside[rows])
        share[rows] = union(share[rows], own, np.einsum("kqa,kqa->kq", nu[:, :count], normal[rows][:, :count]))
        distance[rows] = np.where(nearer, d, distance[rows])
        normal[rows] = np.where(nearer[..., None], nu, normal[rows])
    middle = normal[:, -1]
    return _Phases(
        points=points,
        share=share,
        inside=inside,
        outside=outside,
        distance=distance[:, :count],
        normal=normal[:, :count],
        node_distance=distance[:, count:-1],
        along=np.stack([-middle[:, 1], middle[:, 0]], axis=-1),
    )


def _node_positions(system: System, elements: Index) -> Array:
    """Return the (k, 9, 2) positions of the nodes of some elements."""
    mesh = system.mesh
    return mesh.corners_mm[elements][:, None, :] + UNIT_NODES * mesh.sizes_mm[elements][:, None, :]


def _condensed(system: System, cut: Index, phases: _Phases) -> Array:
    """Return the (k, 9, 9) blocks of cut elements, their enrichment functions eliminated."""
    sizes, area = system.mesh.sizes_mm[cut], np.prod(system.mesh.sizes_mm[cut], axis=1)
    conductance = _conductance(system, cut)
    unit_x, unit_y = gradients(_unit_points())
    smooth = np.stack([unit_x / sizes[:, 0, None, None], unit_y / sizes[:, 1, None, None]], axis=1)  # (k, 2, q, 9)
    middle = system.mesh.centres_mm[cut][:, None, :]
    scale = np.sqrt(area)
    t = np.einsum("kqa,ka->kq", phases.points - middle, phases.along) / scale[:, None]
    node_t = np.einsum("kna,ka->kn", _node_positions(system, cut) - middle, phases.along) / scale[:, None]
    node_plus = np.maximum(phases.node_distance, 0.0)
    held = np.stack([node_plus, node_plus * node_t], axis=-1)
    interpolant = smooth @ held[:, None]  # (k, 2, q, 2 functions)
    normal = np.moveaxis(phases.normal, 2, 1)  # (k, 2, q)
    along = phases.along[:, :, None] / scale[:, None, None]
    total, even = np.zeros((len(cut), 11, 11)), np.zeros((len(cut), 11, 11))
    for outer, sigma, share in ((0.0, phases.inside, phases.share), (1.0, phases.outside[:, None], 1.0 - phases.share)):
        plus = outer * phases.distance[:, None]
        kink = np.stack([outer * normal, outer * normal * t[:, None] + plus * along], axis=-1) - interpolant
        gradient = np.concatenate([smooth, kink], axis=-1)
        flux = np.einsum("kab,kbqi->kaqi", conductance, gradient)
        weight = share * (area / share.shape[1])[:, None]
        total += np.einsum("kaqi,kq,kaqj->kij", gradient, sigma * weight, flux, optimize=True)
        even += np.einsum("kaqi,kq,kaqj->kij", gradient, weight, flux, optimize=True)
    floor = MIN_ENERGY_SHARE * np.trace(conductance, axis1=1, axis2=2) * area
    alike = phases.outside[:, None, None]
    change = _eliminated(total, floor * phases.outside) - alike * _eliminated(even, floor)
    return np.asarray(alike * system.stiffness[cut] + change)


def _eliminated(blocks: Array, floor: Array) -> Array:
    """Return (k, 9, 9) energies of (k, 11, 11), minimised over the last two."""
    corner = blocks[:, 9:, 9:] + floor[:, None, None] * np.eye(2)
    coupling = blocks[:, :9, 9:]
    return np.asarray(blocks[:, :9, :9] - coupling @ np.linalg.solve(corner, np.swapaxes(coupling, 1, 2)))


def _conductance(system: System, cut: Index) -> Array:
    """Return the (k, 2, 2) S tensor t0 g^-1 at the middles of some elements, for a conductivity of 1 S/m."""
    E, F, G = system.metric[cut].T
    inverse = np.stack([np.stack([G, -F], axis=-1), np.stack([-F, E], axis=-1)], axis=-2)
    return np.asarray(inverse * (system.thickness_mm * MM / (E * G - F**2) * system.relative[cut])[:, None, None])


def _mix_contacts(system: System, cut: Index, phases: _Phases, density: Array) -> None:
    """Set the density of contacts on cut elements to the mean over their area."""
    contacts = system.contacts
    row = np.searchsorted(cut, contacts.element)
    row = np.where(row < len(cut), row, 0)
    pieces = np.flatnonzero(cut[row] == contacts.element)
    row = row[pieces]
    fringe, impedance = contacts.fringe_m[pieces], contacts.impedance_ohm_m2[pieces]
    inside = 1.0 / (impedance[:, None] + fringe[:, None] / phases.inside[row])
    outside = 1.0 / (impedance + fringe / phases.outside[row])
    density[pieces] = np.mean(phases.share[row] * inside + (1.0 - phases.share[row]) * outside[:, None], axis=1)
