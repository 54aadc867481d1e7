"""A sheet solved at one shape, and the derivatives of its voltages by every parameter, from one factorisation.

Let D[k, m] be the voltage of pair m under 1 A into pair k, A(p) the system at parameters p, and x_k its field. Then

    dD[k, m] / dp = - x_k . dA/dp x_m

with the fields held still. So a derivative needs no second solve: the system is assembled at p - h and p + h, and its
energy in the same fields is compared. Where contacts alone change, contacts alone are assembled; the sixteen are
changed at once, since the energy of each is its own.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from eitskin_sim.arrays import Array
from eitskin_sim.fem.borders.cut_elements import touch
from eitskin_sim.fem.contacts import contacts_of
from eitskin_sim.fem.forward import Factor, System, assemble
from eitskin_sim.fem.mesh import TensorMesh
from eitskin_sim.fem.meshing import scene_mesh
from eitskin_sim.scene.parts import Electrodes, Scene, Sheet, Touch

Metric = Callable[[Array], Array]

ELEMENT_MM: Final = 3.0
"""The untouched voltages are 2e-4 from converged."""

STEP_MM: Final = 1e-2
RELATIVE_STEP: Final = 1e-3
"""Half the distance of compared systems: of places and sizes, and of shapes (all of them near 1)."""

Touches = Sequence[Touch]


@dataclass(frozen=True, slots=True)
class Shape:
    """The layer's state: the change of its metric, and its material."""

    log_along: float = 0.0
    """Logarithm of a factor of all lengths along x."""
    log_across: float = 0.0
    nonuniformity: float = 0.0
    """Of the stretch along x, which no scan shows: times 1 + a cos(2 pi x / L)."""
    gauge_factor: float = 0.0
    log_thickness: float = 0.0
    """Over 1 mm."""

    def sheet(self, size_mm: tuple[float, float]) -> Sheet:
        """Return the layer, of 1 S/m."""
        return Sheet(size_mm, float(np.exp(self.log_thickness)), gauge_factor=self.gauge_factor)

    def metric(self, scanned: Metric, length_mm: float) -> Metric:
        """Return a scanned metric with what the shape changes about it."""

        def found(xy_mm: Array) -> Array:
            uneven = 1.0 + self.nonuniformity * np.cos(2.0 * np.pi * xy_mm[:, 0] / length_mm)
            along, across = np.exp(self.log_along) * uneven, np.exp(self.log_across)
            return np.asarray(scanned(xy_mm) * np.stack([along**2, along * across, across**2 + 0.0 * along], axis=-1))

        return found


class Solved:
    """One sheet.

    Args:
        size_mm: Of the flat sheet.
        electrodes: Patches, their impedances for a layer of 1 S/m.
        scanned: The metric that the scan shows, or the flat one.
        shape: What changes it.
        layer: (n, 2) mm -> (n, modes) modes of log conductivity.
        amplitudes: (modes,)
        touches: What presses it; the mesh does not follow their borders.
    """

    def __init__(
        self,
        size_mm: tuple[float, float],
        electrodes: Electrodes,
        scanned: Metric,
        shape: Shape,
        layer: Callable[[Array], Array],
        amplitudes: Array,
        touches: Touches = (),
    ) -> None:
        self.touches = tuple(touches)
        self.size_mm, self.electrodes, self.scanned, self.shape = size_mm, electrodes, scanned, shape
        sheet = shape.sheet(size_mm)
        self.mesh: TensorMesh = scene_mesh(Scene(sheet, electrodes, element_size_mm=ELEMENT_MM))
        self.modes = layer(self.mesh.centres_mm)
        self.factor_of_layer = np.exp(self.modes @ amplitudes)
        system = self._system(shape)
        self.factor = Factor(system, *_touched(system, self.touches))
        self.differences: Array = self.factor.differences()
        """(16, 16) V under 1 A for 1 S/m."""
        self._fields = self.factor.element_fields()

    def by_shape(self, name: str) -> Array:
        """Return (16, 16) dD by one of the numbers of a :class:`Shape`."""
        at = getattr(self.shape, name)
        low, high = (
            self._energy(self._system(replace(self.shape, **{name: at + h}))) for h in (-RELATIVE_STEP, RELATIVE_STEP)
        )
        return -(high - low) / (2.0 * RELATIVE_STEP)

    def by_place(self) -> Array:
        """Return (16, 16, 16) dD by each electrode's place along the border, in mm."""
        arc = np.array(self.electrodes.arc_length_mm)
        return self._by_contact(lambda h: replace(self.electrodes, arc_length_mm=tuple((arc + h).tolist())))

    def by_size(self) -> Array:
        """Return (16, 16, 16) dD by each electrode's size, in mm."""
        size = self.electrodes.sizes_mm()
        return self._by_contact(lambda h: replace(self.electrodes, size_mm=tuple((size + h).tolist())))

    def by_touches(self, low: Touches, high: Touches) -> Array:
        """Return (16, 16) how much more D is under some touches than under others, to first order.

        Args:
            low: Touches close to the sheet's own.
            high: Others.
        """
        system = self.factor.system
        energies = [self._energy(system, touches) for touches in (low, high)]
        return -(energies[1] - energies[0])

    def by_log_impedance(self) -> Array:
        """Return (16, 16, 16) dD by the logarithm of each contact's impedance."""
        contacts = self.factor.system.contacts
        rate = self.factor.density**2 * contacts.impedance_ohm_m2
        return self.factor.contact_powers(contacts, rate)

    def by_layer(self) -> Array:
        """Return (modes, 16, 16) dD by each mode's amplitude."""
        power = self.factor.element_powers(np.full(len(self.modes), self.factor.system.background))
        return np.asarray(-np.tensordot(self.modes.T, power, axes=1))

    def _system(self, shape: Shape) -> System:
        metric = shape.metric(self.scanned, self.size_mm[0])
        system = assemble(self.mesh, shape.sheet(self.size_mm), self.electrodes, metric)
        return layered(system, self.factor_of_layer)

    def _energy(self, system: System, touches: Touches | None = None) -> Array:
        """Return (16, 16) the energy of a system under touches, the sheet's own where None, in the held fields."""
        blocks, density = _touched(system, self.touches if touches is None else touches)
        found = np.tensordot(self._fields, blocks @ self._fields, axes=([0, 1], [0, 1]))
        return np.asarray(found + self.factor.contact_powers(system.contacts, density).sum(axis=0))

    def _by_contact(self, moved: Callable[[float], Electrodes]) -> Array:
        sheet, metric = self.shape.sheet(self.size_mm), self.shape.metric(self.scanned, self.size_mm[0])
        energies = []
        for h in (-STEP_MM, STEP_MM):
            contacts = contacts_of(self.mesh, sheet, moved(h), metric)
            contacts = replace(contacts, fringe_m=contacts.fringe_m / self.factor_of_layer[contacts.element])
            system = replace(self.factor.system, contacts=contacts)
            energies.append(self.factor.contact_powers(contacts, _touched(system, self.touches)[1]))
        return -(energies[1] - energies[0]) / (2.0 * STEP_MM)


def _touched(system: System, touches: Touches) -> tuple[Array, Array]:
    """Return (n_elements, 9, 9) S blocks and (m,) S/m^2 densities of contacts, under touches."""
    if touches:
        found = touch(system, touches)
        return found.blocks, found.density
    density = system.contacts.density(np.full(len(system.contacts.element), system.background))
    return system.background * system.stiffness, density


def layered(system: System, factor: Array) -> System:
    """Return a system whose elements conduct (n_elements,) times as well."""
    contacts = system.contacts
    return replace(
        system,
        stiffness=factor[:, None, None] * system.stiffness,
        contacts=replace(contacts, fringe_m=contacts.fringe_m / factor[contacts.element]),
        relative=factor * system.relative,
    )
