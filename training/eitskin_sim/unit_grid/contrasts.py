"""Units of any contrasts in one set, above 1 and below: the same blocks between units serve them all.

A unit without a contact has S_u(sigma) = sigma S_u(1), so that one factor L_u, with L_u L_u^T = S_u(1) and L_u^T G L_u
= diag(lambda), serves every contrast c: normalised to +1 or -1 in the diagonal, its columns are scaled by

    s_i = sqrt( |c - 1| / (1 + (c - 1) lambda_i) ),      0 < lambda < 1

Under a contact D_u(c) = L_u T L_u^T with a T of its own for each contrast, and a small matrix Y takes the place of s. A
set is then, by Woodbury's identity, with H_uv = L_u^T G L_v, W = L^T G_E and J = 1 or -1, units that conduct better
first ::

    [ J_u s_u s_v H_uv   s W  ]      a Cholesky factor of the part of 1, then one of what is left of the part of -1,
    [ .                  G_EE ]      negated, which is positive since the sheet stays a conductor

The first unit is eliminated by one product, and where all of a set conduct worse the whole matrix is negated at once.
H_uv is kept for v > u alone, and a set's blocks are scaled in a place that all sets share: new memory takes as long as
the work.
"""

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.linalg import blas, lapack

from eitskin_proto.sensor.table import N_ELECTRODES
from eitskin_sim.arrays import Array, Index
from eitskin_sim.fem.forward import System
from eitskin_sim.scene.parts import MIN_LOG_CONTRAST
from eitskin_sim.unit_grid.skeleton import Condensed, UnitMesh, condense_at, square_root

UNITS_PER_BLOCK: Final = 16
"""Units whose potentials are held together while pairs are made: 11 MB."""

GROUNDED_OHM: Final = 1e12
"""Ohm in place of the electrodes' potentials: what is left of them is not wanted, but must have a root."""

MAX_CONDENSED_UNITS: Final = 10
"""Sets of more units are solved as they stand, or condensed onto their outline: no richer set has more."""


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
        self._condense_under(units, contrast)
        response = np.empty((len(units), N_ELECTRODES, N_ELECTRODES))
        count = units.sum(axis=1)
        for size in np.unique(count):
            rows = np.flatnonzero(count == size)
            if size == 0:
                response[rows] = self._inverse[-N_ELECTRODES:, -N_ELECTRODES:]
                continue
            sets = np.nonzero(units[rows])[1].reshape(len(rows), size)
            own = np.take_along_axis(contrast[rows], sets, axis=1)
            if size <= MAX_CONDENSED_UNITS:
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

    def _condense_under(self, units: npt.NDArray[np.bool_], contrast: Array) -> None:
        """Condense units under contacts at all of their contrasts together: to put one together takes most of it."""
        for unit in sorted(self._under):
            own = np.unique(contrast[units[:, unit], unit]).tolist()
            missing = [one for one in own if (unit, one) not in self._changes]
            if missing:
                sigma = [one * self._system.background for one in missing]
                condensed = condense_at(unit, self._parts, self._system, sigma).schur - self._units[unit].schur[0]
                self._changes.update(((unit, one), found) for one, found in zip(missing, condensed, strict=True))

    def _change(self, unit: int, contrast: float) -> Array:
        """Return the (b, b) D_u of one unit."""
        if unit in self._under:
            return self._changes[unit, contrast]
        return np.asarray((contrast - 1.0) * self._units[unit].schur[0])


def check_contrasts(contrast: Array) -> None:
    """Raise ValueError if a touched unit would change nothing, or be no conductor."""
    with np.errstate(divide="ignore", invalid="ignore"):
        even = ~(np.abs(np.log(contrast)) >= MIN_LOG_CONTRAST) | ~np.isfinite(np.log(contrast))
    if even.any():
        raise ValueError(
            f"a touched unit has a contrast of {contrast[even][0]:g}; it must be above 0 and differ from 1, or the "
            "touch changes nothing"
        )


def updated(inverse: Array, dofs: Index, change: Array) -> Array:
    """Return the (16, 16) electrode response after ``change`` (m, m) is added to a skeleton at ``dofs``."""
    seen = inverse[np.ix_(dofs, dofs)] @ change
    seen[np.diag_indices(len(dofs))] += 1.0
    load = inverse[dofs, -N_ELECTRODES:]
    moved = np.linalg.solve(seen, load)
    return np.asarray(inverse[-N_ELECTRODES:, -N_ELECTRODES:] - load.T @ change @ moved)


class ContrastPairs:
    """The interactions of pairs of units, for sets of a few units of any contrasts.

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
        self._change = change
        n_units = len(units)
        self._under = np.isin(np.arange(n_units), list(at_contacts))
        self._at_terminals = inverse[-N_ELECTRODES:, -N_ELECTRODES:]
        self._factors, self._values = zip(*(_diagonal(inverse, unit) for unit in units), strict=True)
        self._rank = rank = max(len(value) for value in self._values)
        self._lambda = np.array([np.pad(value, (0, rank - len(value))) for value in self._values])
        self._loads = np.zeros((n_units, rank, N_ELECTRODES))
        self._rows = [np.zeros((rank, (n_units - number) * rank)) for number in range(n_units)]
        wide = np.zeros((len(inverse), UNITS_PER_BLOCK * rank))
        for start in range(0, n_units, UNITS_PER_BLOCK):
            stop = min(start + UNITS_PER_BLOCK, n_units)
            for number in range(start, stop):
                factor, at = self._factors[number], (number - start) * rank
                np.matmul(inverse[:, units[number].dofs], factor, out=wide[:, at : at + factor.shape[1]])
                wide[:, at + factor.shape[1] : at + rank] = 0.0
            for number in range(stop):
                factor, begin = self._factors[number], max(number, start)
                into = self._rows[number][: factor.shape[1], (begin - number) * rank : (stop - number) * rank]
                columns = wide[units[number].dofs, (begin - start) * rank : (stop - start) * rank]
                np.matmul(factor.T, columns, out=into)
        for number, (unit, factor) in enumerate(zip(units, self._factors, strict=True)):
            self._loads[number, : factor.shape[1]] = factor.T @ inverse[unit.dofs, -N_ELECTRODES:]
        self._own: dict[tuple[int, float], Array] = {}

    def responses(self, sets: Index, contrast: Array) -> Array:
        """Return the (n, 16, 16) potentials of electrodes of (n, k) unit numbers with contrasts (n, k)."""
        (count, k), rank = sets.shape, self._rank
        order = np.argsort(contrast < 1.0, axis=1, kind="stable")
        sets, contrast = np.take_along_axis(sets, order, axis=1), np.take_along_axis(contrast, order, axis=1)
        scale = np.sqrt(np.abs(contrast - 1.0)[..., None] / (1.0 + (contrast - 1.0)[..., None] * self._lambda[sets]))
        scale[self._under[sets]] = 1.0
        side = (k - 1) * rank + N_ELECTRODES
        panel, upper = np.zeros((rank, side)), np.zeros((side, side))
        found = np.empty((count, N_ELECTRODES, N_ELECTRODES))
        for row in range(count):
            self._gather(sets[row].tolist(), contrast[row].tolist(), scale[row], panel, upper)
            found[row] = self._solved(panel, upper, int(np.count_nonzero(contrast[row] > 1.0)))
        return found

    def _gather(self, units: list[int], contrast: list[float], scale: Array, panel: Array, upper: Array) -> None:
        """Write the first unit's row of blocks without its own (r, side), and the upper half of the others' square.

        Where all conduct worse than the sheet, what is written has the sign of the matrix negated, loads have not.
        """
        rank, after = self._rank, -scale if contrast[0] < 1.0 else scale  # better ones come first
        for i, one in enumerate(units):
            begin = i * rank
            into = upper[begin - rank : begin] if i else panel
            for j, other in enumerate(units[i + 1 :], i):
                first, second = min(one, other), max(one, other)
                block = self._rows[first][:, (second - first) * rank : (second - first + 1) * rank]
                scaled = into[:, j * rank : (j + 1) * rank]
                np.multiply(block if first == one else block.T, after[j + 1], out=scaled)
            into[:, -N_ELECTRODES:] = self._loads[one]
            into[:, begin:] *= scale[i][:, None]
            if i:
                into[:, begin - rank : begin] = 0.0
        upper[-N_ELECTRODES:, -N_ELECTRODES:] = 0.0
        signs = [1.0 if one > 1.0 or contrast[0] < 1.0 else -1.0 for one in contrast[1:]]
        upper.reshape(-1)[:: len(upper) + 1] = np.repeat([*signs, GROUNDED_OHM], [*[rank] * len(signs), N_ELECTRODES])
        for i, unit in enumerate(units):
            if self._under[unit]:
                turn, begin = self._turn(unit, contrast[i]), i * rank
                if i:
                    own = slice(begin - rank, begin)
                    panel[:, own] = panel[:, own] @ turn
                    upper[: begin - rank, own] = upper[: begin - rank, own] @ turn
                into = upper[begin - rank : begin] if i else panel
                into[:, begin:] = turn.T @ into[:, begin:]

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

    def _solved(self, panel: Array, upper: Array, better: int) -> Array:
        """Return the (16, 16) potentials of a set with ``better`` units that conduct better; overwrites both arrays."""
        size, rank, fall = len(upper) - N_ELECTRODES, self._rank, panel[:, -N_ELECTRODES:]
        left = self._at_terminals + (-1.0 if better else 1.0) * (fall.T @ fall)
        if not size:
            return np.asarray(left)
        blas.dsyrk(-1.0, panel.T, beta=1.0, c=upper.T, lower=1, overwrite_c=1)
        if better * rank in (0, size + rank):
            _factorise(upper)
            fall = upper[:size, size:]
            return np.asarray(left + (-1.0 if better else 1.0) * (fall.T @ fall))
        middle = (better - 1) * rank
        if middle:
            root = _factorise(upper[:middle, :middle].copy())
            rows = blas.dtrsm(1.0, root.T, upper[:middle, middle:], lower=1)
            left = left - rows[:, size - middle :].T @ rows[:, size - middle :]
            upper[middle:size, middle:] -= rows[:, : size - middle].T @ rows
        root = _factorise(-upper[middle:size, middle:size])
        rows = blas.dtrsm(1.0, root.T, upper[middle:size, size:], lower=1)
        return np.asarray(left + rows.T @ rows)


def _factorise(upper: Array) -> Array:
    """Overwrite the upper half of a matrix with its Cholesky factor, and return it."""
    _, failed = lapack.dpotrf(upper.T, lower=1, overwrite_a=1, clean=0)
    if failed:
        raise ValueError("a set of touched units takes away more conductance than the sheet has")
    return upper


def _diagonal(inverse: Array, unit: Condensed) -> tuple[Array, Array]:
    """Return (b, r) L with L L^T = S_u of the untouched sheet and L^T G L = diag(lambda), and (r,) lambda."""
    factor = square_root(unit.schur[0])
    own, turn = np.linalg.eigh(factor.T @ inverse[np.ix_(unit.dofs, unit.dofs)] @ factor)
    return factor @ turn, own
