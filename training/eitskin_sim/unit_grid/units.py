"""Exact voltages of sets of touched units at one bend, thousands a second.

Touching unit u adds D_u = S_u(touched) - S_u(background) to the skeleton's stiffness
(:mod:`eitskin_sim.unit_grid.skeleton`), and D_u = L_u L_u^T has rank b - 1 with b about 30. With G the skeleton's
inverse and E the electrodes, Woodbury's identity gives

    U = G_EE - W^T (1 + L^T G L)^-1 W,     L = [L_u for every touched u],   W = L^T G_E

All blocks H_uv = L_u^T G L_v are made once a bend. A touch set then gathers its blocks into

    [ 1 + H   W     ]
    [ W^T     G_EE  ]

whose Cholesky factor ends in a 16 x 16 triangle R with U = R R^T: no other solve is needed. L is such that a unit alone
has 1 in the diagonal, so the first unit is eliminated by a product. Sets of many units are first condensed onto their
outline, by the same identity with another L. Nothing is approximated: against one factorisation a sample, the voltages
agree to about 1e-11, those of large squares to 1e-9.

Where units conduct worse than the sheet, or each has a contrast of its own, factors of
:mod:`eitskin_sim.unit_grid.contrasts` take the place of L, and 1 or -1 that of 1; sets of many units
are then solved as they stand.
"""

from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.linalg import blas, lapack

from eitskin_proto.sensor.table import N_ELECTRODES, TABLE, voltages_from_potentials
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.devices.device import Device
from eitskin_sim.fem.mesh import Array, Index
from eitskin_sim.scene.parts import Bend
from eitskin_sim.unit_grid.contrasts import ContrastUnits, at_once, check_contrasts, updated
from eitskin_sim.unit_grid.skeleton import Condensed, assemble_skeleton, condense_units, square_root, unit_system

TOUCHED: Final = 50.0
"""S/m of a touched unit (paper section V.A)."""

MOST_GATHERED: Final = 8
"""Sets of more units are condensed onto their outline first: blocks grow with the square of the count."""


class UnitGenerator:
    """Voltages of any set of units, at one bend.

    Args:
        bend: The sheet's shape.
        touched: S/m of a touched unit.
        refine: Multiplies the elements along each direction.
        device: Sheet and electrodes, whose front end comes after; None is what the skin states.
        skin: Whose units.

    Raises:
        ValueError: A touched unit would conduct as the sheet does, or not at all.
    """

    def __init__(
        self,
        bend: Bend,
        *,
        touched: float = TOUCHED,
        refine: int = 1,
        device: Device | None = None,
        skin: Skin = PAPER,
    ) -> None:
        parts, system = unit_system(bend, refine, device, skin)
        self._columns = parts.shape[1]
        check_contrasts(np.array([touched / system.background]))
        self._n_skeleton = len(parts.skeleton)
        self._units = condense_units(parts, system, (system.background, touched))
        size = self._n_skeleton + N_ELECTRODES
        self._inverse = inverse(assemble_skeleton(self._units, size))
        self._sharing = np.bincount(np.concatenate([unit.dofs for unit in self._units]), minlength=size)
        self._regions: dict[tuple[int, ...], Condensed] = {}
        self.at_terminals: Array = self._inverse[-N_ELECTRODES:, -N_ELECTRODES:].copy()
        """(16, 16) potentials of electrodes, V for 1 A into each, with nothing touched."""
        self._contrast = touched / system.background
        self._coupled: tuple[Array, Array] | None = None
        self._of_contrasts = ContrastUnits(self._inverse, self._units, parts, system)

    @property
    def untouched_V(self) -> Array:
        """(104,) V under 1 A with nothing touched."""
        return np.asarray(to_voltages(self.at_terminals[None])[0])

    @property
    def _blocks(self) -> Array:
        """(units, units, r, r) H."""
        return self._pairs()[0]

    @property
    def _loads(self) -> Array:
        """(units, r, 16) W."""
        return self._pairs()[1]

    def _pairs(self) -> tuple[Array, Array]:
        """Return H and W, which sets of one contrast above 1 need, and no others."""
        if self._coupled is None:
            self._coupled = self._couple([square_root(unit.schur[1] - unit.schur[0]) for unit in self._units])
        return self._coupled

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
        if contrast is None and self._contrast < 1.0:
            contrast = np.full(units.shape, self._contrast)
        if contrast is not None:
            return self._of_contrasts.responses(units, np.asarray(contrast, dtype=np.float64))
        found = np.empty((len(units), N_ELECTRODES, N_ELECTRODES))
        count = units.sum(axis=1)
        for size in np.unique(count):
            rows = np.flatnonzero(count == size)
            if size == 0:
                found[rows] = self.at_terminals
            elif size <= MOST_GATHERED:
                found[rows] = self._gathered(np.nonzero(units[rows])[1].reshape(len(rows), size))
            else:
                for row in rows:
                    found[row] = self._outlined(np.flatnonzero(units[row]))
        return found

    def _couple(self, factors: list[Array]) -> tuple[Array, Array]:
        """Return H (n, n, r, r) and W (n, r, 16) of n units; those of lower rank are filled up with zeros and ones."""
        rank = max(factor.shape[1] for factor in factors)
        factors = [self._alone(unit, factor) for unit, factor in enumerate(factors)]
        n_units = len(factors)
        wide = np.zeros((len(self._inverse), n_units * rank))
        for unit, factor in enumerate(factors):
            at = slice(unit * rank, unit * rank + factor.shape[1])
            wide[:, at] = self._inverse[:, self._units[unit].dofs] @ factor
        blocks = np.zeros((n_units, n_units, rank, rank))
        loads = np.zeros((n_units, rank, N_ELECTRODES))
        for unit, factor in enumerate(factors):
            own = factor.shape[1]
            row = factor.T @ wide[self._units[unit].dofs]
            blocks[unit, :, :own] = row.reshape(own, n_units, rank).transpose(1, 0, 2)
            blocks[unit, unit] = np.eye(rank)
            loads[unit, :own] = factor.T @ self._inverse[self._units[unit].dofs, -N_ELECTRODES:]
        return blocks, loads

    def _alone(self, unit: int, factor: Array) -> Array:
        """Return L X^-T with X X^T = 1 + L^T G L: in these terms a unit alone has 1 in the diagonal."""
        dofs = self._units[unit].dofs
        own = factor.T @ self._inverse[np.ix_(dofs, dofs)] @ factor
        root, _ = lapack.dpotrf(own + np.eye(len(own)), lower=1)
        return np.asarray(blas.dtrsm(1.0, root, factor, side=1, lower=1, trans_a=1))

    def _gathered(self, sets: Index) -> Array:
        """Return the (n, 16, 16) potentials of electrodes of (n, k) unit numbers."""
        count, k = sets.shape
        rank = self._blocks.shape[-1]
        size = (k - 1) * rank + N_ELECTRODES
        step = at_once(size)
        found = np.empty((count, N_ELECTRODES, N_ELECTRODES))
        panels, rests = np.empty((step, rank, size)), np.empty((step, size, size))
        for start in range(0, count, step):
            part = sets[start : start + step]
            panel, rest = panels[: len(part)], rests[: len(part)]
            for i in range(k):
                into = rest[:, (i - 1) * rank : i * rank] if i else panel
                into[:, :, -N_ELECTRODES:] = self._loads[part[:, i]]
                for j in range(max(i, 1), k):
                    into[:, :, (j - 1) * rank : j * rank] = self._blocks[part[:, i], part[:, j]]
            rest[:, -N_ELECTRODES:, -N_ELECTRODES:] = self.at_terminals
            for before, after in zip(panel, rest, strict=True):
                left = blas.dsyrk(-1.0, before.T, beta=1.0, c=after.T, lower=1, overwrite_c=1)
                lapack.dpotrf(left, lower=1, overwrite_a=1, clean=0)
            triangle = np.triu(rest[:, -N_ELECTRODES:, -N_ELECTRODES:])
            found[start : start + step] = triangle.transpose(0, 2, 1) @ triangle
        return found

    def _outlined(self, units: Index) -> Array:
        """Return the (16, 16) potentials of electrodes of one set of many units, condensed onto what it shares."""
        region = self._region(tuple(int(unit) for unit in units))
        return self.updated(region.dofs, region.schur[1] - region.schur[0])

    def _region(self, units: tuple[int, ...]) -> Condensed:
        """Return a set of units condensed as one, from its two halves; halves that recur are made once."""
        if len(units) == 1:
            return self._units[units[0]]
        found = self._regions.get(units)
        if found is None:
            first, second = _halves(units, self._columns)
            found = _merged(self._region(first), self._region(second), self._inside(units))
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

    def updated(self, dofs: Index, change: Array) -> Array:
        """Return the (16, 16) electrode response after ``change`` (m, m) is added to the skeleton at ``dofs``."""
        return updated(self._inverse, dofs, change)


def to_voltages(response: Array) -> Array:
    """Return (n, 104) V from (n, 16, 16) electrode potentials for a current into each electrode."""
    drives = response - np.roll(response, -1, axis=2)
    return voltages_from_potentials(np.swapaxes(drives, 1, 2), TABLE)


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


def _merged(first: Condensed, second: Condensed, inside: npt.NDArray[np.bool_]) -> Condensed:
    """Return the sum of two condensed parts, without the dofs that are inside now."""
    dofs = np.union1d(first.dofs, second.dofs)
    gone = inside[dofs]
    order, count = np.argsort(~gone, kind="stable"), np.count_nonzero(gone)
    place = np.empty(len(dofs), dtype=np.intp)
    place[order] = np.arange(len(dofs))
    total = np.zeros((len(first.schur), len(dofs) ** 2))
    for part in (first, second):
        at = place[np.searchsorted(dofs, part.dofs)]
        total[:, (at[:, None] * len(dofs) + at).ravel()] += part.schur.reshape(len(total), -1)
    squares = total.reshape(-1, len(dofs), len(dofs))
    left = squares[:, count:, count:].copy()
    if count:
        for square, own in zip(squares, left, strict=True):
            root, _ = lapack.dpotrf(square.T[:count, :count], lower=1, clean=0)
            panel = blas.dtrsm(1.0, root, square.T[count:, :count], side=1, lower=1, trans_a=1)
            blas.dgemm(-1.0, panel, panel, beta=1.0, c=own.T, trans_b=1, overwrite_c=1)
    return Condensed(dofs[order[count:]], left)
