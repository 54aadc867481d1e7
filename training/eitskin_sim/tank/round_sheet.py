"""A round skin: its voltages at bends and under touches, and their Jacobian on the pixels of its map.

The disc is solved on a square (:mod:`eitskin_sim.tank.disc`), turned so that no corner lies under an electrode. Its map
has the pixels of the square about it, of which those whose centres are inside count. An element of the mesh belongs to
the pixels at its points, so the fields, which the conformal map does not change, add up to the pixels' derivatives.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array

from eitskin_proto.sensor.table import N_ELECTRODES
from eitskin_proto.skin.skin import Skin
from eitskin_sim.arrays import Array
from eitskin_sim.fem.forward import System, flat_metric
from eitskin_sim.fem.jacobian import jacobian
from eitskin_sim.fem.mesh import TensorMesh
from eitskin_sim.fem.meshing import scene_mesh
from eitskin_sim.scene.bend import bend_metric
from eitskin_sim.scene.nominal import nominal_sheet
from eitskin_sim.scene.parts import Bend, Scene
from eitskin_sim.tank.disc import Disc, assemble_disc, turned_form

ELEMENT_MM: Final = 3.0
"""Of the square's mesh, whose side is 100 mm."""

POINTS: Final = 4
"""Along each side of an element, at which its pixel is looked up."""


@dataclass(frozen=True)
class RoundSheet:
    """A skin whose outline is a disc, as it is stated."""

    skin: Skin
    element_mm: float = ELEMENT_MM

    @property
    def square(self) -> Skin:
        """The same skin with the square about it for its outline: bends are defined on it."""
        return replace(self.skin, outline=replace(self.skin.outline, kind="rectangle"))

    @cached_property
    def inside(self) -> npt.NDArray[np.bool_]:
        """(pixels,) whose centres are on the sheet."""
        radius = self.skin.outline.size_mm[0] / 2
        return np.asarray(np.hypot(*(self.skin.grid.pixel_centres_mm().reshape(-1, 2) - radius).T) < radius)

    def voltages(self, bend: Bend | None = None, touches: Sequence[tuple[float, float, float, float]] = ()) -> Array:
        """Return the (104,) V under 1 A.

        Args:
            bend: Of the square about the disc; None is flat.
            touches: x, y, radius in mm and contrast of discs that conduct otherwise.
        """
        sigma = np.full(self._mesh.n_elements, self._disc.conductivity_S_per_m)
        for x, y, radius, contrast in touches:
            share = (np.linalg.norm(self._points_mm - (x, y), axis=-1) < radius).mean(axis=1)
            sigma *= contrast**share
        return self._system(bend).factorise(sigma).voltages()

    def relative_jacobian(self) -> Array:
        """Return the (104, pixels) relative change of each row with that of each pixel's conductivity; 0 outside."""
        count = self._mesh.n_elements
        sigma = np.full(count, self._disc.conductivity_S_per_m)
        factor = self._system(None).factorise()
        own = jacobian(factor, sigma, np.arange(count), count) * sigma / factor.voltages()[:, None]
        grid = self.skin.grid
        column, row = (self._points_mm / grid.pixel_mm).astype(np.intp).reshape(-1, 2).T
        pixel = np.clip(row, 0, grid.shape[0] - 1) * grid.shape[1] + np.clip(column, 0, grid.shape[1] - 1)
        weights = np.full(len(pixel), 1.0 / POINTS**2)
        element = np.repeat(np.arange(count), POINTS**2)
        return np.asarray((own @ csr_array((weights, (element, pixel)), (count, grid.n_pixels))) * self.inside)

    @cached_property
    def _turn_deg(self) -> float:
        """By which the disc is turned, so that the square's corners are as far from electrodes as they can be."""
        ends = self._angles_deg()[:, None] + np.outer(self._widths_deg(), (-0.5, 0.0, 0.5))
        turns = np.arange(0.0, 90.0, 0.25)
        away = np.abs((ends.ravel() - 45.0 - turns[:, None]) % 90.0 - 45.0)  # 45 is in the middle of a side
        return float(turns[(45.0 - away).min(axis=1).argmax()])

    @cached_property
    def _disc(self) -> Disc:
        skin = self.skin
        sheet = nominal_sheet(self.square)
        turned = (self._angles_deg() - self._turn_deg + 180.0) % 360.0 - 180.0
        return Disc(
            skin.outline.size_mm[0] / 2,
            sheet.thickness_mm,
            sheet.conductivity_S_per_m,
            tuple(turned.tolist()),
            tuple(self._widths_deg().tolist()),
            tuple(skin.electrodes.contact_impedance_ohm_m2.nominal(N_ELECTRODES).tolist()),
        )

    def _angles_deg(self) -> Array:
        return np.rad2deg(self.skin.arc_length_mm / (self.skin.outline.size_mm[0] / 2))

    def _widths_deg(self) -> Array:
        return np.rad2deg(self.skin.electrodes.size_mm.nominal(N_ELECTRODES) / (self.skin.outline.size_mm[0] / 2))

    @cached_property
    def _mesh(self) -> TensorMesh:
        return scene_mesh(Scene(self._disc.sheet, self._disc.electrodes, element_size_mm=self.element_mm))

    @cached_property
    def _points_mm(self) -> Array:
        """(elements, points, 2) of each element on the skin, from the corner of the square about it."""
        steps = (np.arange(POINTS) + 0.5) / POINTS
        shares = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
        mesh = self._mesh
        places = mesh.corners_mm[:, None] + mesh.sizes_mm[:, None] * shares
        return self._placed(self._disc.map.to_disc(places.reshape(-1, 2))).reshape(*places.shape)

    def _placed(self, disc_mm: Array) -> Array:
        """(n, 2) mm on the skin, of points (n, 2) mm from the middle of the turned disc."""
        angle = np.deg2rad(self._turn_deg)
        back = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        return np.asarray(disc_mm @ back + self._disc.radius_mm)

    def _system(self, bend: Bend | None) -> System:
        return assemble_disc(self._mesh, self._disc, flat_metric if bend is None else self._metric(bend))

    def _metric(self, bend: Bend) -> Callable[[Array], Array]:
        """First fundamental form at points (n, 2) mm from the middle of the turned disc, along its axes."""
        own = bend_metric(bend, nominal_sheet(self.square))

        def metric(disc_mm: Array) -> Array:
            return turned_form(own(self._placed(disc_mm)), np.deg2rad(self._turn_deg))

        return metric
