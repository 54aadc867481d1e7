"""A scene's elements under touches: whether or not the mesh follows their borders.

Rules. An element that no border cuts has the conductivity of the last touch that covers it. In a cut one
(:mod:`eitskin_sim.fem.borders.cut_blocks`), the touches that cut it make one inside: where they abut with one
conductivity there is no seam. Its outside is the last touch that covers the element, or the sheet. Contacts on it pass
the mean of what they would on either side. A 10 mm square keeps its size within 0.3 mm with elements of 3 mm, 0.1 mm
with 2 mm (``eitskin bench physics``).

Touches with graded borders come last and multiply what they find, point by point. A scene's mesh follows a graded
border in steps of a quarter to half of its width, so biquadratic elements need no kink there. Where several touches
reach an element their contrasts multiply.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from eitskin_sim.arrays import Array, Index
from eitskin_sim.fem.borders.cut_blocks import cut_blocks
from eitskin_sim.fem.borders.cut_rule import SHARE_TOLERANCE
from eitskin_sim.fem.borders.cut_touches import Pairs, pairs_of, united
from eitskin_sim.fem.borders.enrichment import PRODUCTS, UNIT_POINTS
from eitskin_sim.fem.borders.graded import plateau
from eitskin_sim.fem.forward import Factor, System, conductances
from eitskin_sim.fem.mesh import MERGE_MM
from eitskin_sim.scene.parts import Touch
from eitskin_sim.scene.shapes import Shape


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
    sigma, pairs = _cover(system, pieces)
    blocks, under = sigma[:, None, None] * system.stiffness, system.contacts.element
    density = system.contacts.density(sigma[under])
    cut = np.zeros(0, dtype=np.intp)
    if len(pairs.element):
        outside = sigma
        cuts = united(pairs, system.mesh, outside)
        cut, share = cuts.element, np.zeros(len(sigma))
        own = cut_blocks(cuts.integrals, cut, _even(conductances(system)), system.stiffness)
        blocks[cut] = outside[cut, None, None] * own
        inside = outside.copy()
        inside[cut], share[cut] = cuts.sigma, cuts.share
        density = share[under] * system.contacts.density(inside[under]) + (1.0 - share[under]) * density
        sigma = share * inside + (1.0 - share) * outside
    graded = [item for item in touches if item.border_mm]
    if graded:
        _grade(system, graded, sigma, blocks, density, cut)
    return Touched(system, sigma, blocks, density, cut)


def _even(conductance: Array) -> Array:
    """Return (n, 3, 3) conductances that do not change along elements, as a scene's small ones have them."""
    return np.pad(conductance[:, :, None], ((0, 0), (0, 0), (0, 2)))


def _cover(system: System, pieces: list[tuple[Shape, float]]) -> tuple[Array, Pairs]:
    """Return each element's conductivity by its last whole cover, and the pieces after that which cut it."""
    mesh = system.mesh
    sigma, last = np.full(mesh.n_elements, system.background), np.full(mesh.n_elements, -1)
    found = [Pairs.none()]
    for number, (shape, conductivity) in enumerate(pieces):
        x0, y0, x1, y1 = shape.bounds_mm
        # Beyond the box by more than rounding: an element that only meets a disc's top on a line is not cut by it.
        low, high = mesh.corners_mm + MERGE_MM, mesh.corners_mm + mesh.sizes_mm - MERGE_MM
        near = np.flatnonzero(np.all((high > [x0, y0]) & (low < [x1, y1]), axis=1))
        distance, _ = shape.distance_mm(mesh.centres_mm[near])
        crossed = near[np.abs(distance) < mesh.reach_mm[near]]
        pairs = pairs_of(shape.distance_mm, crossed, np.full(len(crossed), conductivity), mesh)
        covered = np.concatenate([near[distance <= -mesh.reach_mm[near]], crossed[pairs.mean > 1.0 - SHARE_TOLERANCE]])
        sigma[covered], last[covered] = conductivity, number
        found.append(pairs.chosen((pairs.mean > SHARE_TOLERANCE) & (pairs.mean <= 1.0 - SHARE_TOLERANCE)))
    which = np.repeat(np.arange(-1, len(pieces)), [len(pairs.element) for pairs in found])
    every = Pairs.together(found)
    return sigma, every.chosen(last[every.element] < which)


def _grade(system: System, touches: Sequence[Touch], sigma: Array, blocks: Array, density: Array, cut: Index) -> None:
    """Multiply elements and contacts by what touches with graded borders do, in place.

    Args:
        system: The mesh and the contacts.
        touches: Those with graded borders.
        sigma: (n_elements,) S/m under the sharp touches.
        blocks: (n_elements, 9, 9) S.
        density: (m,) S/m^2 of the contacts.
        cut: (k,) elements that the border of a sharp touch cuts; a graded one changes those by its mean.
    """
    elements, factor = _factors(system, touches)
    mean = factor.mean(axis=1)
    uneven = np.where(np.isin(elements, cut)[:, None], 0.0, factor - mean[:, None])
    added = conductances(system)[elements, None, :] @ (uneven @ PRODUCTS).reshape(-1, 3, 81)
    blocks[elements] = mean[:, None, None] * blocks[elements] + sigma[elements, None, None] * added.reshape(-1, 9, 9)
    sigma[elements] *= mean
    contacts = system.contacts
    place = np.full(system.mesh.n_elements, -1, dtype=np.intp)
    place[elements] = np.arange(len(elements))
    pieces = np.flatnonzero(place[contacts.element] >= 0)
    impedance = contacts.impedance_ohm_m2[pieces, None]
    through = 1.0 / density[pieces, None] - impedance
    own = factor[place[contacts.element[pieces]]]
    density[pieces] = np.mean(1.0 / (impedance + through / own), axis=1)


def _factors(system: System, touches: Sequence[Touch]) -> tuple[Index, Array]:
    """Return the k elements that touches reach, and the (k, q) factors of their conductivity at the points."""
    mesh = system.mesh
    total: Array = np.zeros((mesh.n_elements, len(UNIT_POINTS)))
    for touch in touches:
        log_contrast = np.log(touch.factor(system.background))
        for shape in touch.shapes:
            near = np.flatnonzero(shape.distance_mm(mesh.centres_mm)[0] < mesh.reach_mm + touch.border_mm / 2)
            where = mesh.corners_mm[near][:, None, :] + UNIT_POINTS * mesh.sizes_mm[near][:, None, :]
            total[near] += log_contrast * plateau(shape.distance_mm(where)[0], touch.border_mm)
    elements = np.flatnonzero(total.any(axis=1))
    return elements, np.exp(total[elements])
