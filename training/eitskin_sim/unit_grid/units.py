"""Exact voltages of sets of touched units at one bend, thousands a second.

Touching unit u adds D_u = S_u(touched) - S_u(background) to the skeleton's stiffness
(:mod:`eitskin_sim.unit_grid.skeleton`). What pairs of units do to each other is made once a bend, and serves every
contrast. A unit without a contact has S_u(sigma) = sigma S_u(1), so that one factor L_u, with L_u L_u^T = S_u(1) and
L_u^T G L_u = diag(lambda), G the skeleton's inverse, serves every contrast c: normalised to 1 or -1 in the diagonal,
its columns are scaled by

    s_i = sqrt( |c - 1| / (1 + (c - 1) lambda_i) ),      0 < lambda < 1

Under a contact D_u(c) = L_u T L_u^T with a T of its own for each contrast, and a small matrix Y takes the place of s. A
set is then put together as touches anywhere are (:mod:`eitskin_sim.freeform.voltages`), units that conduct better than
the sheet first, with H_uv = L_u^T G L_v and W = L^T G_E ::

    [ J_u s_u s_v H_uv   s W ]

Large sets of one contrast, the paper's squares, are condensed onto their outline instead:

    U = G_EE - G_ED D (1 + G_DD D)^-1 G_DE

Nothing is approximated: against one factorisation a sample, the voltages agree to about 1e-11, those of large squares
to 1e-9.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.linalg import blas, lapack

from eitskin_proto.sensor.table import N_ELECTRODES
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.arrays import Array, Index
from eitskin_sim.devices.device import Device
from eitskin_sim.freeform.voltages import eliminate
from eitskin_sim.measurement.front_end import to_voltages
from eitskin_sim.scene.parts import MIN_LOG_CONTRAST, Bend
from eitskin_sim.unit_grid.skeleton import Unit, assemble_skeleton, nodes_of_units, square_root, unit_system

TOUCHED_S_PER_M: Final = 50.0
"""S/m of a touched unit (paper section V.A)."""

MAX_PAIRED_UNITS: Final = 10
"""Sets of one contrast and more units are condensed onto their outline."""

UNITS_PER_BLOCK: Final = 16
"""Units whose potentials are held together while pairs are made: 11 MB."""


@dataclass(frozen=True, slots=True)
class Condensed:
    """Some units as one: (b,) places in the skeleton's numbering, and (2, b, b) S untouched and touched.

    Without a contact on them it is (1, b, b), untouched: touched they are in proportion.
    """

    dofs: Index
    schur: Array

    def both(self, contrast: float) -> Array:
        """Return (2, b, b) S, untouched and touched."""
        return self.schur if len(self.schur) > 1 else self.schur * np.array([1.0, contrast])[:, None, None]


class UnitGenerator:
    """Voltages of any set of units, at one bend.

    Args:
        bend: The sheet's shape.
        device: Sheet and electrodes, whose front end comes after; None is what the skin states.
        skin: Whose units.

    Raises:
        ValueError: A touched unit would conduct as the sheet does, or not at all.
    """

    def __init__(
        self,
        bend: Bend,
        *,
        device: Device | None = None,
        skin: Skin = PAPER,
    ) -> None:
        parts, system = unit_system(bend, device, skin)
        self._columns, self._background = parts.shape[1], system.background
        self._contrast = TOUCHED_S_PER_M / system.background
        _check_contrasts(np.array([self._contrast]))
        self._units = [Unit(nodes, system) for nodes in nodes_of_units(parts, system.contacts)]
        self._before = [unit.at(system.background) for unit in self._units]
        size = len(parts.skeleton) + N_ELECTRODES
        self._inverse = inverse(assemble_skeleton(self._units, self._before, size))
        self._sharing = np.bincount(np.concatenate([unit.dofs for unit in self._units]), minlength=size)
        self._regions: dict[tuple[int, ...], Condensed] = {}
        self.at_terminals: Array = self._inverse[-N_ELECTRODES:, -N_ELECTRODES:].copy()
        """(16, 16) potentials of electrodes, V for 1 A into each, with nothing touched."""
        self._factors = [self._diagonal(number) for number in range(len(self._units))]
        self._rank = max(len(values) for _, values in self._factors)
        self._loads = np.zeros((len(self._units), self._rank, N_ELECTRODES))
        self._lambda = np.array([np.pad(values, (0, self._rank - len(values))) for _, values in self._factors])
        self._rows = self._pairs()
        self._normal: dict[tuple[int, float], Array] = {}
        self._work: dict[int, tuple[Array, Array]] = {}

    @property
    def untouched_V(self) -> Array:
        """(104,) V under 1 A with nothing touched."""
        return to_voltages(self.at_terminals)

    def voltages(self, units: npt.NDArray[np.bool_], contrast: npt.NDArray[np.floating] | None = None) -> Array:
        """Return the (n, 104) V under 1 A of (n, units) touch sets; see :meth:`responses`."""
        return to_voltages(self.responses(units, contrast))

    def responses(self, units: npt.NDArray[np.bool_], contrast: npt.NDArray[np.floating] | None = None) -> Array:
        """Return the (n, 16, 16) potentials of electrodes, V for 1 A into each, under (n, units) touch sets.

        Args:
            units: True where a unit is touched; sets may be empty.
            contrast: (n, units) conductivity of each touched unit over the sheet's, where they differ; below 1 too.

        Raises:
            ValueError: A touched unit has a contrast of 1, or of 0 or less, or the shapes differ.
        """
        own = np.broadcast_to(self._contrast, units.shape) if contrast is None else np.asarray(contrast, np.float64)
        if own.shape != units.shape:
            raise ValueError(f"contrasts have shape {own.shape}; they must have that of the sets, {units.shape}")
        _check_contrasts(own[units])
        found = np.empty((len(units), N_ELECTRODES, N_ELECTRODES))
        for row in np.argsort(units.sum(axis=1), kind="stable").tolist():  # sets of one size work in the same memory
            touched = np.flatnonzero(units[row])
            if contrast is None and len(touched) > MAX_PAIRED_UNITS:
                found[row] = self._outlined(touched)
            else:
                found[row] = self._paired(touched, own[row, touched])
        return found

    def _diagonal(self, number: int) -> tuple[Array, Array]:
        """Return a unit's (b, r) L with L L^T = S_u of the untouched sheet, and (r,) lambda."""
        factor, dofs = square_root(self._before[number]), self._units[number].dofs
        own, turn = np.linalg.eigh(factor.T @ self._inverse[np.ix_(dofs, dofs)] @ factor)
        return factor @ turn, own

    def _pairs(self) -> list[Array]:
        """Return each unit's (r, n r) H with itself and all units after it, and set the loads W."""
        count, rank = len(self._units), self._rank
        rows = [np.zeros((rank, (count - number) * rank)) for number in range(count)]
        wide = np.zeros((len(self._inverse), UNITS_PER_BLOCK * rank))
        for start in range(0, count, UNITS_PER_BLOCK):
            stop = min(start + UNITS_PER_BLOCK, count)
            wide[:] = 0.0
            for number in range(start, stop):
                factor, at = self._factors[number][0], (number - start) * rank
                np.matmul(self._inverse[:, self._units[number].dofs], factor, out=wide[:, at : at + factor.shape[1]])
            for number in range(stop):
                factor, begin, dofs = self._factors[number][0], max(number, start), self._units[number].dofs
                into = rows[number][: factor.shape[1], (begin - number) * rank : (stop - number) * rank]
                np.matmul(factor.T, wide[dofs, (begin - start) * rank : (stop - start) * rank], out=into)
        for unit, (factor, _), load in zip(self._units, self._factors, self._loads, strict=True):
            load[: factor.shape[1]] = factor.T @ self._inverse[unit.dofs, -N_ELECTRODES:]
        return rows

    def _normalised(self, number: int, contrast: float) -> Array:
        """Return the (r,) s of a unit at a contrast; the (r, r) Y if it lies under a contact."""
        found = self._normal.get((number, contrast))
        if found is None:
            (factor, values), more = self._factors[number], contrast - 1.0
            if not self._units[number].under_contact:
                found = np.sqrt(abs(more) / (1.0 + more * self._lambda[number]))
            else:
                sign = 1.0 if more > 0.0 else -1.0
                change = self._units[number].at(contrast * self._background) - self._before[number]
                back = np.linalg.solve(factor.T @ factor, factor.T)
                root = np.linalg.cholesky(sign * back @ change @ back.T)
                own = np.eye(len(root)) + sign * root.T @ (values[:, None] * root)
                turn = blas.dtrsm(1.0, np.linalg.cholesky(own), root, side=1, lower=1, trans_a=1)
                found = np.zeros((self._rank, self._rank))
                found[: len(turn), : len(turn)] = turn
            self._normal[number, contrast] = found
        return found

    def _paired(self, units: Index, contrast: Array) -> Array:
        """Return the (16, 16) potentials of electrodes of one set, from what pairs of its units do."""
        if not len(units):
            return self.at_terminals
        rank, ordered = (
            self._rank,
            sorted(zip(units.tolist(), contrast.tolist(), strict=True), key=lambda one: one[1] < 1.0),
        )
        numbers, own = [number for number, _ in ordered], [self._normalised(*one) for one in ordered]
        size, better = len(ordered) * rank, sum(one > 1.0 for _, one in ordered) * rank
        if size not in self._work:  # new memory takes as long as the work
            self._work[size] = np.zeros((size, size)), np.zeros((N_ELECTRODES, size)).T
        square, load = self._work[size]
        for i, (one, scale) in enumerate(zip(numbers, own, strict=True)):
            here = slice(i * rank, (i + 1) * rank)
            into = square[here, here.stop :]
            for j, other in enumerate(numbers[i + 1 :]):
                first, second = min(one, other), max(one, other)
                block = self._rows[first][:, (second - first) * rank : (second - first + 1) * rank]
                block, right = block if first == one else block.T, own[i + 1 + j]
                (np.multiply if right.ndim == 1 else np.matmul)(block, right, out=into[:, j * rank : (j + 1) * rank])
            if scale.ndim == 1:
                into *= scale[:, None]
                np.multiply(self._loads[one], scale[:, None], out=load[here])
            else:
                into[:] = scale.T @ into
                load[here] = scale.T @ self._loads[one]
            square[here, here] = 0.0
        blocks = [block for block in ((0, better, 1.0), (better, size, -1.0)) if block[0] < block[1]]
        diagonal = square.reshape(-1)[:: size + 1]
        for start, stop, sign in blocks:
            diagonal[start:stop] = sign
        eliminate(square, load, blocks)
        left = self.at_terminals
        for start, stop, sign in blocks:
            left = left - sign * (load[start:stop].T @ load[start:stop])
        return left

    def _outlined(self, units: Index) -> Array:
        """Return the (16, 16) potentials of electrodes of one set of many units, condensed onto what it shares."""
        region = self._region(tuple(units.tolist()))
        dofs, (before, touched) = region.dofs, region.both(self._contrast)
        change = touched - before
        seen = self._inverse[np.ix_(dofs, dofs)] @ change
        seen[np.diag_indices(len(dofs))] += 1.0
        load = self._inverse[dofs, -N_ELECTRODES:]
        return np.asarray(self.at_terminals - load.T @ change @ np.linalg.solve(seen, load))

    def _region(self, units: tuple[int, ...]) -> Condensed:
        """Return a set of units condensed as one, from its two halves; halves that recur are made once."""
        found = self._regions.get(units)
        if found is None:
            if len(units) == 1:
                unit = self._units[units[0]]
                touched = [unit.at(TOUCHED_S_PER_M)] if unit.under_contact else []
                found = Condensed(unit.dofs, np.array([self._before[units[0]], *touched]))
            else:
                first, second = _halves(units, self._columns)
                found = _merged(self._region(first), self._region(second), self._inside(units), self._contrast)
            self._regions[units] = found
        return found

    def _inside(self, units: tuple[int, ...]) -> npt.NDArray[np.bool_]:
        """Return (s + 16,) which dofs belong to these units alone."""
        count = np.zeros(len(self._inverse), dtype=np.intp)
        for unit in units:
            count[self._units[unit].dofs] += 1
        inside = count == self._sharing
        inside[-N_ELECTRODES:] = False
        return np.asarray(inside)


def _check_contrasts(contrast: Array) -> None:
    """Raise ValueError if a touched unit would change nothing, or be no conductor."""
    with np.errstate(divide="ignore", invalid="ignore"):
        even = ~(np.abs(np.log(contrast)) >= MIN_LOG_CONTRAST) | ~np.isfinite(np.log(contrast))
    if even.any():
        raise ValueError(
            f"a touched unit has a contrast of {contrast[even][0]:g}; it must be above 0 and differ from 1, or the "
            "touch changes nothing"
        )


def inverse(matrix: Array) -> Array:
    """Return the inverse of a symmetric positive definite matrix, which is overwritten."""
    factor, failed = lapack.dpotrf(matrix, lower=1, overwrite_a=1)
    if failed:
        raise ValueError(f"the sheet's stiffness is not positive definite at row {failed}; expected a connected sheet")
    found, _ = lapack.dpotri(factor, lower=1, overwrite_c=1)
    whole = found + found.T  # the factor's upper half was cleared, and so is the inverse's
    diagonal = np.arange(len(whole))
    whole[diagonal, diagonal] /= 2
    return np.asarray(whole)


def _halves(units: tuple[int, ...], columns: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return a set of units cut across its longer side, at a place that depends on that side alone."""
    row, column = np.divmod(np.array(units), columns)
    along = column if np.ptp(column) >= np.ptp(row) else row
    first = along <= (along.min() + along.max()) // 2
    numbers = np.array(units)
    return tuple(numbers[first].tolist()), tuple(numbers[~first].tolist())


def _merged(first: Condensed, second: Condensed, inside: npt.NDArray[np.bool_], contrast: float) -> Condensed:
    """Return the sum of two condensed parts, without the dofs that are inside now."""
    dofs = np.union1d(first.dofs, second.dofs)
    gone = inside[dofs]
    order, count = np.argsort(~gone, kind="stable"), np.count_nonzero(gone)
    place = np.empty(len(dofs), dtype=np.intp)
    place[order] = np.arange(len(dofs))
    alike = len(first.schur) == len(second.schur) == 1
    total = np.zeros((1 if alike else 2, len(dofs) ** 2))
    for part in (first, second):
        at = place[np.searchsorted(dofs, part.dofs)]
        total[:, (at[:, None] * len(dofs) + at).ravel()] += (part.schur if alike else part.both(contrast)).reshape(
            len(total), -1
        )
    squares = total.reshape(-1, len(dofs), len(dofs))
    left = squares[:, count:, count:].copy()
    if count:
        for square, own in zip(squares, left, strict=True):
            root, _ = lapack.dpotrf(square.T[:count, :count], lower=1, clean=0)
            panel = blas.dtrsm(1.0, root, square.T[count:, :count], side=1, lower=1, trans_a=1)
            blas.dgemm(-1.0, panel, panel, beta=1.0, c=own.T, trans_b=1, overwrite_c=1)
    return Condensed(dofs[order[count:]], left)
