"""A reduced model from a coarse mesh, corrected by what that mesh is off on the flat sheet: in half the time.

Lines of the coarse mesh are among those of the fine one, so a fine mesh's currents F are loads on the coarse one by
interpolation, F_c = P^T F, and the same numbers mean the same on both. With each unit's T that takes the energies of
patterns on the flat coarse sheet to those on the bent one, every matrix is ::

    H(bent) = H_coarse(bent) + T ( H_fine(flat) - H_coarse(flat) ) T^T

and so the energies by which patterns are scaled. It is exact on the flat sheet. What the coarse mesh cannot show, close
to units' corners, is so the flat sheet's, stretched.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final

import numpy as np

from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.fem.mesh import Array, Index, Metric, with_middles
from eitskin_sim.fem.q2 import interpolation
from eitskin_sim.reduced.basis import RANK, current_patterns
from eitskin_sim.reduced.exact import ExactSheet, exact_sheet
from eitskin_sim.reduced.making import coupled, energies, scaled
from eitskin_sim.reduced.model import ReducedModel, Single
from eitskin_sim.scene.nominal import flat_metric_of
from eitskin_sim.unit_grid.unit_nodes import nodes_of_units

LEAST_ENERGY: Final = 0.03
"""Of a pattern on the coarse mesh, beside 1 on the fine one: added, so that none counts as less."""

NEAR: Final = 2
"""Units from each other, along or across, up to which coupling is corrected."""


@dataclass(frozen=True, slots=True, eq=False)
class Correction:
    """What the coarse mesh lacks on a skin's flat sheet, in terms of patterns that have energy 1 on the fine one."""

    patterns: tuple[Array, ...]
    """(b, r) of every unit on the coarse mesh."""
    energies: Array
    """(units, r, r)"""
    unturned: Array
    """(units, r, r) inverse roots of the coarse mesh's energies."""
    pairs: tuple[Index, Index]
    """(p,) units near each other, and themselves; what the mesh lacks between others is a thousandth of that."""
    coupling: Single
    """(p, r, r) between them."""
    loads: Array
    """(units, r, 16)"""
    untouched: Array
    """(16, 16) V"""
    polynomials: Array
    """(contacts, NODES, r, r)"""


def quick_model(metric: Metric, skin: Skin = PAPER, cloud_digest: str = "", gauge: float = 0.0) -> ReducedModel:
    """Return the reduced model of a sheet of some first fundamental form.

    Args:
        metric: (n, 2) flat points in mm -> (n, 3) E, F, G.
        skin: Whose sheet.
        cloud_digest: Of the cloud that the metric comes from, empty if there is none.
        gauge: Added to the skin's gauge factor.

    Raises:
        ValueError: The metric folds.
    """
    lacking, sheet = _correction(skin), exact_sheet(metric, skin, coarse=True, gauge=gauge)
    own = energies(sheet, lacking.patterns)
    turned = np.linalg.cholesky(own + LEAST_ENERGY * np.eye(RANK)) @ lacking.unturned
    roots = np.linalg.cholesky(own + turned @ lacking.energies @ turned.transpose(0, 2, 1))
    found = coupled(sheet, scaled(lacking.patterns, roots), skin, cloud_digest)
    undo = np.linalg.inv(roots) @ turned
    (first, second), single, under = lacking.pairs, undo.astype(np.float32), undo[found.contacts][:, None]
    blocks = found.coupling.reshape(found.n_units, RANK, found.n_units, RANK)
    blocks[first, :, second, :] += single[first] @ lacking.coupling @ single[second].transpose(0, 2, 1)
    return replace(
        found,
        loads=found.loads + np.matmul(undo, lacking.loads).reshape(len(found.loads), -1),
        untouched=found.untouched + lacking.untouched,
        polynomials=found.polynomials + under @ lacking.polynomials @ under.transpose(0, 1, 3, 2),
    )


@lru_cache(maxsize=4)
def _correction(skin: Skin) -> Correction:
    flat = flat_metric_of(skin)
    fine, coarse = exact_sheet(flat, skin), exact_sheet(flat, skin, coarse=True)
    usual = current_patterns(skin, RANK)
    own = scaled(usual, np.linalg.cholesky(energies(fine, usual)))
    there = _on_the_coarse(own, fine, coarse)
    true, rough = coupled(fine, own, skin), coupled(coarse, there, skin)
    n, r = true.n_units, true.rank
    row, column = np.divmod(np.arange(n), skin.grid.units[1])
    apart = np.maximum(np.abs(row[:, None] - row), np.abs(column[:, None] - column))
    first, second = np.nonzero(apart <= NEAR)
    lacking = (true.coupling - rough.coupling).reshape(n, r, n, r)
    return Correction(
        patterns=there,
        energies=np.eye(r) - energies(coarse, there),
        unturned=np.linalg.inv(np.linalg.cholesky(energies(coarse, there) + LEAST_ENERGY * np.eye(r))),
        pairs=(first, second),
        coupling=lacking[first, :, second, :],
        loads=(true.loads - rough.loads).reshape(n, r, -1),
        untouched=true.untouched - rough.untouched,
        polynomials=true.polynomials - rough.polynomials,
    )


def _on_the_coarse(patterns: Sequence[Array], fine: ExactSheet, coarse: ExactSheet) -> tuple[Array, ...]:
    """Return the loads (b, r) that every unit's currents are on the coarse mesh."""
    meshes = fine.parts.mesh, coarse.parts.mesh
    along_x = interpolation(with_middles(meshes[0].x_lines_mm), meshes[1].x_lines_mm)
    along_y = interpolation(with_middles(meshes[0].y_lines_mm), meshes[1].y_lines_mm)
    found = []
    for unit, own in enumerate(patterns):
        (x, y), (coarse_x, coarse_y) = _nodes(fine, unit), _nodes(coarse, unit)
        nodes, terminals = np.split(own, [len(x)])
        spread = along_x[np.ix_(x, coarse_x)] * along_y[np.ix_(y, coarse_y)]
        found.append(np.vstack([spread.T @ nodes, terminals]))
    return tuple(found)


def _nodes(sheet: ExactSheet, unit: int) -> tuple[Index, Index]:
    """Return the numbers, along x and along y, of the nodes that a unit shares, in the order of its unknowns."""
    parts = sheet.parts
    dofs = nodes_of_units(parts, sheet.system.contacts)[unit].dofs
    row, column = np.divmod(parts.skeleton[dofs[dofs < len(parts.skeleton)]], 2 * len(parts.mesh.x_lines_mm) - 1)
    return column, row
