"""A skin for simulators: the voltages of presses on a bent sheet, hundreds a second, or thousands linearly.

::

    contacts of a simulator -> Press(x, y, radius, depth) -> Sheet.voltages -> Skin(source=...) -> touches

The simulator gives the place and size of a press. :class:`Law` is an assumption about its effect on the sheet: a change
of conductivity, without force or dent. All presses share one mesh: each changes the conductivity of the elements under
it, and :mod:`eitskin_sim.shapes.sheet` solves for these alone. Linear voltages add up the effects of single elements.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array
from scipy.spatial import KDTree

from eitskin_proto.skin.cloud_file import load_surface
from eitskin_proto.skin.sheet_cloud import check_sheet
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.arrays import Array, Index
from eitskin_sim.fem.mesh import Metric
from eitskin_sim.freeform.mesh import shared_mesh, with_contacts, without_middle
from eitskin_sim.freeform.sheet import assembled_metric
from eitskin_sim.measurement.front_end import to_voltages
from eitskin_sim.scene.nominal import flat_metric_of, nominal_sheet
from eitskin_sim.shapes.elements import Blocks
from eitskin_sim.shapes.sheet import TouchedSheet
from eitskin_sim.surface.predict import fit_cloud

SMALLEST_RADIUS_MM: Final = 2.0
"""The smallest press, about half an element."""

HYDROGEL: Final = ((0.0, 1.0), (2.5, 0.93), (5.0, 0.82), (7.5, 0.68), (10.0, 0.51), (12.5, 0.32))
"""Depth in mm and conductivity ratio: a disc of 8 mm radius then takes away the conductance that training data assume
of a press on a soft sheet, :data:`eitskin_sim.freeform.touches.STRENGTH_MM2`."""


class Press(NamedTuple):
    """A finger on the sheet."""

    x_mm: float
    """On the flat sheet, as ``y_mm``."""
    y_mm: float
    radius_mm: float
    """Of the disc that it touches."""
    depth_mm: float
    """How far it goes in; the law's table says what that does."""


@dataclass(frozen=True, slots=True)
class Law:
    """What pressing and stretching do to conductivity: an assumption, to replace by your own sheet's.

    Args:
        table: (n, 2) depths in mm, rising, and the conductivity under a press over the untouched sheet's. Between two
            depths the ratio's logarithm is linear. Deeper presses are refused.
        border_mm: Width over which a press's effect fades, about its outline.
        gauge_factor: k of the stretch law, conductivity ~ (local area stretch)^-k; None takes the skin's.

    Raises:
        ValueError: The table is none, or the border is too narrow for the mesh.
    """

    table: npt.ArrayLike = HYDROGEL
    border_mm: float = 3.0
    gauge_factor: float | None = None

    def __post_init__(self) -> None:
        found = self._rows
        is_table = found.ndim == 2 and found.shape[1] == 2 and len(found) > 1 and np.isfinite(found).all()
        if not is_table or (np.diff(found[:, 0]) <= 0.0).any() or (found[:, 1] <= 0.0).any():
            raise ValueError(
                f"the law's table is {found.tolist()}; expected two or more rows of a depth in mm, rising, and a "
                "conductivity ratio above 0"
            )
        if not 1.0 <= self.border_mm <= 20.0:
            raise ValueError(f"the law's border_mm is {self.border_mm:g}; expected 1 to 20")

    @property
    def _rows(self) -> Array:
        return np.asarray(self.table, dtype=np.float64)

    @property
    def depths_mm(self) -> tuple[float, float]:
        """The least and the greatest depth of the table."""
        return float(self._rows[0, 0]), float(self._rows[-1, 0])

    def log_ratio(self, depth_mm: Array) -> Array:
        """Return the logarithms of the conductivity ratio at some depths."""
        depth, ratio = self._rows.T
        return np.asarray(np.interp(depth_mm, depth, np.log(ratio)))


class Sheet:
    """A sheet of one shape, to press. Voltages are those under 1 A.

    Args:
        skin: The skin as it is stated.
        cloud: Its shape: (3, rows, columns) mm, or the file that ``eitskin surface`` wrote; None is flat.
        law: What presses and stretch do to conductivity.

    Raises:
        ValueError: The cloud is malformed or of another skin, or the skin's outline is no rectangle.
    """

    def __init__(
        self, skin: Skin = PAPER, cloud: npt.ArrayLike | str | Path | None = None, law: Law | None = None
    ) -> None:
        self.skin, self.law = skin, law or Law()
        if isinstance(cloud, str | Path):
            cloud = load_surface(cloud, skin).measured_mm
        points = skin.grid.flat_cloud_mm() if cloud is None else check_sheet(cloud, skin)[0]
        self.cloud_mm: Array = np.asarray(points, dtype=np.float64)
        """(3, rows, columns), in the pose in which it was given."""
        self._surface = fit_cloud(points, skin.grid)
        flat = flat_metric_of(skin)
        self._sheet = self._of(flat if cloud is None else self._surface.metric)
        self.untouched_V: Array = self._sheet.untouched_V
        """(104,) of this shape, untouched: the prediction that goes with the cloud."""
        self.flat_V: Array = self.untouched_V if cloud is None else self._of(flat).untouched_V
        """(104,) of the flat sheet, untouched: the runtime's reference."""

    def _of(self, metric: Metric) -> TouchedSheet:
        stated, own = nominal_sheet(self.skin).gauge_factor, self.law.gauge_factor
        assembled = assembled_metric(metric, skin=self.skin, gauge=0.0 if own is None else own - stated)
        return TouchedSheet(assembled, shared_mesh(skin=self.skin))

    def voltages(self, presses: Sequence[Press]) -> Array:
        """Return (104,) V under 1 A while something presses; where presses overlap, their ratios multiply.

        Raises:
            ValueError: A press is off the sheet, too small, deeper than the table, or not a number.
        """
        changed = self._log_ratios([presses])
        element, sheet = changed.indices.astype(np.intp), self._sheet.sheet
        if not len(element):
            return self.untouched_V.copy()
        system, contacts = sheet.system, sheet.system.contacts
        sigma = np.full(len(sheet.before), system.background)
        sigma[element] *= np.exp(changed.data)
        density = np.zeros(len(sigma))
        density[contacts.element] = contacts.density(sigma[contacts.element])
        stiffness = sigma[element, None, None] * system.stiffness[element]
        blocks = without_middle(with_contacts(stiffness, element, density[element], contacts))
        base = Blocks(np.zeros_like(element), element, blocks)
        return self._sheet.solve_blocks(base, np.zeros((0, 8))).voltages_V

    def linear_voltages(self, frames: Sequence[Sequence[Press]]) -> Array:
        """Return (n, 104) V under 1 A of n frames' presses, faster and less exact than :meth:`voltages`.

        log(V / V untouched) is a sum over elements, each with the effect that a small disc of its conductivity has in
        an even current, 2 tanh(log ratio / 2).

        Raises:
            ValueError: As for :meth:`voltages`.
        """
        effects = self._log_ratios(frames)
        effects.data = 2.0 * np.tanh(effects.data / 2.0)
        return np.asarray(self.untouched_V * np.exp(effects @ self._by_element))

    def _log_ratios(self, frames: Sequence[Sequence[Press]]) -> csr_array:
        """Return (n, n_elements) logarithms of the conductivity ratios of elements: means of four points each."""
        found = self._checked([press for frame in frames for press in frame])
        count = np.cumsum([0, *(len(frame) for frame in frames)])
        mesh, radius = self._sheet.grid.mesh, found[:, 2]
        across, x = _near(mesh.x_lines_mm, found[:, 0], radius + self.law.border_mm / 2)
        up, y = _near(mesh.y_lines_mm, found[:, 1], radius + self.law.border_mm / 2)
        outside = np.sqrt((x**2)[:, None, :, None, :] + (y**2)[:, :, None, :, None]) - radius[:, None, None, None, None]
        share = np.clip(0.5 - outside / self.law.border_mm, 0.0, 1.0).mean(axis=(3, 4))
        change = self.law.log_ratio(found[:, 3])[:, None, None] * share
        element = up[:, :, None] * mesh.shape[1] + across[:, None, :]
        place = (change.ravel(), element.ravel(), count * (up.shape[1] * across.shape[1]))
        summed = csr_array(place, shape=(len(frames), mesh.n_elements))
        summed.sum_duplicates()
        summed.eliminate_zeros()
        return summed

    def places_mm(self, points_mm: npt.ArrayLike) -> Array:
        """Return the (n, 2) places on the flat sheet that are nearest to (n, 3) points in the cloud's frame."""
        points = np.asarray(points_mm, dtype=np.float64).reshape(-1, 3)
        places, tree = self._lattice
        return np.asarray(places[tree.query(points)[1]])

    @cached_property
    def _lattice(self) -> tuple[Array, KDTree]:
        """Places 0.25 mm apart, and their points in space."""
        sides = [np.linspace(0.0, extent, int(4 * extent) + 1) for extent in self.skin.outline.size_mm]
        places = np.stack(np.meshgrid(*sides), axis=-1).reshape(-1, 2)
        return places, KDTree(self._surface.points(places))

    @cached_property
    def _by_element(self) -> Array:
        """(n_elements, 104) derivatives of log V by each element's log conductivity."""
        sheet = self._sheet
        fields = np.append(sheet.to_terminals, np.zeros((1, sheet.to_terminals.shape[1])), axis=0)[sheet.grid.dofs]
        power = np.swapaxes(fields, 1, 2) @ (sheet.sheet.before @ fields)
        return np.asarray(to_voltages(-power) / self.untouched_V)

    def _checked(self, presses: Sequence[Press]) -> Array:
        """Return presses as (n, 4)."""
        found = np.array(presses, dtype=np.float64) if presses else np.zeros((0, 4))
        if found.shape != (len(presses), 4):
            raise ValueError(f"presses have shape {found.shape}; expected a list of Press(x, y, radius, depth) a frame")
        length, width = self.skin.outline.size_mm
        least = np.array([0.0, 0.0, SMALLEST_RADIUS_MM, self.law.depths_mm[0]])
        most = np.array([length, width, min(length, width) / 2, self.law.depths_mm[1]])
        right = (found >= least) & (found <= most)
        if not right.all():
            row, column = np.argwhere(~right)[0].tolist()
            raise ValueError(
                f"presses[{row}].{Press._fields[column]} is {found[row, column]:g}; expected {least[column]:g} to "
                f"{most[column]:g}" + (", the depths of the law's table" if column == 3 else "")
            )
        return found


def _near(lines_mm: Array, at_mm: Array, reach_mm: Array) -> tuple[Index, Array]:
    """Return (m, k) elements along an axis within reach of m places, and (m, k, 2) mm from these to two points of each.

    Beyond the last element stands that again, out of reach.
    """
    first = np.maximum(np.searchsorted(lines_mm, at_mm - reach_mm, side="right") - 1, 0)
    count = int((np.searchsorted(lines_mm, at_mm + reach_mm) - first).max(initial=0))
    element = first[:, None] + np.arange(count)
    low, size = np.append(lines_mm[:-1], np.inf), np.append(np.diff(lines_mm), 0.0)
    own = np.minimum(element, len(size) - 1)
    away = low[own, None] + size[own, None] * (0.25, 0.75) - at_mm[:, None, None]
    return np.minimum(element, len(size) - 2), away
