"""Elements under the graded borders of a scene's touches: conductivity point by point, since it has no jump.

A scene's mesh follows a graded border in steps of a quarter to half of its width, so biquadratic elements need no kink
there. Where several touches reach an element their contrasts multiply, as they do with what a sharp touch left there.
"""

from collections.abc import Sequence

import numpy as np

from eitskin_sim.arrays import Array, Index
from eitskin_sim.fem.borders.graded import plateau
from eitskin_sim.fem.forward import System
from eitskin_sim.fem.mesh import MM
from eitskin_sim.fem.q2 import gradients
from eitskin_sim.scene.parts import Touch


def grade(
    system: System, touches: Sequence[Touch], points: Array, sigma: Array, blocks: Array, density: Array, cut: Index
) -> None:
    """Multiply elements and contacts by what touches with graded borders do, in place.

    Args:
        system: The mesh and the contacts.
        touches: Those with graded borders.
        points: (q, 2) of a unit element, of even weight.
        sigma: (n_elements,) S/m under the sharp touches.
        blocks: (n_elements, 9, 9) S.
        density: (m,) S/m^2 of the contacts.
        cut: (k,) elements that the border of a sharp touch cuts; a graded one changes those by its mean.
    """
    elements, factor = _factors(system, touches, points)
    if not len(elements):
        return
    mean = factor.mean(axis=1)
    uneven = np.where(np.isin(elements, cut)[:, None], 0.0, factor - mean[:, None])
    whole = mean[:, None, None] * blocks[elements]
    blocks[elements] = whole + sigma[elements, None, None] * _added(system, elements, points, uneven)
    sigma[elements] *= mean
    contacts = system.contacts
    place = np.full(system.mesh.n_elements, -1, dtype=np.intp)
    place[elements] = np.arange(len(elements))
    pieces = np.flatnonzero(place[contacts.element] >= 0)
    impedance = contacts.impedance_ohm_m2[pieces, None]
    through = 1.0 / density[pieces, None] - impedance
    own = factor[place[contacts.element[pieces]]]
    density[pieces] = np.mean(1.0 / (impedance + through / own), axis=1)


def _factors(system: System, touches: Sequence[Touch], points: Array) -> tuple[Index, Array]:
    """Return the k elements that touches reach, and the (k, q) factors of their conductivity at the points."""
    mesh = system.mesh
    reach = np.hypot(*mesh.sizes_mm.T) / 2
    total: Array = np.zeros((mesh.n_elements, len(points)))
    for touch in touches:
        log_contrast = np.log(touch.factor(system.background))
        for shape in touch.shapes:
            near = np.flatnonzero(shape.distance_mm(mesh.centres_mm)[0] < reach + touch.border_mm / 2)
            where = mesh.corners_mm[near][:, None, :] + points * mesh.sizes_mm[near][:, None, :]
            total[near] += log_contrast * plateau(shape.distance_mm(where)[0], touch.border_mm)
    elements = np.flatnonzero(total.any(axis=1))
    return elements, np.exp(total[elements])


def _added(system: System, elements: Index, points: Array, weight: Array) -> Array:
    """Return the (k, 9, 9) S of elements at conductivities (k, q), with the conductance of their middles."""
    sizes = system.mesh.sizes_mm[elements]
    E, F, G = system.metric[elements].T
    scale = system.thickness_mm * MM / (E * G - F**2) * system.relative[elements]
    dx, dy = gradients(points)
    xy = np.einsum("qi,qj->qij", dx, dy)
    table = [np.einsum("qi,qj->qij", dx, dx), xy + np.swapaxes(xy, 1, 2), np.einsum("qi,qj->qij", dy, dy)]
    components = (weight / len(points)) @ np.stack(table, axis=1).reshape(len(points), -1)
    ratio = sizes[:, 1] / sizes[:, 0]
    tensor = scale[:, None] * np.stack([G * ratio, -F, E / ratio], axis=-1)
    return np.asarray(np.einsum("kc,kcij->kij", tensor, components.reshape(-1, 3, 9, 9)))
