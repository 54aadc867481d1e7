"""One bent sheet, condensed exactly: what a reduced model is made from and held against.

The skeleton and its inverse G are those of :mod:`eitskin_sim.unit_grid.skeleton`. A touched unit u passes the currents
f_u = D_u x into the sheet, x being the potentials around it, and all of them together solve

    sum over v of  F_uv f_v  +  D_u^+ f_u  =  G_uE drives,        F_uv = G between the nodes of u and of v

whose solution gives every voltage: U = G_EE - sum over u of G_Eu f_u.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack

from eitskin_proto.sensor.table import N_ELECTRODES
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.fem.forward import System
from eitskin_sim.fem.mesh import Array, Index, Metric
from eitskin_sim.unit_grid.skeleton import Condensed, condense_at, condense_units, unit_system_of
from eitskin_sim.unit_grid.strips import inverse_by_strips
from eitskin_sim.unit_grid.unit_mesh import UnitMesh

DRIVES: Array = np.eye(N_ELECTRODES) - np.roll(np.eye(N_ELECTRODES), 1, axis=0)
"""(16 electrodes, 16 drives): 1 A into electrode k and out of k + 1."""


@dataclass(frozen=True, slots=True, eq=False)
class ExactSheet:
    """One bent sheet at 1 S/m."""

    parts: UnitMesh
    system: System
    units: list[Condensed]
    """Every unit, untouched; its unknowns are numbered as those of the inverse."""
    inverse: Array
    """(s + 16, s + 16) ohm, up to a constant; unknowns go from one end of the sheet to the other."""
    terminals: Index
    """(16,) which of them the electrodes are."""

    @property
    def under_contacts(self) -> Index:
        """Return the units on which a contact lies: their stiffness is not proportional to their conductivity."""
        return np.unique(self.parts.unit_of_element[self.system.contacts.element])

    @property
    def untouched(self) -> Array:
        """Return (16 drives, 16 measures) V under 1 A."""
        return np.asarray(DRIVES.T @ self.inverse[np.ix_(self.terminals, self.terminals)] @ DRIVES)

    def changes(self, unit: int, contrasts: list[float]) -> list[Array]:
        """Return the (b, b) D of a unit at some contrasts."""
        own = self.units[unit].schur[0]
        if unit not in self.under_contacts:
            return [(contrast - 1.0) * own for contrast in contrasts]
        found = condense_at(unit, self.parts, self.system, [one * self.system.background for one in contrasts])
        return [schur - own for schur in found.schur]

    def currents(self, units: Index, contrasts: Array) -> tuple[list[Array], Array]:
        """Return each unit's (b, 16) currents under every drive, and the (16, 16) voltages of drives and measures."""
        dofs = [self.units[unit].dofs for unit in units.tolist()]
        every = np.concatenate(dofs)
        seen = self.inverse[np.ix_(every, every)]
        change = np.zeros_like(seen)
        at = 0
        for unit, contrast, own in zip(units.tolist(), contrasts.tolist(), dofs, strict=True):
            here = slice(at, at + len(own))
            change[here, here] = self.changes(unit, [contrast])[0]
            at += len(own)
        load = self.inverse[np.ix_(every, self.terminals)] @ DRIVES
        potentials = np.linalg.solve(np.eye(len(every)) + seen @ change, load)
        flowing = change @ potentials
        return np.split(flowing, np.cumsum([len(one) for one in dofs])[:-1]), self.untouched - load.T @ flowing


def exact_sheet(metric: Metric, skin: Skin = PAPER, *, coarse: bool = False, gauge: float = 0.0) -> ExactSheet:
    """Return the sheet that a skin states, at some first fundamental form.

    Args:
        metric: (n, 2) flat points in mm -> (n, 3) E, F, G.
        skin: Whose.
        coarse: Whether on three elements across a unit instead of five.
        gauge: Added to the skin's gauge factor.
    """
    parts, system = unit_system_of(metric, skin, coarse=coarse, gauge=gauge)
    return ExactSheet(parts, system, *inverse_by_strips(parts, condense_units(parts, system, (system.background,))))


def grounded_inverse_form(matrices: Array, currents: Array) -> Array:
    """Return (n, r, r) F^T D^+ F of symmetric D (n, b, b) whose null space is the constants.

    Args:
        matrices: D.
        currents: (b, r) F, which add up to 0.

    Raises:
        ValueError: A D is not positive.
    """
    try:
        roots = np.linalg.cholesky(matrices[:, 1:, 1:])
    except np.linalg.LinAlgError:
        raise ValueError(
            "a unit's stiffness is not positive; expected a conducting sheet and a contrast above 1"
        ) from None
    found = np.empty((len(roots), currents.shape[1], currents.shape[1]))
    for into, root in zip(found, roots, strict=True):
        half = lapack.dtrtrs(root, currents[1:], lower=1)[0]
        np.matmul(half.T, half, out=into)
    return found
