"""A plane disc with sixteen contacts on its rim, solved on the square that it is mapped onto.

In the disc the layer conducts K = sigma t, the same in every direction, and so it does in the square: the elements
there are those of a flat sheet. What differs are the contacts, whose conductance goes by the disc's lengths. They get
those as a metric whose length along the border is the map's scale and whose area stays 1, so that the layer keeps its
thickness.
"""

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from eitskin_proto.sensor.table import N_ELECTRODES
from eitskin_sim.arrays import Array
from eitskin_sim.fem.contacts import contacts_of
from eitskin_sim.fem.forward import System, assemble, flat_metric
from eitskin_sim.fem.mesh import Metric, TensorMesh
from eitskin_sim.scene.parts import Electrodes, Sheet
from eitskin_sim.tank.disc_map import DiscMap

SIDE_MM: Final = 100.0
"""Of the square: meshes are as fine in the disc's middle as this is to its diameter."""

EVEN_DEG: Final = tuple(-135.0 + 22.5 * (k + 0.5) for k in range(N_ELECTRODES))
"""Middles of even electrodes, four on each side of the square, none in a corner."""


@dataclass(frozen=True, slots=True)
class Disc:
    """A round layer and its contacts."""

    radius_mm: float
    thickness_mm: float = 2.0
    conductivity_S_per_m: float = 1.0
    electrodes_deg: tuple[float, ...] = EVEN_DEG
    """Middles of the 16 contacts, counter-clockwise from -135 degrees, where the square's corner (0, 0) lies."""
    electrode_width_deg: float | tuple[float, ...] = 5.0
    contact_impedance_ohm_m2: float | tuple[float, ...] = 1e-4
    """Of all contacts, or of each."""
    map: DiscMap = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "map", DiscMap(SIDE_MM, self.radius_mm))

    @property
    def sheet(self) -> Sheet:
        """The square's layer."""
        return Sheet((SIDE_MM, SIDE_MM), self.thickness_mm, self.conductivity_S_per_m)

    @property
    def electrodes(self) -> Electrodes:
        """The contacts on the square's border, each of its own width there."""
        middles, half = np.array(self.electrodes_deg), np.array(self.electrode_width_deg) / 2
        start, stop = (self.map.rim_to_arc_mm(middles + side) for side in (-half, half))
        perimeter = 4.0 * SIDE_MM
        sizes = np.remainder(stop - start, perimeter)
        centres = np.remainder(start + sizes / 2, perimeter)
        return Electrodes(
            contact="edge",
            size_mm=tuple(sizes.tolist()),
            contact_impedance_ohm_m2=self.contact_impedance_ohm_m2,
            arc_length_mm=tuple(centres.tolist()),
        )


def assemble_disc(mesh: TensorMesh, disc: Disc, metric: Metric = flat_metric) -> System:
    """Return the system of a disc.

    Args:
        mesh: Of the square, with lines at the ends of every contact (``disc.sheet``, ``disc.electrodes``).
        disc: What is solved.
        metric: The first fundamental form of the bent disc at points (n, 2) mm from its middle.

    Raises:
        ValueError: The mesh does not cover the square.
    """
    sheet, electrodes = disc.sheet, disc.electrodes
    turned = _turned(disc.map, metric)
    inner = assemble(mesh, sheet, electrodes, turned)
    return replace(inner, contacts=contacts_of(mesh, sheet, electrodes, _rim_metric(disc.map, turned)))


def turned_form(first: Array, angle: Array | float) -> Array:
    """Return first fundamental forms (n, 3) along axes that are turned by angles in rad."""
    E, F, G = first.T
    c, s = np.cos(angle), np.sin(angle)
    along, across = c * c * E + 2.0 * c * s * F + s * s * G, s * s * E - 2.0 * c * s * F + c * c * G
    return np.stack([along, c * s * (G - E) + (c * c - s * s) * F, across], axis=-1)


def _turned(disc: DiscMap, metric: Metric) -> Metric:
    """First fundamental form along the square's axes, which the map turns."""

    def turned(xy_mm: Array) -> Array:
        return turned_form(metric(disc.to_disc(xy_mm)), disc.turn(xy_mm))

    return turned


def _rim_metric(disc: DiscMap, inner: Metric) -> Metric:
    """E, F, G at points of the border: stretched by the scale along it, by its inverse across."""

    def metric(xy_mm: Array) -> Array:
        E, _, G = inner(xy_mm).T
        square = np.maximum(disc.scale(xy_mm), 1e-9) ** 2
        upright = (xy_mm[:, 0] < 1e-9 * SIDE_MM) | (xy_mm[:, 0] > (1.0 - 1e-9) * SIDE_MM)
        along_x, along_y = np.where(upright, 1.0 / square, square), np.where(upright, square, 1.0 / square)
        return np.stack([E * along_x, np.zeros(len(xy_mm)), G * along_y], axis=-1)

    return metric
