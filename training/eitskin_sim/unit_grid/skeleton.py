"""A bent sheet cut along the borders of its units, each unit condensed onto what it shares with others.

Stiffness adds up over elements, so a unit's inside can be eliminated once for each conductivity it may have. What
remains is the skeleton: nodes on the lines between units, and the sixteen electrodes. ::

    +-----o-----o-----+      o  lines between units: 1,500 nodes of 5,900 at the default size
    |     o     o     |      .  insides and the sheet's border: eliminated, unit by unit
    |  .  o  .  o  .  |
    o o o o o o o o o o      S = sum over units of S_u(sigma_u), exactly
    |  .  o  .  o  .  |

Mesh lines stand on the units' borders, so a touched unit has its true outline. A contact may lie on two units; its
electrode is then in both. A face contact's conductance depends on the conductivity above it, and so comes with each
unit's S_u.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.linalg import lapack

from eitskin_proto.sensor.table import N_ELECTRODES
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.devices.device import Device, ideal
from eitskin_sim.devices.loose_contacts import system_on
from eitskin_sim.fem.contacts import Contacts
from eitskin_sim.fem.forward import System
from eitskin_sim.fem.mesh import Array, Index
from eitskin_sim.scene.bend import metric
from eitskin_sim.scene.parts import Bend
from eitskin_sim.unit_grid.unit_mesh import UnitMesh, unit_mesh
from eitskin_sim.unit_grid.unit_nodes import UnitNodes, near_contacts, nodes_of_units

NULL: Final = 1e-13
"""Relative size under which an eigenvalue of a unit is its one zero: a constant potential passes no current."""


@dataclass(frozen=True, slots=True)
class Condensed:
    """One unit at some conductivities.

    Args:
        dofs: (b,) places in the skeleton's numbering; electrode l is at s + l.
        schur: (conductivities, b, b) S.
    """

    dofs: Index
    schur: Array


@lru_cache(maxsize=8)
def _nominal_mesh(skin: Skin, refine: int) -> UnitMesh:
    return unit_mesh(ideal(skin).sheet, ideal(skin).electrodes, skin.grid.units, refine)


def unit_system(
    bend: Bend, refine: int = 1, device: Device | None = None, skin: Skin = PAPER
) -> tuple[UnitMesh, System]:
    """Return a skin's mesh, whatever the device, and a device's system at one bend; None is what the skin states."""
    parts, true, nominal = _nominal_mesh(skin, refine), device or ideal(skin), ideal(skin).electrodes
    return parts, system_on(parts.mesh, true.sheet, true.electrodes, lambda xy: metric(bend, true.sheet, xy), nominal)


def condense_units(parts: UnitMesh, system: System, conductivities: Sequence[float]) -> list[Condensed]:
    """Return all units, each condensed at every one of some conductivities, S/m."""
    return [
        _condensed(unit, unit.assembled(system.stiffness), system.contacts, conductivities)
        for unit in nodes_of_units(parts, system.contacts)
    ]


def condense_at(unit: int, parts: UnitMesh, system: System, conductivities: Sequence[float]) -> Condensed:
    """Return one unit, condensed at each of some conductivities, S/m; what they share is done once."""
    own = nodes_of_units(parts, system.contacts)[unit]
    stiffness = own.assembled(system.stiffness)
    if len(conductivities) > 1:
        own, order = near_contacts(own)
        stiffness = _without(stiffness[np.ix_(order, order)], own.size)
    return _condensed(own, stiffness, system.contacts, conductivities)


def _condensed(unit: UnitNodes, stiffness: Array, contacts: Contacts, conductivities: Sequence[float]) -> Condensed:
    schur: Array = np.empty((len(conductivities), unit.border, unit.border))
    for into, sigma in zip(schur, conductivities, strict=True):
        whole = sigma * stiffness
        density = contacts.density(np.full(len(contacts.element), sigma)) if unit.pieces else np.zeros(0)
        for piece, own, terminal in unit.pieces:
            whole[own[:, None], own] += density[piece] * contacts.mass_m2[piece]
            whole[own, terminal] -= density[piece] * contacts.load_m2[piece]
            whole[terminal, own] -= density[piece] * contacts.load_m2[piece]
            whole[terminal, terminal] += density[piece] * contacts.area_m2[piece]
        into[:] = _without(whole, unit.border)
    return Condensed(dofs=unit.dofs, schur=schur)


def _without(whole: Array, kept: int) -> Array:
    """Return the (kept, kept) Schur complement of a symmetric matrix, its last unknowns eliminated.

    Raises:
        ValueError: Its last unknowns are not held by the others.
    """
    if kept == len(whole):
        return whole
    _, inside, failed = lapack.dposv(whole[kept:, kept:], whole[kept:, :kept], lower=0)
    if failed:
        raise ValueError("a unit's stiffness is not positive definite; expected a conducting sheet")
    reduced = whole[:kept, :kept] - whole[:kept, kept:] @ inside
    return np.asarray((reduced + reduced.T) / 2)


def assemble_skeleton(units: Sequence[Condensed], n_dofs: int) -> Array:
    """Return the dense (s + 16, s + 16) S of the whole sheet, every unit at its first conductivity."""
    total: npt.NDArray[np.float64] = np.zeros((n_dofs, n_dofs), order="F")
    for unit in units:
        total[np.ix_(unit.dofs, unit.dofs)] += unit.schur[0]
    total[-N_ELECTRODES:, -N_ELECTRODES:] += ground(total)
    return total


def square_root(conductance: Array) -> Array:
    """Return (b, r) L with L L^T = S, of a unit's (b, b) S or of what touching adds to it; r is the rank of S."""
    value, vector = np.linalg.eigh(conductance)
    kept = value > NULL * value[-1]
    return np.asarray(vector[:, kept] * np.sqrt(value[kept]))


def ground(stiffness: Array) -> float:
    """Return the conductance, S, that ties the electrodes' mean to zero without changing any adjacent drive."""
    return float(np.diag(stiffness)[-N_ELECTRODES:].mean() / N_ELECTRODES)
