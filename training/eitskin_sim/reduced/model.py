"""The reduced model of one bent sheet, in a few matrices.

With the currents of a unit as F_u a_u, F_u its patterns scaled so that F^T S_u^+ F = 1, what touched units solve
(:mod:`eitskin_sim.reduced.exact`) becomes ::

    M_u(c) / (c - 1) a_u  +  sum over v of H_uv a_v  =  W_u drives,    H = F^T G F,   W = F^T G_E drives
    V = V_untouched - sum over u of W_u^T a_u

by Galerkin: symmetric, reciprocal to the last digit, and of second order in what the patterns leave out. M = 1 but
under a contact, where conductance is not proportional to conductivity; there it is a polynomial in log c.
"""

from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.files.digest import id_of
from eitskin_proto.sensor.table import TABLE
from eitskin_sim.fem.mesh import Array, Index

Single = npt.NDArray[np.float32]

LEAST, MOST = 0.05, 250.0
"""Contrasts that a unit under a contact may have."""

NODES: Final = 10
"""Contrasts at which it is condensed: M is then off by less than 1e-5."""

REMEMBERED: Final = 16
"""Contrasts whose M is kept."""


@dataclass(frozen=True, slots=True, eq=False)
class ReducedModel:
    """One bent sheet; see the module."""

    coupling: Single
    """(units * r, units * r) H."""
    loads: Array
    """(units * r, 16) W."""
    untouched: Array
    """(16 drives, 16 measures) V under 1 A, on a sheet of 1 S/m."""
    contacts: Index
    """Units under a contact."""
    polynomials: Array
    """(contacts, NODES, r, r) coefficients of M by powers of the scaled logarithm of contrast, lowest first."""
    shape: tuple[int, int]
    """Rows and columns of units."""
    skin_digest: str
    grid_id: str
    cloud_digest: str
    """Of the cloud it was made from, empty if of none."""
    diagonal: Array = field(init=False, repr=False)
    """(units, r, r) H of every unit with itself."""
    contact: Index = field(init=False, repr=False)
    """(units,) the place among ``contacts`` of each unit, -1 under none."""
    _usual: dict[float, tuple[Array, Array]] = field(init=False, repr=False, default_factory=dict)
    """M of all contacts and its slopes by contrast."""

    def __post_init__(self) -> None:
        """Gather the diagonal, and who is under a contact."""
        n, r = self.n_units, self.rank
        own = self.coupling.reshape(n, r, n, r)[np.arange(n), :, np.arange(n)].astype(np.float64)
        object.__setattr__(self, "diagonal", own)
        contact = np.full(n, -1, dtype=np.intp)
        contact[self.contacts] = np.arange(len(self.contacts))
        object.__setattr__(self, "contact", contact)

    @property
    def rank(self) -> int:
        """Return how many patterns a unit has."""
        return int(self.polynomials.shape[-1])

    @property
    def n_units(self) -> int:
        """Return how many units there are."""
        return len(self.loads) // self.rank

    @property
    def nbytes(self) -> int:
        """Return what the matrices take."""
        return sum(one.nbytes for one in (self.coupling, self.loads, self.untouched, self.polynomials))

    @property
    def untouched_V(self) -> Array:
        """Return (104,) V under 1 A with nothing touched."""
        return rows_of(self.untouched)

    def of_rank(self, rank: int) -> "ReducedModel":
        """Return the model with the first patterns of each unit alone: several times faster, and coarser.

        Raises:
            ValueError: There are not so many.
        """
        if not 1 <= rank <= self.rank:
            raise ValueError(f"{rank} patterns a unit; expected from 1 to {self.rank}")
        n, r = self.n_units, self.rank
        blocks = self.coupling.reshape(n, r, n, r)[:, :rank, :, :rank]
        return replace(
            self,
            coupling=np.ascontiguousarray(blocks).reshape(n * rank, n * rank),
            loads=self.loads.reshape(n, r, -1)[:, :rank].reshape(n * rank, -1),
            polynomials=np.ascontiguousarray(self.polynomials[:, :, :rank, :rank]),
        )

    def between(self, rows: Index, columns: Index) -> Array:
        """Return (n r, m r) H between units (n,) and units (m,)."""
        n, r = self.n_units, self.rank
        found = self.coupling.reshape(n, r, n, r)[rows[:, None], :, columns].transpose(0, 2, 1, 3)
        return found.astype(np.float64).reshape(len(rows) * r, len(columns) * r)

    def paired(self, first: Index, second: Index) -> Array:
        """Return (n, r, r) H between each of some units (n,) and another one (n,)."""
        n, r = self.n_units, self.rank
        return self.coupling.reshape(n, r, n, r)[first, :, second, :].astype(np.float64)

    def own(self, unit: int, contrast: float) -> tuple[Array, Array]:
        """Return the (r, r) M of a unit at a contrast, and its derivative by log c."""
        at = int(self.contact[unit])
        if at < 0:
            return np.eye(self.rank), np.zeros((self.rank, self.rank))
        own, slope = self._of_contacts(contrast)
        return own[at], slope[at]

    def own_of_contacts(self, contrast: float) -> Array:
        """Return the (contacts, r, r) M of all units under a contact at one contrast."""
        return self._of_contacts(contrast)[0]

    def _of_contacts(self, contrast: float) -> tuple[Array, Array]:
        """Return (contacts, r, r) M and its derivative by log c; kept for the contrasts that were asked for last."""
        if contrast not in self._usual:
            powers = np.power(scaled_log(contrast), np.arange(NODES))
            slopes = np.arange(NODES) * np.append(0.0, powers[:-1]) * (2.0 / np.log(MOST / LEAST))
            flat = np.ascontiguousarray(self.polynomials.transpose(1, 0, 2, 3)).reshape(NODES, -1)
            shape = len(self.contacts), self.rank, self.rank
            while len(self._usual) >= REMEMBERED:
                self._usual.pop(next(iter(self._usual)))
            self._usual[contrast] = (powers @ flat).reshape(shape), (slopes @ flat).reshape(shape)
        return self._usual[contrast]


def rows_of(drives: Array) -> Array:
    """Return the (..., 104) rows of (..., 16 drives, 16 measures) voltages."""
    return np.asarray(drives[..., TABLE[:, 0], TABLE[:, 1]])


def cloud_digest(cloud_mm: Array) -> str:
    """Return the digest of a cloud's float32."""
    return id_of(np.ascontiguousarray(cloud_mm, dtype="<f4").tobytes())


def scaled_log(contrast: Any) -> Any:
    """Return log c, from -1 at ``LEAST`` to 1 at ``MOST``."""
    return 2.0 * np.log(np.asarray(contrast) / LEAST) / np.log(MOST / LEAST) - 1.0
