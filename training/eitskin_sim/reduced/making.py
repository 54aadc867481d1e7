"""How reduced models are made: patterns scaled in each unit's energy, and coupled by the inverse of the sheet."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from scipy.linalg import lapack

from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.fem.mesh import Array
from eitskin_sim.reduced.basis import RANK, current_patterns
from eitskin_sim.reduced.exact import DRIVES, ExactSheet, grounded_inverse_form
from eitskin_sim.reduced.model import LEAST, MOST, NODES, ReducedModel


def reduced(sheet: ExactSheet, skin: Skin = PAPER, rank: int = RANK, cloud_digest: str = "") -> ReducedModel:
    """Return the reduced model of a condensed sheet."""
    patterns = current_patterns(skin, rank)
    return coupled(sheet, scaled(patterns, np.linalg.cholesky(energies(sheet, patterns))), skin, cloud_digest)


def energies(sheet: ExactSheet, patterns: Sequence[Array]) -> Array:
    """Return (units, r, r) F^T S_u^+ F of every unit's patterns F (b, r), by the unknowns that it has on the sheet."""
    found = [grounded_inverse_form(u.schur[:1], own) for u, own in zip(sheet.units, patterns, strict=True)]
    return np.concatenate(found)


def scaled(patterns: Sequence[Array], roots: npt.NDArray[np.floating]) -> list[Array]:
    """Return patterns (b, r) of energy 1, by the lower roots (units, r, r) of their energies."""
    return [lapack.dtrtrs(root, own.T, lower=1)[0].T for root, own in zip(roots, patterns, strict=True)]


def coupled(sheet: ExactSheet, scaled: Sequence[Array], skin: Skin, cloud_digest: str = "") -> ReducedModel:
    """Return the reduced model of a condensed sheet.

    Args:
        sheet: On any mesh.
        scaled: (b, r) currents of every unit of energy 1, by the unknowns that it has there.
        skin: Whose sheet.
        cloud_digest: Of its cloud, empty if there is none.
    """
    rank = scaled[0].shape[1]
    size = len(scaled) * rank
    tall = np.empty((len(sheet.inverse), size))
    for number, (own, unit) in enumerate(zip(scaled, sheet.units, strict=True)):
        tall[:, number * rank : (number + 1) * rank] = (own.T @ sheet.inverse[unit.dofs]).T
    coupling = np.empty((size, size), dtype=np.float32)
    for number, (own, unit) in enumerate(zip(scaled, sheet.units, strict=True)):
        at = number * rank
        coupling[at : at + rank, at:] = own.T @ tall[unit.dofs, at:]
        coupling[at + rank :, at : at + rank] = coupling[at : at + rank, at + rank :].T
    contacts = sheet.under_contacts
    return ReducedModel(
        coupling=coupling,
        loads=tall[sheet.terminals].T @ DRIVES,
        untouched=sheet.untouched,
        contacts=contacts,
        polynomials=np.array([_polynomial(sheet, unit, scaled[unit]) for unit in contacts.tolist()]),
        shape=skin.grid.units,
        skin_digest=skin.digest,
        grid_id=skin.grid_id,
        cloud_digest=cloud_digest,
    )


def _polynomial(sheet: ExactSheet, unit: int, patterns: Array) -> Array:
    """Return the (NODES, r, r) coefficients of M of a unit under a contact, from its values at Chebyshev's nodes."""
    at = np.cos(np.pi * (np.arange(NODES) + 0.5) / NODES)
    contrasts = LEAST * np.exp((at + 1.0) / 2.0 * np.log(MOST / LEAST))
    changes = np.array(sheet.changes(unit, contrasts.tolist()))
    signs = np.where(contrasts > 1.0, 1.0, -1.0)[:, None, None]
    values = np.abs(contrasts - 1.0)[:, None, None] * grounded_inverse_form(signs * changes, patterns)
    table = np.vander(at, NODES, increasing=True)
    return np.asarray(np.linalg.solve(table, values.reshape(NODES, -1)).reshape(values.shape))
