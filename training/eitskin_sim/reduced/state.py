"""One set of touched units on a reduced model, and what each step from it would read: added, removed, changed.

With s = sqrt|c - 1| the set's matrix is A = +-M + s H s, its inverse B, and X = B s W. From them ::

    without u        V + X_u^T B_uu^-1 X_u                  (an infinite diagonal takes a unit out)
    with v as well   V - Z^T K^-1 Z,    Z = W_v - H_vS s X,     K = M_v / (c - 1) + H_vv - H_vS s B s H_Sv
    d / d log c_u    a_u^T (dA_u / d log c) a_u,            a = s X

so that all units are tried beside a set for one product of matrices, 10 to 30 us each, and pairs of them by K and Z of
both, for one small solve each. With units U of the set taken out as v comes in, and h = B s H_Sv ::

    V + X_U^T B_UU^-1 X_U - Z^T K^-1 Z,    Z + h_U^T B_UU^-1 X_U for Z,    K + h_U^T B_UU^-1 h_U for K
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack

from eitskin_sim.fem.mesh import Array, Index
from eitskin_sim.reduced.model import ReducedModel, rows_of


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """A set of touched units."""

    model: ReducedModel
    units: Index
    """(k,) distinct."""
    contrasts: Array
    """(k,) conductivity of each over the sheet's, none 1."""
    drives: Array
    """(16, 16) V of drives and measures under 1 A."""
    _matrix: Array
    """(k r, k r) A, or B where it is ``_inverted``."""
    _scaled: Array
    """(k r, 16) X."""
    _scale: Array
    """(k r,) s."""
    _inverted: bool = False

    @property
    def _inverse(self) -> Array:
        """Return (k r, k r) B: made once it is asked for."""
        if not self._inverted:
            object.__setattr__(self, "_matrix", np.linalg.inv(self._matrix))
            object.__setattr__(self, "_inverted", True)
        return self._matrix

    @property
    def volts(self) -> Array:
        """Return (104,) V under 1 A."""
        return rows_of(self.drives)

    def without_each(self) -> Array:
        """Return (k, 104) V with each of the units taken out."""
        r, k = self.model.rank, len(self.units)
        found = np.empty((k, *self.drives.shape))
        for number in range(k):
            at = slice(number * r, (number + 1) * r)
            x = self._scaled[at]
            found[number] = self.drives + x.T @ np.linalg.solve(self._inverse[at, at], x)
        return rows_of(found)

    def without(self, number: int) -> "State":
        """Return the set without its unit of a number."""
        r = self.model.rank
        gone = np.zeros(len(self._inverse), dtype=np.bool_)
        gone[number * r : (number + 1) * r] = True
        kept = ~gone
        cross = self._inverse[np.ix_(gone, kept)]
        solved = np.linalg.solve(self._inverse[np.ix_(gone, gone)], np.hstack([cross, self._scaled[gone]]))
        size = cross.shape[1]
        return State(
            self.model,
            np.delete(self.units, number),
            np.delete(self.contrasts, number),
            self.drives + self._scaled[gone].T @ solved[:, size:],
            self._inverse[np.ix_(kept, kept)] - cross.T @ solved[:, :size],
            self._scaled[kept] - cross.T @ solved[:, size:],
            self._scale[kept],
            True,
        )

    def with_each(self, units: Index, contrast: float) -> Array:
        """Return (n, 104) V with each of some units (n,), none of them in the set, touched as well.

        Args:
            units: Candidates.
            contrast: Of each.
        """
        return self.beside(units, contrast).one()

    def beside(self, units: Index, contrast: float) -> "Beside":
        """Return some units (n,), none of them in the set, as candidates of one contrast beside it."""
        model, r, n = self.model, self.model.rank, len(units)
        across = model.between(self.units, units) * self._scale[:, None]
        load = model.loads[_places(units, r)] - across.T @ self._scaled
        held = (self._inverse @ across).reshape(-1, n, r).transpose(1, 0, 2)
        across = across.reshape(-1, n, r).transpose(1, 2, 0)
        own = model.diagonal[units] + own_of(model, units, contrast) / (contrast - 1.0) - np.matmul(across, held)
        return Beside(self, units, load.reshape(n, r, -1), own, across, held)

    def slopes(self) -> Array:
        """Return (k, 104) dV / d log c of each unit."""
        r = self.model.rank
        found = np.empty((len(self.units), *self.drives.shape))
        for number, (unit, contrast) in enumerate(zip(self.units.tolist(), self.contrasts.tolist(), strict=True)):
            x = self._scaled[number * r : (number + 1) * r]
            own, slope = self.model.own(unit, contrast)
            by_log = slope / (contrast - 1.0) - own * (contrast / (contrast - 1.0) ** 2)
            found[number] = abs(contrast - 1.0) * (x.T @ by_log @ x)
        return rows_of(found)


@dataclass(frozen=True, slots=True, eq=False)
class Beside:
    """Candidates beside a set; see the module."""

    state: State
    units: Index
    """(n,)"""
    _load: Array
    """(n, r, 16) Z."""
    _own: Array
    """(n, r, r) K."""
    _across: Array
    """(n, r, k r) s H from each to the set."""
    _held: Array
    """(n, k r, r) B times its transpose."""

    def one(self) -> Array:
        """Return (n, 104) V with each of them touched as well."""
        return self._less(self._load, self._own)

    def two(self, first: Index, second: Index) -> Array:
        """Return (m, 104) V with two of them touched as well, by their numbers (m,) each, none with itself."""
        r = self.state.model.rank
        between = self.state.model.paired(self.units[first], self.units[second])
        between = between - np.matmul(self._across[first], self._held[second])
        own = np.empty((len(first), 2 * r, 2 * r))
        own[:, :r, :r], own[:, r:, r:] = self._own[first], self._own[second]
        own[:, :r, r:], own[:, r:, :r] = between, between.transpose(0, 2, 1)
        return self._less(np.concatenate([self._load[first], self._load[second]], axis=1), own)

    def instead(self, taken: Index, number: Index) -> Array:
        """Return (m, 104) V with one of them touched instead of some units of the set.

        Args:
            taken: (m, q) places in the set of those that are taken out, q at least 1.
            number: (m,) of who comes in.
        """
        state, r = self.state, self.state.model.rank
        sets, which = np.unique(taken, axis=0, return_inverse=True)
        places = (sets[:, :, None] * r + np.arange(r)).reshape(len(sets), -1)
        gone, x = np.linalg.inv(state._inverse[places[:, :, None], places[:, None, :]]), state._scaled[places]
        without, held = np.matmul(gone, x), self._held[number[:, None], places[which]]
        turned = held.transpose(0, 2, 1)
        own = self._own[number] + np.matmul(turned, np.matmul(gone[which], held))
        load = self._load[number] + np.matmul(turned, without[which])
        less = np.matmul(load.transpose(0, 2, 1), np.linalg.solve(own, load))
        return rows_of((state.drives + np.matmul(x.transpose(0, 2, 1), without))[which] - less)

    def _less(self, load: Array, own: Array) -> Array:
        return rows_of(self.state.drives - np.matmul(load.transpose(0, 2, 1), np.linalg.solve(own, load)))


def state_of(model: ReducedModel, units: Index, contrasts: Array) -> State:
    """Return a set of touched units.

    Args:
        model: The sheet.
        units: (k,) distinct units; none is the untouched sheet.
        contrasts: (k,) of each, above 0 and not 1.

    Raises:
        ValueError: A contrast is 1, or none, or shapes differ.
    """
    units, contrasts = np.asarray(units, dtype=np.intp), np.asarray(contrasts, dtype=np.float64)
    if units.shape != contrasts.shape or units.ndim != 1:
        raise ValueError(f"{units.shape} units with {contrasts.shape} contrasts; expected one for each")
    if not (np.all(contrasts > 0.0) and np.all(contrasts != 1.0) and np.isfinite(contrasts).all()):
        raise ValueError(f"contrasts {contrasts.tolist()}: expected above 0, and none of 1, which changes nothing")
    r, k = model.rank, len(units)
    scale = np.repeat(np.sqrt(np.abs(contrasts - 1.0)), r)
    matrix = model.between(units, units) * scale[:, None] * scale
    matrix.reshape(-1)[:: k * r + 1] += np.repeat(np.sign(contrasts - 1.0), r)
    for number in np.flatnonzero(model.contact[units] >= 0).tolist():
        at = slice(number * r, (number + 1) * r)
        own = model.own(int(units[number]), float(contrasts[number]))[0] - np.eye(r)
        matrix[at, at] += np.sign(contrasts[number] - 1.0) * own
    load = model.loads[_places(units, r)] * scale[:, None]
    scaled = _solved(matrix, load, bool(np.all(contrasts > 1.0)))
    return State(model, units, contrasts, model.untouched - load.T @ scaled, matrix, scaled, scale)


def _solved(matrix: Array, load: Array, positive: bool) -> Array:
    """Return A^-1 load of a symmetric A, which is positive definite where all contrasts are above 1."""
    if positive and len(matrix):
        _, found, failed = lapack.dposv(matrix, load, lower=1)
        if not failed:
            return np.asarray(found)
    return np.asarray(np.linalg.solve(matrix, load))


def _places(units: Index, rank: int) -> Index:
    """Return (n r,) the places of units' patterns."""
    return np.asarray((units[:, None] * rank + np.arange(rank)).ravel())


def own_of(model: ReducedModel, units: Index, contrast: float) -> Array:
    """Return (n, r, r) M of some units at one contrast."""
    found = np.broadcast_to(np.eye(model.rank), (len(units), model.rank, model.rank))
    place = model.contact[units]
    under = place >= 0
    if not under.any():
        return found
    found = found.copy()
    found[under] = model.own_of_contacts(contrast)[place[under]]
    return found
