"""The inverse of a sheet's stiffness, line of nodes by line of nodes: whole, or of the nodes that are asked for.

The whole one, dense, is a thirtieth of a general inverse's work.

Unknowns are numbered along upright lines, electrodes among the nodes that they lie on, so the stiffness is block
tridiagonal:

    D_i = A_ii - A_i,i-1 D_i-1^-1 A_i-1,i       U_i = D_i^-1 A_i,i+1
    B_ii = D_i^-1 + U_i B_i+1,i+1 U_i^T         B_ij = -U_i B_i+1,j      for j > i
"""

import itertools
from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack

from eitskin_sim.arrays import Array, Index


@dataclass(frozen=True, slots=True)
class Lines:
    """How unknowns divide into lines, and where the numbers of parts go: elements of a mesh, or units of a skeleton.

    Args:
        first: (l + 1,) where each line begins, and the number of unknowns.
        begin: (2 l,) where A_ii of each line begins in a long buffer, then where each A_i,i+1 does, and the end.
        slot: (parts * b * b,) where each number of the parts' blocks goes there; its last place is for the rest.
    """

    first: Index
    begin: Index
    slot: Index


def make_lines(first: Index, dofs: Index) -> Lines:
    """Return how blocks of parts make up the lines' blocks.

    Args:
        first: (l + 1,) where each line begins, and the number of unknowns.
        dofs: (parts, b) unknowns of each element or unit, -1 for none.

    Raises:
        ValueError: A part joins lines that are no neighbours.
    """
    width = np.diff(first)
    begin = np.concatenate([[0], np.cumsum(np.concatenate([width**2, width[:-1] * width[1:]]))])
    line = np.searchsorted(first, dofs, side="right") - 1
    row, column = dofs[:, :, None], dofs[:, None, :]
    row_line, column_line = line[:, :, None], line[:, None, :]
    apart = np.where((row >= 0) & (column >= 0), column_line - row_line, 0)
    if np.abs(apart).max() > 1:
        raise ValueError(f"an element joins lines {np.abs(apart).max()} apart; expected neighbours: make lines wider")
    local = row - first[row_line], column - first[column_line]
    start = np.where(apart == 0, begin[row_line], begin[np.minimum(len(width) + row_line, len(begin) - 1)])
    kept = (row >= 0) & (column >= 0) & (apart >= 0)
    slot = np.where(kept, start + local[0] * width[column_line] + local[1], begin[-1])
    return Lines(first, begin, slot.ravel())


def dense_inverse(lines: Lines, blocks: Array, ground: tuple[int, float], into: Array | None = None) -> Array:
    """Return the dense inverse (n, n) of a sheet's stiffness.

    Args:
        lines: Of the mesh.
        blocks: (parts, b, b) S.
        ground: An unknown, and the S that tie it to the ground, which fixes the potential and carries no current.
        into: (n, n) where to write it: a buffer that was used before needs no pages of memory.

    Raises:
        ValueError: The stiffness is not positive definite.
    """
    diagonal, minus = _eliminated(*_assembled(lines, blocks, ground))
    found = np.empty((int(lines.first[-1]),) * 2) if into is None else into
    _fill(found, lines.first, diagonal, minus)
    return found


class PartialInverse:
    """The inverse between requested unknowns.

    A touch reaches 40 to 300 of 3,000 unknowns, and the next step of a fit few others. Of each a column is made, from
    the first line of all that are asked for to its own; what is beyond comes from the others' columns, by symmetry.

    Args:
        lines: Of the mesh.
        blocks: (parts, b, b) S.
        ground: As :func:`dense_inverse` has it.

    Raises:
        ValueError: The stiffness is not positive definite.
    """

    def __init__(self, lines: Lines, blocks: Array, ground: tuple[int, float]) -> None:
        self._first = lines.first
        self._diagonal, self._minus = _eliminated(*_assembled(lines, blocks, ground))
        own = [self._diagonal[-1]]
        for diagonal, minus in zip(reversed(self._diagonal[:-1]), reversed(self._minus), strict=True):
            own.append(diagonal + minus @ own[-1] @ minus.T)
        self._own = own[::-1]
        """B_ii of each line."""
        n = int(self._first[-1])
        self._line = np.repeat(np.arange(len(self._first) - 1), np.diff(self._first))
        self._place = np.full(n, -1, dtype=np.intp)
        """(n,) where each unknown's column is; -1: nowhere yet."""
        self._count = 0
        """How many have one."""
        self._columns = np.empty((n, n))
        """A column a row, filled in between the lines that it is made for; memory is taken as rows are written."""
        self._begin = len(self._own)
        """The first of these lines."""

    def solve(self, right: Array) -> Array:
        """Return the (n, k) potentials under currents (n, k) A."""
        return _solved(self._first, self._diagonal, self._minus, right)

    def among(self, dofs: Index) -> Array:
        """Return the (m, m) inverse between some unknowns, which are in ascending order."""
        new = dofs[self._place[dofs] < 0]
        if len(new):
            self._make(new)
        found = self._columns.reshape(-1).take(self._place[dofs][:, None] * len(self._place) + dofs)
        return np.where(np.tri(len(dofs), dtype=np.bool_), found, found.T)

    def _make(self, dofs: Index) -> None:
        """Make the columns of some unknowns, in ascending order."""
        before, self._count = self._count, self._count + len(dofs)
        begin = min(self._begin, int(self._line[dofs[0]]))
        for i in reversed(range(begin, self._begin) if before else ()):
            self._step(self._columns[:before], i)
        self._begin = begin
        self._fill_columns(self._columns[before : self._count], dofs)
        self._place[dofs] = np.arange(before, self._count)

    def _fill_columns(self, found: Array, dofs: Index) -> None:
        """Write the (k, n) columns of some unknowns, in ascending order."""
        after = np.searchsorted(dofs, self._first)
        for i in reversed(range(self._begin, int(self._line[dofs[-1]]) + 1)):
            own = slice(after[i], after[i + 1])
            if after[i] < after[i + 1]:
                found[own, self._first[i] : self._first[i + 1]] = self._own[i][dofs[own] - self._first[i]]
            if after[i + 1] < len(dofs):
                self._step(found[after[i + 1] :], i)

    def _step(self, columns: Array, i: int) -> None:
        """Write line i of (k, n) columns from the line below."""
        here, below = (slice(*self._first[line : line + 2]) for line in (i, i + 1))
        np.matmul(columns[:, below], self._minus[i].T, out=columns[:, here])


def _eliminated(own: list[Array], after: list[Array]) -> tuple[list[Array], list[Array]]:
    """Return the D_i^-1 and the -U_i."""
    diagonal, minus = [_inverted(own[0])], []
    for i in range(len(after)):
        minus.append(diagonal[i] @ -after[i])
        diagonal.append(_inverted(own[i + 1] + after[i].T @ minus[i]))
    return diagonal, minus


def _square(numbers: Array, start: int, rows: int, columns: int) -> Array:
    return numbers[start : start + rows * columns].reshape(rows, columns)


def _inverted(block: Array) -> Array:
    """Return D^-1 of one line."""
    root, failed = lapack.dpotrf(block, lower=1, clean=0)
    if failed:
        raise ValueError("the sheet's stiffness is not positive definite; expected a connected sheet")
    inverse, _ = lapack.dpotrs(root, np.eye(len(block), order="F"), lower=1, overwrite_b=1)
    return np.asarray((inverse + inverse.T) / 2)


def _fill(found: Array, first: Index, diagonal: list[Array], minus: list[Array]) -> None:
    """Write the inverse of the lines' blocks, from the D_i^-1 and the -U_i."""
    last = slice(first[-2], first[-1])
    found[last, last] = diagonal[-1]
    for i in reversed(range(len(minus))):
        own, rest = slice(first[i], first[i + 1]), slice(first[i + 1], first[-1])
        following = slice(first[i + 1], first[i + 2])
        np.matmul(minus[i], found[following, rest], out=found[own, rest])
        found[rest, own] = found[own, rest].T
        block = diagonal[i] + found[own, following] @ minus[i].T
        found[own, own] = (block + block.T) / 2


def solve_lines(lines: Lines, blocks: Array, ground: tuple[int, float], right: Array) -> Array:
    """Return the (n, k) potentials of a sheet under currents (n, k), without its inverse: 10 ms for 3,300 unknowns.

    Args:
        lines: Of the mesh.
        blocks: (parts, b, b) S.
        ground: As :func:`dense_inverse` has it.
        right: (n, k) A.

    Raises:
        ValueError: The stiffness is not positive definite.
    """
    return _solved(lines.first, *_eliminated(*_assembled(lines, blocks, ground)), right)


def _solved(first: Index, diagonal: list[Array], minus: list[Array], right: Array) -> Array:
    """Return the (n, k) potentials under currents (n, k), by the D_i^-1 and the -U_i."""
    found = np.array(right, dtype=np.float64)
    here = [slice(one, other) for one, other in itertools.pairwise(first)]
    for i, following in enumerate(here[1:]):
        found[following] += minus[i].T @ found[here[i]]
    for i in reversed(range(len(here))):
        found[here[i]] = diagonal[i] @ found[here[i]]
        if i < len(minus):
            found[here[i]] += minus[i] @ found[here[i + 1]]
    return found


def _assembled(lines: Lines, blocks: Array, ground: tuple[int, float]) -> tuple[list[Array], list[Array]]:
    """Return the A_ii and the A_i,i+1 of a sheet that is tied to the ground."""
    count = len(lines.first) - 1
    numbers: Array = np.bincount(lines.slot, blocks.ravel(), int(lines.begin[-1]) + 1).astype(np.float64, copy=False)
    width = np.diff(lines.first)
    own = [_square(numbers, lines.begin[i], width[i], width[i]) for i in range(count)]
    after = [_square(numbers, lines.begin[count + i], width[i], width[i + 1]) for i in range(count - 1)]
    line = int(np.searchsorted(lines.first, ground[0], side="right")) - 1
    at = ground[0] - int(lines.first[line])
    own[line][at, at] += ground[1]
    return own, after
