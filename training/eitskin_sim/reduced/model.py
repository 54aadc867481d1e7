"""The reduced model of one bent sheet, in a few matrices, and how it is made and kept.

With the currents of a unit as F_u a_u, F_u its patterns scaled so that F^T S_u^+ F = 1, what touched units solve
(:mod:`eitskin_sim.reduced.exact`) becomes ::

    M_u(c) / (c - 1) a_u  +  sum over v of H_uv a_v  =  W_u drives,    H = F^T G F,   W = F^T G_E drives
    V = V_untouched - sum over u of W_u^T a_u

by Galerkin: symmetric, reciprocal to the last digit, and of second order in what the patterns leave out. M = 1 but
under a contact, where conductance is not proportional to conductivity; there it is a polynomial in log c.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.files.arrays import read_npz
from eitskin_proto.files.digest import id_of
from eitskin_proto.files.reading import FileError
from eitskin_proto.files.writing import replacing
from eitskin_proto.sensor.table import N_ELECTRODES, TABLE
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.fem.mesh import Array, Index, Metric
from eitskin_sim.reduced.basis import RANK, current_patterns
from eitskin_sim.reduced.exact import DRIVES, ExactSheet, exact_sheet, grounded_inverse_form
from eitskin_sim.surface.predict import fit_cloud

Single = npt.NDArray[np.float32]

LEAST, MOST = 0.05, 250.0
"""Contrasts that a unit under a contact may have."""

NODES: Final = 10
"""Contrasts at which it is condensed: M is then off by less than 1e-5."""

REMEMBERED: Final = 16
"""Contrasts whose M is kept."""
FORMAT: Final = "eitskin-reduced"
VERSION: Final = 1
LARGEST_FILE: Final = 64 << 20


class ReducedError(ValueError):
    """A reduced model's file is not one, or is of another sheet."""


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
            powers = np.power(_scaled(contrast), np.arange(NODES))
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


def reduced_from_cloud(cloud_mm: npt.ArrayLike, skin: Skin = PAPER) -> ReducedModel:
    """Return the reduced model of a measured cloud (3, rows, columns) mm.

    Raises:
        ValueError: The cloud is malformed, or folds in its own plane.
    """
    cloud = np.asarray(cloud_mm, dtype=np.float64)
    return reduced(exact_sheet(fit_cloud(cloud, skin.grid).metric, skin), skin, cloud_digest=cloud_digest(cloud))


def reduced_of(metric: Metric, skin: Skin = PAPER, rank: int = RANK) -> ReducedModel:
    """Return the reduced model of a sheet of some first fundamental form."""
    return reduced(exact_sheet(metric, skin), skin, rank)


def reduced(sheet: ExactSheet, skin: Skin = PAPER, rank: int = RANK, cloud_digest: str = "") -> ReducedModel:
    """Return the reduced model of a condensed sheet."""
    patterns = current_patterns(skin, rank)
    scaled = [_normal(own, unit.schur[0]) for own, unit in zip(patterns, sheet.units, strict=True)]
    size = len(scaled) * rank
    wide = np.empty((size, len(sheet.inverse)))
    for number, (own, unit) in enumerate(zip(scaled, sheet.units, strict=True)):
        np.matmul(own.T, sheet.inverse[unit.dofs], out=wide[number * rank : (number + 1) * rank])
    coupling, tall = np.empty((size, size), dtype=np.float32), np.ascontiguousarray(wide.T)
    for number, (own, unit) in enumerate(zip(scaled, sheet.units, strict=True)):
        coupling[number * rank : (number + 1) * rank] = own.T @ tall[unit.dofs]
    contacts = sheet.under_contacts
    return ReducedModel(
        coupling=coupling,
        loads=wide[:, -N_ELECTRODES:] @ DRIVES,
        untouched=sheet.untouched,
        contacts=contacts,
        polynomials=np.array([_polynomial(sheet, unit, scaled[unit]) for unit in contacts.tolist()]),
        shape=skin.grid.units,
        skin_digest=skin.digest,
        grid_id=skin.grid_id,
        cloud_digest=cloud_digest,
    )


def cloud_digest(cloud_mm: Array) -> str:
    """Return the digest of a cloud's float32."""
    return id_of(np.ascontiguousarray(cloud_mm, dtype="<f4").tobytes())


def _normal(patterns: Array, stiffness: Array) -> Array:
    """Return F with F^T S^+ F = 1 and the span of patterns."""
    root = np.linalg.cholesky(grounded_inverse_form(stiffness, patterns))
    return np.asarray(np.linalg.solve(root, patterns.T).T)


def _scaled(contrast: Any) -> Any:
    """Return log c, from -1 at ``LEAST`` to 1 at ``MOST``."""
    return 2.0 * np.log(np.asarray(contrast) / LEAST) / np.log(MOST / LEAST) - 1.0


def _polynomial(sheet: ExactSheet, unit: int, patterns: Array) -> Array:
    """Return the (NODES, r, r) coefficients of M of a unit under a contact, from its values at Chebyshev's nodes."""
    at = np.cos(np.pi * (np.arange(NODES) + 0.5) / NODES)
    contrasts = LEAST * np.exp((at + 1.0) / 2.0 * np.log(MOST / LEAST))
    values = []
    for contrast, change in zip(contrasts.tolist(), sheet.changes(unit, contrasts.tolist()), strict=True):
        sign = 1.0 if contrast > 1.0 else -1.0
        values.append(abs(contrast - 1.0) * grounded_inverse_form(sign * change, patterns))
    table = np.vander(at, NODES, increasing=True)
    return np.asarray(np.linalg.solve(table, np.array(values).reshape(NODES, -1)).reshape(NODES, *values[0].shape))


def save(model: ReducedModel, path: str | Path) -> None:
    """Write a model to a file, 17 MB; H is symmetric, and kept whole."""
    with replacing(Path(path)) as file:
        np.savez(
            file,
            format=FORMAT,
            version=VERSION,
            coupling=model.coupling,
            loads=model.loads,
            untouched=model.untouched,
            contacts=model.contacts.astype(np.int64),
            polynomials=model.polynomials,
            skin_digest=model.skin_digest,
            grid_id=model.grid_id,
            cloud_digest=model.cloud_digest,
        )


def load(path: str | Path, skin: Skin = PAPER, cloud_mm: npt.ArrayLike | None = None) -> ReducedModel:
    """Return the model of a file.

    Args:
        path: As :func:`save` wrote it.
        skin: Whose sheet it must be of.
        cloud_mm: The cloud it must be of; None takes any.

    Raises:
        ReducedError: It is none, or of another skin or cloud.
        OSError: It cannot be read.
    """
    try:
        file = read_npz(path, LARGEST_FILE)
        if str(file["format"]) != FORMAT or int(file["version"]) != VERSION:
            raise ReducedError(f"{path} is no reduced model of version {VERSION}; make it anew from the cloud")
        model = ReducedModel(
            coupling=np.asarray(file["coupling"], dtype=np.float32),
            loads=np.asarray(file["loads"], dtype=np.float64),
            untouched=np.asarray(file["untouched"], dtype=np.float64),
            contacts=np.asarray(file["contacts"], dtype=np.intp),
            polynomials=np.asarray(file["polynomials"], dtype=np.float64),
            shape=skin.grid.units,
            skin_digest=str(file["skin_digest"]),
            grid_id=str(file["grid_id"]),
            cloud_digest=str(file["cloud_digest"]),
        )
    except (FileError, KeyError, TypeError, ValueError) as error:
        if isinstance(error, ReducedError):
            raise
        raise ReducedError(f"{path} is no reduced model: {error}; make it anew from the cloud") from error
    _check(model, path, skin, cloud_mm)
    return model


def _check(model: ReducedModel, path: str | Path, skin: Skin, cloud_mm: npt.ArrayLike | None) -> None:
    for what, found, expected in (
        ("skin", model.skin_digest, skin.digest), ("grid", model.grid_id, skin.grid_id),
    ):  # fmt: skip
        if found != expected:
            raise ReducedError(
                f"{path} is of {what} {found}, expected {expected} of skin {skin.name!r}; make it anew from the cloud"
            )
    if cloud_mm is not None and model.cloud_digest != (own := cloud_digest(np.asarray(cloud_mm))):
        raise ReducedError(
            f"{path} is of cloud {model.cloud_digest or 'none'}, expected {own}; make it anew from the present cloud"
        )
    size = model.n_units * model.rank
    right = model.coupling.shape == (size, size) and model.untouched.shape == (N_ELECTRODES, N_ELECTRODES)
    if not right or model.n_units != skin.grid.n_units or len(model.polynomials) != len(model.contacts):
        raise ReducedError(f"{path} has matrices of wrong shapes; make it anew from the cloud")
