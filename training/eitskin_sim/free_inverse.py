"""The dense inverse of a sheet's stiffness, line of nodes by line of nodes: a twentieth of a general inverse's work.

Nodes are numbered along upright lines, so the stiffness is block tridiagonal, with the electrodes as a border:

    D_i = A_ii - A_i,i-1 D_i-1^-1 A_i-1,i       U_i = D_i^-1 A_i,i+1
    B_ii = D_i^-1 + U_i B_i+1,i+1 U_i^T         B_ij = -U_i B_i+1,j      for j > i

and the border follows from the Schur complement of the electrodes.
"""

from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csr_array

from eitskin_sim.mesh import Array, Index

ROWS: Final = 256
"""Rows that are changed at a time: what stays in the processor's cache need not be written and read again."""


def bordered_inverse(total: csr_array, lines: Index, lift: float) -> Array:
    """Return the dense inverse of a sheet's stiffness.

    Args:
        total: (n + e, n + e) stiffness; the electrodes' unknowns come last.
        lines: Where each line of nodes begins, and n.
        lift: S from the electrodes' mean to the ground, which fixes the potential; it carries no current.

    Raises:
        ValueError: The stiffness is not positive definite.
    """
    n, size = int(lines[-1]), total.shape[0]
    found = np.empty((size, size))
    inner = found[:n, :n]
    try:
        diagonal, step = _eliminated(total, lines)
        _fill(inner, lines, diagonal, step)
        border = total[:n, n:].toarray()
        seen = inner @ border
        schur = total[n:, n:].toarray() - border.T @ seen
        schur += lift
        terminals = cho_solve(cho_factor(schur, lower=True), np.eye(size - n))
    except np.linalg.LinAlgError as error:
        raise ValueError("the sheet's stiffness is not positive definite; expected a connected sheet") from error
    between = seen @ terminals
    for start in range(0, n, ROWS):
        own = slice(start, start + ROWS)
        inner[own] += between[own] @ seen.T
    found[:n, n:], found[n:, :n] = -between, -between.T
    found[n:, n:] = (terminals + terminals.T) / 2
    return found


def _eliminated(total: csr_array, lines: Index) -> tuple[list[Array], list[Array]]:
    """Return D_i^-1 of every line and U_i between neighbours."""
    diagonal: list[Array] = []
    step: list[Array] = []
    after: Array = np.empty((0, 0))
    for i in range(len(lines) - 1):
        own = slice(lines[i], lines[i + 1])
        block: npt.NDArray[np.float64] = total[own, own].toarray()
        if i:
            block -= after.T @ step[-1]
        inverse = cho_solve(cho_factor(block, lower=True), np.eye(len(block)))
        diagonal.append((inverse + inverse.T) / 2)
        if i + 2 < len(lines):
            after = total[own, lines[i + 1] : lines[i + 2]].toarray()
            step.append(diagonal[-1] @ after)
    return diagonal, step


def _fill(found: Array, lines: Index, diagonal: list[Array], step: list[Array]) -> None:
    """Write the inverse of the lines' blocks."""
    for i in reversed(range(len(diagonal))):
        own, rest = slice(lines[i], lines[i + 1]), slice(lines[i + 1], lines[-1])
        if i == len(diagonal) - 1:
            found[own, own] = diagonal[i]
            continue
        following = slice(lines[i + 1], lines[i + 2])
        np.matmul(-step[i], found[following, rest], out=found[own, rest])
        found[rest, own] = found[own, rest].T
        block = diagonal[i] - found[own, following] @ step[i].T
        found[own, own] = (block + block.T) / 2
