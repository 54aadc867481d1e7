"""The dense inverse of a sheet's stiffness, line of nodes by line of nodes: a thirtieth of a general inverse's work.

Unknowns are numbered along upright lines, or strips of units (:mod:`eitskin_sim.unit_grid.strips`), electrodes among
the nodes that they lie on, so the stiffness is block tridiagonal:

    D_i = A_ii - A_i,i-1 D_i-1^-1 A_i-1,i       U_i = D_i^-1 A_i,i+1
    B_ii = D_i^-1 + U_i B_i+1,i+1 U_i^T         B_ij = -U_i B_i+1,j      for j > i
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack

from eitskin_sim.fem.mesh import Array, Index


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
    own, after = _assembled(lines, blocks, ground)
    diagonal, minus = [_inverted(own[0])], []
    for i in range(len(after)):
        minus.append(diagonal[i] @ -after[i])
        diagonal.append(_inverted(own[i + 1] + after[i].T @ minus[i]))
    found = np.empty((int(lines.first[-1]),) * 2) if into is None else into
    _fill(found, lines.first, diagonal, minus)
    return found


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
    own, after = _assembled(lines, blocks, ground)
    first, found = lines.first, np.array(right, dtype=np.float64)
    roots: list[Array] = []
    passed: list[Array] = []
    for i in range(len(own)):
        if i:
            own[i] = own[i] - after[i - 1].T @ passed[-1]
            found[first[i] : first[i + 1]] -= passed[-1].T @ found[first[i - 1] : first[i]]
        root, failed = lapack.dpotrf(own[i], lower=1, clean=0)
        if failed:
            raise ValueError("the sheet's stiffness is not positive definite; expected a connected sheet")
        roots.append(root)
        if i < len(after):
            passed.append(lapack.dpotrs(root, after[i], lower=1)[0])
    for i in reversed(range(len(own))):
        here = slice(first[i], first[i + 1])
        found[here] = lapack.dpotrs(roots[i], found[here], lower=1)[0]
        if i < len(after):
            found[here] -= passed[i] @ found[first[i + 1] : first[i + 2]]
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
