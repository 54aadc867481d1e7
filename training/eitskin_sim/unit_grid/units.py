"""Exact voltages of sets of touched units at one bend, thousands a second.

Touching unit u adds D_u = S_u(touched) - S_u(background) to the skeleton's stiffness
(:mod:`eitskin_sim.unit_grid.skeleton`). Sets of up to ``MAX_CONDENSED_UNITS`` units come from blocks between units,
made once a bend (:mod:`eitskin_sim.unit_grid.contrasts`), whatever contrast each has. Larger ones of one contrast,
the paper's squares, are first condensed onto their outline; with G the skeleton's inverse and E the electrodes

    U = G_EE - G_ED D (1 + G_DD D)^-1 G_DE

on the nodes of the outline. Nothing is approximated: against one factorisation a sample, the voltages agree to about
1e-11, those of large squares to 1e-9.
"""

from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.linalg import blas, lapack

from eitskin_proto.sensor.table import N_ELECTRODES, TABLE, voltages_from_potentials
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.arrays import Array, Index
from eitskin_sim.devices.device import Device
from eitskin_sim.scene.parts import Bend
from eitskin_sim.unit_grid.contrasts import MAX_CONDENSED_UNITS, ContrastUnits, check_contrasts, updated
from eitskin_sim.unit_grid.skeleton import Condensed, assemble_skeleton, condense_units, unit_system

TOUCHED_S_PER_M: Final = 50.0
"""S/m of a touched unit (paper section V.A)."""


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
        self._columns = parts.shape[1]
        check_contrasts(np.array([TOUCHED_S_PER_M / system.background]))
        self._n_skeleton = len(parts.skeleton)
        self._units = condense_units(parts, system, (system.background, TOUCHED_S_PER_M))
        size = self._n_skeleton + N_ELECTRODES
        self._inverse = inverse(assemble_skeleton(self._units, size))
        self._sharing = np.bincount(np.concatenate([unit.dofs for unit in self._units]), minlength=size)
        self._regions: dict[tuple[int, ...], Condensed] = {}
        self.at_terminals: Array = self._inverse[-N_ELECTRODES:, -N_ELECTRODES:].copy()
        """(16, 16) potentials of electrodes, V for 1 A into each, with nothing touched."""
        self._contrast = TOUCHED_S_PER_M / system.background
        self._of_contrasts = ContrastUnits(self._inverse, self._units, parts, system)

    @property
    def untouched_V(self) -> Array:
        """(104,) V under 1 A with nothing touched."""
        return np.asarray(to_voltages(self.at_terminals[None])[0])

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
        if contrast is not None:
            return self._of_contrasts.responses(units, np.asarray(contrast, dtype=np.float64))
        many = units.sum(axis=1) > MAX_CONDENSED_UNITS
        found = np.empty((len(units), N_ELECTRODES, N_ELECTRODES))
        found[~many] = self._of_contrasts.responses(
            units[~many], np.full((int((~many).sum()), units.shape[1]), self._contrast)
        )
        for row in np.flatnonzero(many):
            found[row] = self._outlined(np.flatnonzero(units[row]))
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
