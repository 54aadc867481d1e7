"""What else may have changed the voltages, fitted along with touches so that it is not taken for one.

::

    drift       of the whole layer's conductivity since the reference            part of it
    tilt x, y   drift that differs from end to end, a plane of rms 1             part of it
    gauge       conductivity goes with (local area stretch)^-k                   k
    stretch     along x, by cos(2 pi x / L)                                      part of the local stretch
    shift x, y  along x and along y, by (2 x / L - 1)(2 y / W - 1)               part of the local stretch

The last three are material that lies elsewhere on the surface than a scan without marks can tell
(:mod:`eitskin_sim.verification.material`). A mode is d log V per unit of its nuisance, of the untouched sheet at its
present shape; times V it serves the touched one too, but for what the two do to each other. Conductivities are answered
by adjoint fields, of one factorisation.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.table import TABLE
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.fem.forward import Factor, System, assemble
from eitskin_sim.fem.jacobian import jacobian
from eitskin_sim.fem.mesh import Metric
from eitskin_sim.fem.meshing import scene_mesh
from eitskin_sim.scene.nominal import nominal_electrodes, nominal_scene, nominal_sheet
from eitskin_sim.verification.material import MATERIAL, moved, spreads_of
from eitskin_sim.verification.spreads import Spreads, layer_fields, usual

Array = npt.NDArray[np.float64]
ELEMENT_MM: Final = 4.5
"""Of the mesh that modes are solved on: they need two digits."""

STEP: Final = 1e-4
"""Amplitude of material over which the derivative of the stiffness is taken."""


@dataclass(frozen=True, slots=True)
class Modes:
    """Nuisances of one shape of the sheet."""

    names: tuple[str, ...]
    logs: Array
    """(rows, m) d log V per unit of each."""
    sd: Array
    """(m,) how large each is expected to be, in its own unit."""

    @property
    def columns(self) -> Array:
        """Return (rows, m) log V for one standard deviation of each."""
        return self.logs * self.sd

    def of(self, name: str) -> int:
        """Return the number of a nuisance, -1 if it is left out."""
        return self.names.index(name) if name in self.names else -1


def remembered(metric: Metric) -> Metric:
    """Return a metric that looks at no point twice: one mesh asks for the same ones again."""
    found: dict[bytes, Array] = {}

    def at(xy_mm: Array) -> Array:
        key = xy_mm.tobytes()
        if key not in found:
            found[key] = metric(xy_mm)
        return found[key]

    return at


def factor_of(metric: Metric, skin: Skin = PAPER) -> Factor:
    """Return the untouched sheet of a metric, factorised on the modes' mesh."""
    mesh = scene_mesh(nominal_scene(skin, element_size_mm=ELEMENT_MM))
    return assemble(mesh, nominal_sheet(skin), nominal_electrodes(skin), metric).factorise()


def modes_of(metric: Metric, skin: Skin = PAPER, spreads: Spreads | None = None) -> Modes:
    """Return the nuisances of an untouched sheet of some metric, those of no spread left out.

    Args:
        metric: Of the sheet as it is scanned.
        skin: Whose sheet.
        spreads: How large they are expected to be; None is what the skin says.
    """
    spreads, metric = spreads or usual(skin), remembered(metric)
    factor = factor_of(metric, skin)
    system, volts = factor.system, factor.voltages()
    sigma = np.full(system.mesh.n_elements, system.background)
    cells = np.arange(system.mesh.n_elements)
    by_element = jacobian(factor, sigma, cells, len(cells)) * (system.background / volts[:, None])
    fields = layer_fields(system.mesh.centres_mm, system.metric, skin, spreads)
    sizes = {name: size for name, (_, size) in fields.items()}
    logs = {name: by_element @ field for name, (field, _) in fields.items()}
    for number, (name, spread) in enumerate(spreads_of(skin).items()):
        sizes[name] = spreads.material * spread
        if sizes[name] > 0.0:
            logs[name] = _of_material(factor, metric, number, skin) / volts
    names = tuple(name for name in logs if sizes[name] > 0.0)
    columns = np.array([logs[name] for name in names]).reshape(len(names), len(volts)).T
    return Modes(names, columns, np.array([sizes[name] for name in names]))


def _of_material(factor: Factor, metric: Metric, number: int, skin: Skin) -> Array:
    """Return (rows,) dV per amplitude of one of ``MATERIAL``: - x_m . dK x_k, by the fields of the sheet as it is.

    What its contacts pass changes with the area under them, and counts too.
    """
    system = factor.system
    other = assemble(system.mesh, nominal_sheet(skin), nominal_electrodes(skin), moved(metric, _only(number), skin))
    fields, drops = factor.element_fields(), factor.contact_drops()
    change = system.background * (other.stiffness - system.stiffness)
    energy = np.tensordot(fields, change @ fields, axes=([0, 1], [0, 1]))
    energy += np.tensordot(drops, (_passed(other) - _passed(system)) @ drops, axes=([0, 1], [0, 1]))
    return np.asarray(-energy[TABLE[:, 0], TABLE[:, 1]] / STEP)


def _passed(system: System) -> Array:
    """Return (m, 9, 9) S of every piece of contact."""
    own = system.contacts.density(np.full(len(system.contacts.element), system.background))
    return np.asarray(own[:, None, None] * system.contacts.mass_m2)


def _only(number: int) -> tuple[float, ...]:
    return tuple(STEP if one == number else 0.0 for one in range(len(MATERIAL)))
