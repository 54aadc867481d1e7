"""Units of any contrasts in one set, above 1 and below: the same blocks between units serve them all.

A unit without a contact has S_u(sigma) = sigma S_u(1), so that one factor L_u, with L_u L_u^T = S_u(1) and L_u^T G L_u
= diag(lambda), serves every contrast c: normalised to +1 or -1 in the diagonal, its columns are scaled by

    s_i = sqrt( |c - 1| / (1 + (c - 1) lambda_i) ),      0 < lambda < 1

Under a contact D_u(c) = L_u T L_u^T with a T of its own for each contrast, and a small matrix Y takes the place of s. A
set is then the matrix of :mod:`eitskin_sim.unit_grid.units` with J = 1 or -1 for 1, units that conduct better first:

    [ J_u s_u s_v H_uv   s W  ]      a Cholesky factor of the part of 1, then one of what is left of the part of -1,
    [ .                  G_EE ]      negated, which is positive since the sheet stays a conductor
"""

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.linalg import blas, lapack

from eitskin_proto.sensor.table import N_ELECTRODES
from eitskin_sim.fem.forward import System
from eitskin_sim.fem.mesh import Array, Index
from eitskin_sim.scene.soft_touch import LEAST_LOG_CONTRAST
from eitskin_sim.unit_grid.skeleton import Condensed, condense_at, square_root
from eitskin_sim.unit_grid.unit_mesh import UnitMesh

BATCH_BYTES: Final = 2e6
"""Size of the matrices that are gathered at once: they stay in the cache."""

MOST: Final = 10
"""Sets of more units are solved as they stand: no richer set has more."""


class ContrastUnits:
    """Potentials of sets of units that have contrasts of their own, at one bend.

    Args:
        inverse: (s + 16, s + 16) V of the untouched skeleton.
        units: All, condensed at the sheet's conductivity first of all.
        parts: The mesh.
        system: At the bend.
    """

    def __init__(self, inverse: Array, units: Sequence[Condensed], parts: UnitMesh, system: System) -> None:
        self._inverse, self._units, self._parts, self._system = inverse, units, parts, system
        self._under = frozenset(parts.unit_of_element[system.contacts.element].tolist())
        self._changes: dict[tuple[int, float], Array] = {}
        self._pairs: ContrastPairs | None = None

    def responses(self, units: npt.NDArray[np.bool_], contrast: Array) -> Array:
        """Return the (n, 16, 16) potentials of electrodes of (n, units) touch sets with contrasts (n, units).

        Raises:
            ValueError: A touched unit has a contrast of 1, or of 0 or less, or the shapes differ.
        """
        if contrast.shape != units.shape:
            raise ValueError(f"contrasts have shape {contrast.shape}; they must have that of the sets, {units.shape}")
        check_contrasts(contrast[units])
        response = np.empty((len(units), N_ELECTRODES, N_ELECTRODES))
        count = units.sum(axis=1)
        for size in np.unique(count):
            rows = np.flatnonzero(count == size)
            if size == 0:
                response[rows] = self._inverse[-N_ELECTRODES:, -N_ELECTRODES:]
                continue
            sets = np.nonzero(units[rows])[1].reshape(len(rows), size)
            own = np.take_along_axis(contrast[rows], sets, axis=1)
            if size <= MOST:
                if self._pairs is None:
                    self._pairs = ContrastPairs(self._inverse, self._units, self._under, self._change)
                response[rows] = self._pairs.responses(sets, own)
            else:
                for row, touched, sigma in zip(rows, sets, own, strict=True):
                    response[row] = self._as_it_stands(touched, sigma)
        return response

    def _as_it_stands(self, units: Index, contrast: Array) -> Array:
        """Return the (16, 16) potentials of one set of many units, from the sum of their D_u."""
        dofs = np.unique(np.concatenate([self._units[unit].dofs for unit in units]))
        change = np.zeros((len(dofs), len(dofs)))
        for unit, sigma in zip(units.tolist(), contrast.tolist(), strict=True):
            at = np.searchsorted(dofs, self._units[unit].dofs)
            change[at[:, None], at] += self._change(unit, sigma)
        return updated(self._inverse, dofs, change)

    def _change(self, unit: int, contrast: float) -> Array:
        """Return the (b, b) D_u of one unit."""
        if unit not in self._under:
            return np.asarray((contrast - 1.0) * self._units[unit].schur[0])
        found = self._changes.get((unit, contrast))
        if found is None:
            sigma = contrast * self._system.background
            found = condense_at(unit, self._parts, self._system, (sigma,)).schur[0] - self._units[unit].schur[0]
            self._changes[unit, contrast] = found
        return found


def check_contrasts(contrast: Array) -> None:
    """Raise ValueError if a touched unit would change nothing, or be no conductor."""
    with np.errstate(divide="ignore", invalid="ignore"):
        even = ~(np.abs(np.log(contrast)) >= LEAST_LOG_CONTRAST) | ~np.isfinite(np.log(contrast))
    if even.any():
        raise ValueError(
            f"a touched unit has a contrast of {contrast[even][0]:g}; it must be above 0 and differ from 1, or the "
            "touch changes nothing"
        )


def at_once(size: int) -> int:
    """Return how many matrices (size, size) are gathered at once."""
    return max(1, int(BATCH_BYTES / (8 * size * size)))


def updated(inverse: Array, dofs: Index, change: Array) -> Array:
    """Return the (16, 16) electrode response after ``change`` (m, m) is added to a skeleton at ``dofs``."""
    seen = inverse[np.ix_(dofs, dofs)] @ change
    seen[np.diag_indices(len(dofs))] += 1.0
    load = inverse[dofs, -N_ELECTRODES:]
    moved = np.linalg.solve(seen, load)
    return np.asarray(inverse[-N_ELECTRODES:, -N_ELECTRODES:] - load.T @ change @ moved)


class ContrastPairs:
    """What pairs of units do to each other, for sets of a few units of any contrasts.

    Args:
        inverse: (s + 16, s + 16) V of the untouched skeleton.
        units: All, condensed at the sheet's conductivity first of all.
        at_contacts: Units on which a contact lies.
        change: Gives the (b, b) D_u of a unit at a contrast.
    """

    def __init__(
        self,
        inverse: Array,
        units: Sequence[Condensed],
        at_contacts: frozenset[int],
        change: Callable[[int, float], Array],
    ) -> None:
        self._at_contacts, self._change = at_contacts, change
        n_units = len(units)
        self._under = np.isin(np.arange(n_units), list(at_contacts))
        self._at_terminals = inverse[-N_ELECTRODES:, -N_ELECTRODES:]
        self._factors, self._values = zip(*(_diagonal(inverse, unit) for unit in units), strict=True)
        self._rank = rank = max(len(value) for value in self._values)
        self._lambda = np.array([np.pad(value, (0, rank - len(value))) for value in self._values])
        self._blocks = np.zeros((n_units, n_units, rank, rank))
        self._loads = np.zeros((n_units, rank, N_ELECTRODES))
        wide = np.zeros((len(inverse), n_units * rank))
        for number, (unit, factor) in enumerate(zip(units, self._factors, strict=True)):
            wide[:, number * rank : number * rank + factor.shape[1]] = inverse[:, unit.dofs] @ factor
        for number, (unit, factor) in enumerate(zip(units, self._factors, strict=True)):
            own = factor.shape[1]
            row = factor.T @ wide[unit.dofs]
            self._blocks[number, :, :own] = row.reshape(own, n_units, rank).transpose(1, 0, 2)
            self._loads[number, :own] = factor.T @ inverse[unit.dofs, -N_ELECTRODES:]
        self._own: dict[tuple[int, float], Array] = {}

    def responses(self, sets: Index, contrast: Array) -> Array:
        """Return the (n, 16, 16) potentials of electrodes of (n, k) unit numbers with contrasts (n, k)."""
        count, k = sets.shape
        order = np.argsort(contrast < 1.0, axis=1, kind="stable")
        sets, contrast = np.take_along_axis(sets, order, axis=1), np.take_along_axis(contrast, order, axis=1)
        better = np.count_nonzero(contrast > 1.0, axis=1) * self._rank
        size = k * self._rank
        step = at_once(size)
        found = np.empty((count, N_ELECTRODES, N_ELECTRODES))
        for start in range(0, count, step):
            part = slice(start, start + step)
            for row, whole in enumerate(self._gathered(sets[part], contrast[part]), start):
                found[row] = self._solved(whole, int(better[row]))
        return found

    def _gathered(self, sets: Index, contrast: Array) -> Array:
        """Return the (n, k r, k r + 16) upper blocks of the matrices and their loads."""
        (count, k), rank = sets.shape, self._rank
        scale = np.sqrt(np.abs(contrast - 1.0)[..., None] / (1.0 + (contrast - 1.0)[..., None] * self._lambda[sets]))
        scale[self._under[sets]] = 1.0
        found = np.zeros((count, k * rank, k * rank + N_ELECTRODES))
        diagonal = np.arange(k * rank)
        found[:, diagonal, diagonal] = np.repeat(np.where(contrast > 1.0, 1.0, -1.0), rank, axis=1)
        for i in range(k):
            own = slice(i * rank, (i + 1) * rank)
            found[:, own, k * rank :] = self._loads[sets[:, i]] * scale[:, i, :, None]
            for j in range(i + 1, k):
                block = self._blocks[sets[:, i], sets[:, j]]
                found[:, own, j * rank : (j + 1) * rank] = block * scale[:, i, :, None] * scale[:, j, None, :]
        for row, place in zip(*np.nonzero(self._under[sets]), strict=True):
            turn = self._turn(int(sets[row, place]), float(contrast[row, place]))
            own = slice(place * rank, (place + 1) * rank)
            found[row, own, own.stop :] = turn.T @ found[row, own, own.stop :]
            found[row, : own.start, own] = found[row, : own.start, own] @ turn
        return found

    def _turn(self, unit: int, contrast: float) -> Array:
        """Return the (r, r) Y of a unit under a contact."""
        found = self._own.get((unit, contrast))
        if found is None:
            factor, sign = self._factors[unit], 1.0 if contrast > 1.0 else -1.0
            back = np.linalg.solve(factor.T @ factor, factor.T)
            root = np.linalg.cholesky(sign * back @ self._change(unit, contrast) @ back.T)
            own = np.eye(len(root)) + sign * root.T @ (self._values[unit][:, None] * root)
            turn = blas.dtrsm(1.0, np.linalg.cholesky(own), root, side=1, lower=1, trans_a=1)
            found = np.zeros((self._rank, self._rank))
            found[: len(turn), : len(turn)] = turn
            self._own[unit, contrast] = found
        return found

    def _solved(self, whole: Array, better: int) -> Array:
        """Return the (16, 16) potentials of one set, whose first unknowns conduct better than the sheet."""
        size, left = len(whole), self._at_terminals
        if better:
            root = _root(whole[:better, :better])
            panel = blas.dtrsm(1.0, root, whole[:better, better:], lower=1)
            left = left - panel[:, size - better :].T @ panel[:, size - better :]
            if better < size:
                whole[better:, better:] -= panel[:, : size - better].T @ panel
        if better < size:
            root = _root(-whole[better:, better:size])
            panel = blas.dtrsm(1.0, root, whole[better:, size:], lower=1)
            left = left + panel.T @ panel
        return np.asarray(left)


def _root(square: npt.NDArray[np.float64]) -> Array:
    """Return the lower Cholesky factor of a matrix of which the upper half is given."""
    root, failed = lapack.dpotrf(square.T, lower=1, clean=0)
    if failed:
        raise ValueError("a set of touched units takes away more conductance than the sheet has")
    return np.asarray(root)


def _diagonal(inverse: Array, unit: Condensed) -> tuple[Array, Array]:
    """Return (b, r) L with L L^T = S_u of the untouched sheet and L^T G L = diag(lambda), and (r,) lambda."""
    factor = square_root(unit.schur[0])
    own, turn = np.linalg.eigh(factor.T @ inverse[np.ix_(unit.dofs, unit.dofs)] @ factor)
    return factor @ turn, own
