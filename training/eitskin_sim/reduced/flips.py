"""Sets of units out of a pool, and what flipping one or two of them would read: microseconds each.

With K = M / (c - 1) + H of the pool's units, W their loads and V the untouched sheet's voltages, the matrix ::

    P = [ K    W ]
        [ W^T  V ]

is *swept* on each unit of the set: its block k is exchanged with the electrodes' side by a step of Gauss and Jordan ::

    P_kk <- -P_kk^-1      P_k. <- P_kk^-1 P_k.      P_.. <- P_.. - P_.k P_kk^-1 P_k.

which leaves the set's own voltages in the place of V, and undoes itself. Whether a unit is in the set or not, flipping
it takes P_Ek P_kk^-1 P_kE from V, and two of them the same of both blocks: putting one in, taking one out, and
exchanging one for another are one formula.
"""

from typing import Final

import numpy as np
from scipy.linalg import blas

from eitskin_sim.fem.mesh import Array, Index
from eitskin_sim.reduced.model import ReducedModel, rows_of
from eitskin_sim.reduced.state import own_of

FRESH: Final = 200
"""After so many flips the matrix is made anew: each loses some digits."""


class Flips:
    """A set of units of a pool, empty at first.

    Args:
        model: The sheet.
        pool: (n,) distinct units.
        contrasts: (n,) of each where it is in the set, none 1.
    """

    def __init__(self, model: ReducedModel, pool: Index, contrasts: Array) -> None:
        self.pool, self._r = pool, model.rank
        n, r = len(pool), model.rank
        self._core0 = model.between(pool, pool)
        blocks = self._core0.reshape(n, r, n, r)
        for contrast in np.unique(contrasts):
            at = np.flatnonzero(contrasts == contrast)
            blocks[at, :, at] = model.diagonal[pool[at]] + own_of(model, pool[at], contrast) / (contrast - 1.0)
        self._load0 = model.loads.reshape(model.n_units, r, -1)[pool].reshape(n * r, -1)
        self._drives0 = model.untouched
        self._fresh()

    def _fresh(self) -> None:
        self._core, self._load, self._drives = self._core0.copy(), self._load0.copy(), self._drives0.copy()
        self.inside = np.zeros(len(self.pool), dtype=np.bool_)
        """(n,) which of the pool are in the set."""
        self._flips = 0
        self._solved: tuple[Array, Array, Array] | None = None

    @property
    def volts(self) -> Array:
        """Return (104,) V of the set, under 1 A."""
        return rows_of(self._drives)

    def to(self, inside: np.ndarray) -> None:
        """Make the set another one: (n,) truth values."""
        if self._flips > FRESH:
            self._fresh()
        for number in np.flatnonzero(self.inside != inside).tolist():
            self.flip(number)

    def flip(self, number: int) -> None:
        """Put a unit of the pool in, or take it out."""
        r = self._r
        at, sign = slice(number * r, (number + 1) * r), -1.0 if self.inside[number] else 1.0
        row, load = self._core[at].copy(), self._load[at].copy()
        own = np.linalg.inv(row[:, at])
        own = (own + own.T) / 2.0
        solved, solved_load = own @ row, own @ load
        # In place: the matrix is symmetric, and its transpose is what Fortran calls it.
        blas.dgemm(-1.0, row.T, solved.T, beta=1.0, c=self._core.T, trans_b=1, overwrite_c=1)
        self._load -= row.T @ solved_load
        self._drives -= load.T @ solved_load
        self._core[at], self._core[:, at], self._load[at] = sign * solved, sign * solved.T, sign * solved_load
        self._core[at, at] = -own
        self.inside[number] = not self.inside[number]
        self._flips += 1
        self._solved = None

    def each(self) -> Array:
        """Return (n, 104) V with each of the pool's units flipped."""
        return rows_of(self._of_each()[2])

    def _of_each(self) -> tuple[Array, Array, Array]:
        """Return (n, r, r) P_kk^-1, (n, r, 16) its product with loads, and (n, 16, 16) V with each flipped."""
        if self._solved is not None:
            return self._solved
        n, r = len(self.pool), self._r
        every = np.arange(n)
        inverse = np.linalg.inv(self._core.reshape(n, r, n, r)[every, :, every]).astype(np.float64, copy=False)
        load = self._load.reshape(n, r, -1)
        solved = np.asarray(np.matmul(inverse, load))
        drives = np.asarray(self._drives - np.matmul(load.transpose(0, 2, 1), solved))
        self._solved = inverse, solved, drives
        return inverse, solved, drives

    def pairs(self, first: Index, second: Index) -> Array:
        """Return (m, 104) V with two units flipped, by their numbers in the pool (m,) each, none with itself."""
        n, r = len(self.pool), self._r
        inverse, solved, drives = self._of_each()
        blocks, load = self._core.reshape(n, r, n, r), self._load.reshape(n, r, -1)
        across = blocks[first, :, second]
        turned = across.transpose(0, 2, 1)
        own = blocks[second, :, second] - np.matmul(turned, np.matmul(inverse[first], across))
        left = load[second] - np.matmul(turned, solved[first])
        return rows_of(drives[first] - np.matmul(left.transpose(0, 2, 1), np.linalg.solve(own, left)))
