"""What else may have changed the voltages, fitted along with touches so that it is not taken for one.

::

    drift       of the whole layer's conductivity since the reference         part of it
    tilt x, y   drift that differs from end to end, a plane of rms 1          part of it
    gauge       conductivity goes with (local area stretch)^-k                k
    stretch     uneven stretch along the sheet, a cos(2 pi x / L), which      a
                no scan without marks can show

A mode is d log V per unit of its nuisance, of the untouched sheet at its present shape; times V it serves the touched
one too, but for what the two do to each other. Conductivities are answered by adjoint fields, of one factorisation; the
stretch moves voltages by 8 %, too much for a derivative, so that its curvature comes along.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.fem.forward import Factor, assemble
from eitskin_sim.fem.jacobian import jacobian
from eitskin_sim.fem.meshing import scene_mesh
from eitskin_sim.scene.nominal import nominal_electrodes, nominal_scene, nominal_sheet

Array = npt.NDArray[np.float64]
Metric = Callable[[Array], Array]
"""(n, 2) flat points in mm -> (n, 3) E, F, G."""

ELEMENT_MM: Final = 4.5
"""Of the mesh that modes are solved on: they need two digits."""

STEP: Final = 0.08
"""Amplitude of stretch between whose ends the derivative is taken."""


@dataclass(frozen=True, slots=True)
class Spreads:
    """Standard deviations of nuisances, before anything is measured; 0 leaves one out."""

    drift: float = 0.05
    tilt: float = 0.02
    gauge: float = 0.5
    stretch: float | None = None
    """None is what the skin's deformations say."""

    def stretch_of(self, skin: Skin) -> float:
        """Return the standard deviation of the amplitude of uneven stretch."""
        if self.stretch is not None:
            return self.stretch
        low, high = skin.deformations.nonuniformity
        return float(max(abs(low), abs(high)) / np.sqrt(3.0))


USUAL: Final = Spreads()
"""What a verifier assumes that is told nothing of the device."""


@dataclass(frozen=True, slots=True)
class Modes:
    """Nuisances of one shape of the sheet."""

    names: tuple[str, ...]
    logs: Array
    """(rows, m) d log V per unit of each."""
    sd: Array
    """(m,) how large each is expected to be, in its own unit."""
    curved: Array
    """(rows,) half the second derivative of log V by the amplitude of stretch."""

    @property
    def columns(self) -> Array:
        """Return (rows, m) log V for one standard deviation of each."""
        return self.logs * self.sd

    def of(self, name: str) -> int:
        """Return the number of a nuisance, -1 if it is left out."""
        return self.names.index(name) if name in self.names else -1


def stretched(metric: Metric, amplitude: float, length_mm: float) -> Metric:
    """Return a metric with a cos(2 pi x / L) added to the stretch along x, and nothing else changed."""

    def found(xy_mm: Array) -> Array:
        first = metric(xy_mm).copy()
        factor = 1.0 + amplitude * np.cos(2.0 * np.pi * xy_mm[:, 0] / length_mm) / np.sqrt(first[:, 0])
        first[:, 0] *= factor**2
        first[:, 1] *= factor
        return first

    return found


def factor_of(metric: Metric, skin: Skin = PAPER) -> Factor:
    """Return the untouched sheet of a metric, factorised on the modes' mesh."""
    mesh = scene_mesh(nominal_scene(skin, element_size_mm=ELEMENT_MM))
    return assemble(mesh, nominal_sheet(skin), nominal_electrodes(skin), metric).factorise()


def modes_of(metric: Metric, skin: Skin = PAPER, spreads: Spreads = USUAL) -> Modes:
    """Return the nuisances of an untouched sheet of some metric, those of no spread left out.

    Args:
        metric: Of the sheet as it is scanned.
        skin: Whose sheet.
        spreads: How large they are expected to be.
    """
    factor = factor_of(metric, skin)
    system, volts = factor.system, factor.voltages()
    sigma = np.full(system.mesh.n_elements, system.background)
    cells = np.arange(system.mesh.n_elements)
    by_element = jacobian(factor, sigma, cells, len(cells)) * (system.background / volts[:, None])
    length, width = skin.outline.size_mm
    x, y = system.mesh.centres_mm.T
    E, F, G = system.metric.T
    fields = {
        "drift": np.ones(len(cells)),
        "tilt x": np.sqrt(12.0) * (x / length - 0.5),
        "tilt y": np.sqrt(12.0) * (y / width - 0.5),
        "gauge": -0.5 * np.log(E * G - F**2),
    }
    sizes = {"drift": spreads.drift, "tilt x": spreads.tilt, "tilt y": spreads.tilt, "gauge": spreads.gauge}
    logs = {name: by_element @ field for name, field in fields.items()}
    sizes["stretch"] = spreads.stretch_of(skin)
    curved = np.zeros(len(volts))
    if sizes["stretch"] > 0.0:
        lower, upper = (
            np.log(np.abs(factor_of(stretched(metric, at, length), skin).voltages() / volts)) for at in (-STEP, STEP)
        )
        logs["stretch"] = (upper - lower) / (2.0 * STEP)
        curved = (upper + lower) / (2.0 * STEP**2)
    names = tuple(name for name in logs if sizes[name] > 0.0)
    columns = np.array([logs[name] for name in names]).reshape(len(names), len(volts)).T
    return Modes(names, columns, np.array([sizes[name] for name in names]), curved)
