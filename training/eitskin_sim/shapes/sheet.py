"""Voltages of touches on one deformation, and their derivatives by every parameter, by the adjoint method.

The untouched sheet is factorised once a deformation. Touches change the stiffness on the nodes D of the elements that
they reach, by dS, so with G the inverse of the untouched sheet, made where it is needed, and E the electrodes

    X = (1 + G_DD dS)^-1 G_DE          the fields on D of 1 A into each electrode
    U = G_EE - G_ED dS X
    dU / dp = - sum over elements of X_e^T (dS_e / dp) X_e

The fields are their own adjoints, since a sheet is reciprocal. So all derivatives together cost some products of small
blocks beside the one solve on D. Where touches reach much of the sheet, D is large, and the whole sheet is solved anew,
line by line, which takes no longer however much is touched.
"""

from copy import copy
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.linalg import lapack
from scipy.sparse import csr_array

from eitskin_sim.arrays import Array, Index
from eitskin_sim.fem.inverse import PartialInverse, solve_lines
from eitskin_sim.freeform.mesh import SharedMesh
from eitskin_sim.freeform.sheet import AssembledSheet
from eitskin_sim.measurement.front_end import to_voltages
from eitskin_sim.shapes.elements import Blocks, Rates, rates, touched

WHOLE_SOLVE_NODES: Final = 380
"""Nodes of D from which the whole sheet is solved sooner than D alone: 9 ms."""


@dataclass(frozen=True, slots=True)
class Solved:
    """A touch set, solved."""

    pieces: Array
    """(n, 8)"""
    base: Blocks
    """Its elements."""
    dofs: Index
    """(m,) D."""
    fields: Array
    """(m, 16) X."""
    response: Array
    """(16, 16) U, V for 1 A into each electrode."""

    @property
    def voltages_V(self) -> Array:
        """(104,) under 1 A."""
        return np.asarray(to_voltages(self.response))


class _Sum:
    """How the blocks of some elements add up.

    Args:
        dofs: (m,) their unknowns.
        place: (e, b) which of them each element has; -1 for none.
    """

    def __init__(self, dofs: Index, place: Index) -> None:
        self.dofs, place = dofs, place.astype(np.int32)
        order = np.argsort(place, axis=None, kind="stable")
        self._order = order[np.count_nonzero(place < 0) :]  # rows of all blocks, unknown after unknown
        count = np.bincount(place.ravel()[self._order], minlength=len(dofs))
        column = place[self._order // place.shape[1]]
        begin = (np.concatenate([[0], np.cumsum(count)]) * place.shape[1]).astype(np.int32)
        self._none = column < 0
        ones = np.ones(column.size)
        self._sum = csr_array((ones, np.maximum(column, 0).ravel(), begin), shape=(len(dofs), len(dofs)))

    def of(self, blocks: Array) -> csr_array:
        """Return the (m, m) sum of (e, b, b) blocks; places count once an element, since products add them up."""
        rows = blocks.reshape(-1, blocks.shape[-1])[self._order]
        rows[self._none] = 0.0
        found = copy(self._sum)
        found.data = rows.ravel()
        return found


@lru_cache(maxsize=64)
def _sum_of(grid: SharedMesh, elements: bytes) -> _Sum:
    """Return how blocks of some elements add up: the next solution's are the same as long as no border leaves its own.

    Args:
        grid: The mesh.
        elements: The bytes of (e,) numbers.
    """
    own = grid.dofs[np.frombuffer(elements, dtype=np.intp)]
    dofs, place = np.unique(own, return_inverse=True)
    none = int(dofs[0] < 0)  # a column for elements under no electrode
    return _Sum(dofs[none:], place.reshape(own.shape) - none)


class TouchedSheet:
    """Touches on one deformation.

    Args:
        sheet: The deformation.
        grid: Its mesh.
    """

    def __init__(self, sheet: AssembledSheet, grid: SharedMesh) -> None:
        self.sheet, self.grid = sheet, grid
        self._inverse = PartialInverse(grid.lines, sheet.before, sheet.ground)
        self.to_terminals = self._inverse.solve(self._currents())
        """(n_dofs, 16) V for 1 A into each electrode, with nothing touched."""
        at_terminals = self.to_terminals[grid.terminals]
        self._at_terminals = (at_terminals + at_terminals.T) / 2
        self._last: tuple[Index, Array] | None = None
        """The unknowns of the last solution, and the inverse between them."""

    def _currents(self) -> Array:
        currents = np.zeros((len(self.grid.sharing), len(self.grid.terminals)))
        currents[self.grid.terminals, np.arange(len(self.grid.terminals))] = 1.0
        return currents

    @property
    def untouched_V(self) -> Array:
        """(104,) under 1 A with nothing touched."""
        return np.asarray(to_voltages(self._at_terminals))

    def solve(self, pieces: Array) -> Solved:
        """Return a touch set's fields and voltages.

        Args:
            pieces: (n, 8) touches; they may meet and overlap.

        Raises:
            ValueError: A border cannot be represented, a touch would change nothing, or takes more than there is; or
                all of them lie beyond the sheet.
        """
        if not len(pieces):
            none = np.zeros(0, dtype=np.intp)
            base = Blocks(none, none, np.zeros((0, 9, 9)))
            return Solved(pieces, base, none, np.zeros((0, 16)), self._at_terminals)
        base = touched(self.sheet, [pieces])
        if not len(base.element):
            raise ValueError("touches lie beyond the sheet")
        return self.solve_blocks(base, pieces)

    def solve_blocks(self, base: Blocks, pieces: Array) -> Solved:
        """Return fields and voltages of a sheet on which the blocks of some elements are others.

        Args:
            base: One or more elements of one set.
            pieces: (n, 8) the touches that changed them.

        Raises:
            ValueError: They take away more conductance than the sheet has.
        """
        sheet = self.sheet
        adding = _sum_of(self.grid, base.element.tobytes())
        dofs = adding.dofs
        if len(dofs) > WHOLE_SOLVE_NODES:
            return self._solved_whole(pieces, base, dofs)
        change = adding.of(base.blocks - sheet.before[base.element])
        seen = self.to_terminals[dofs]
        matrix = change @ self._among(dofs)  # symmetric both: its transpose is wanted
        matrix.reshape(-1)[:: len(dofs) + 1] += 1.0
        _, _, fields, failed = lapack.dgesv(matrix.T, seen, overwrite_a=1)
        if failed:
            raise ValueError("touches take away more conductance than the sheet has")
        response = self._at_terminals - seen.T @ (change @ fields)
        return Solved(pieces, base, dofs, fields, np.asarray((response + response.T) / 2))

    def _among(self, dofs: Index) -> Array:
        """Return the (m, m) inverse between some unknowns; the next solution's are the same more often than not."""
        if self._last is None or self._last[0] is not dofs:
            self._last = dofs, self._inverse.among(dofs)
        return self._last[1]

    def _solved_whole(self, pieces: Array, base: Blocks, dofs: Index) -> Solved:
        sheet, grid = self.sheet, self.grid
        blocks = sheet.before.copy()
        blocks[base.element] = base.blocks
        fields = solve_lines(grid.lines, blocks, sheet.ground, self._currents())
        response = fields[grid.terminals]
        return Solved(pieces, base, dofs, fields[dofs], np.asarray((response + response.T) / 2))

    def jacobian(self, solved: Solved, free: npt.NDArray[np.bool_]) -> tuple[Array, Rates]:
        """Return (104, r) V by mm, rad or 1, in the order of ``np.nonzero(free)``, and the rates of the blocks.

        Args:
            solved: The touch set.
            free: (n, 7) bool, by which parameters.
        """
        found = rates(self.sheet, solved.pieces, free, solved.base)
        fields = self.element_fields(solved, found.element)
        power = (np.swapaxes(fields, 1, 2) @ (found.blocks @ fields)).reshape(-1, 256)
        total = np.zeros((len(found.first) - 1, 256))
        some = np.flatnonzero(np.diff(found.first))
        if len(some):
            total[some] = np.add.reduceat(power, found.first[some], axis=0)
        return np.asarray(to_voltages(-total.reshape(-1, 16, 16)).T @ found.mix), found

    def element_fields(self, solved: Solved, element: Index) -> Array:
        """Return (e, 9, 16) fields on the unknowns of touched elements.

        Unknowns of elements that only a moved border reaches have the first one's: a border on a line of the mesh.
        """
        none = len(solved.dofs)
        place = np.zeros(len(self.grid.sharing) + 1, dtype=np.intp)
        place[solved.dofs] = np.arange(none)
        place[-1] = none  # of unknowns that are none
        fields = np.concatenate([solved.fields, np.zeros((1, solved.fields.shape[1]))])
        return np.asarray(fields[place[self.grid.dofs[element]]])
