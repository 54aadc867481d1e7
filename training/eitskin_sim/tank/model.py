"""A disc as the model of a tank: its water's voltages, and their Jacobian on the square onto which it is mapped.

The unknowns are relative changes of conductivity on 30 x 30 cells of the square.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from eitskin_proto.sensor.table import FULL_TABLE, RECIPROCAL_IN_FULL, ROW_IN_FULL
from eitskin_proto.skin.skin import Skin
from eitskin_sim.arrays import Array
from eitskin_sim.fem.jacobian import cell_mesh, cell_of_element, jacobian
from eitskin_sim.fem.meshing import scene_mesh
from eitskin_sim.scene.parts import Scene
from eitskin_sim.solvers.tikhonov import tikhonov_matrix
from eitskin_sim.tank.disc import SIDE_MM, Disc, assemble_disc
from eitskin_sim.tank.front_end import OffsetAndGains, best_model, fit_front_end
from eitskin_sim.tank.recording import TankError, TankFrame

CELLS: Final = (30, 30)
"""Of the square."""

ELEMENT_MM: Final = 4.5
"""Of the square's mesh, as for the solvers of sheets."""

FACTOR: Final = 1e-2
"""Tikhonov's, for rows good to 2.5 %; a sheet's are good to 0.3 % and have 1e-4."""

SENSITIVITY_POWER: Final = 1.0
"""Cells of a disc's rim are far more sensitive than a sheet's."""

NEIGHBOURHOOD_SIGMA: Final = 0.1
"""Sigma of the neighbourhood, of the radius."""

WIDTHS_DEG: Final = (2.0, 8.0, 14.0, 18.0, 20.0, 22.0)
"""Widths of electrodes that are tried: in a tank they stand for whatever spreads the current, its depth too."""

EVEN_CURRENT_OHM_M2: Final = 10.0
"""A contact impedance so high that the current passes a contact evenly."""


@dataclass(frozen=True, slots=True, eq=False)
class TankModel:
    """A disc that explains a tank, and what images of it are made by."""

    disc: Disc
    water_V: Array
    """(208,) of the model."""
    relative: Array
    """(104, n) relative change of each row with each cell's, the mean of it and its reciprocal."""
    matrix: Array
    """(n, 104) Tikhonov's, from changes to cells."""
    places: Array
    """(n, 2) of the cells in the disc, in radii."""
    neighbourhoods: Array
    """(n, n) from cells to sums over neighbourhoods."""


def tank_model(frames: Sequence[TankFrame], widths_deg: Sequence[float] = WIDTHS_DEG) -> TankModel:
    """Return the disc that explains the water of all frames best.

    Args:
        frames: Of one tank.
        widths_deg: Widths of electrodes that are tried.
    """
    discs = [_disc(width) for width in widths_deg]
    models = []
    for disc in discs:
        mesh = scene_mesh(Scene(disc.sheet, disc.electrodes, element_size_mm=ELEMENT_MM))
        models.append(assemble_disc(mesh, disc).factorise().voltages(FULL_TABLE))
    return model_of(discs[best_model([frame.water_V for frame in frames], models)])


def widths_deg(skin: Skin) -> tuple[float, ...]:
    """Return the widths of electrodes that a skin leaves open: the stated one, and from a spread below to one above.

    Raises:
        TankError: The skin is no disc with even electrodes of one width.
    """
    if skin.outline.kind != "disc":
        raise TankError(
            f"skin {skin.name!r}: [outline] kind is {skin.outline.kind!r}, expected 'disc': a tank is round; leave "
            "--skin out, or describe the tank"
        )
    diameter, size = skin.outline.size_mm[0], skin.electrodes.size_mm
    apart = np.diff(skin.arc_length_mm)
    if not np.allclose(apart, apart[0], rtol=1e-3) or isinstance(size.value, tuple):
        raise TankError(f"skin {skin.name!r}: expected a tank's electrodes at even distances, and all of one size_mm")
    stated, spread = float(size.value), size.spread * (float(size.value) if size.law == "log_normal" else 1.0)
    tried = sorted({stated - spread, stated - spread / 2, stated, stated + spread / 2, stated + spread})
    return tuple(float(np.rad2deg(2.0 * one / diameter)) for one in tried if one > 0.0)


def _disc(width_deg: float) -> Disc:
    return Disc(1.0, electrode_width_deg=width_deg, contact_impedance_ohm_m2=EVEN_CURRENT_OHM_M2)


def model_of(disc: Disc) -> TankModel:
    """Return the model of a disc, from which its images are made."""
    mesh = cell_mesh(disc.sheet, disc.electrodes, CELLS, ELEMENT_MM)
    factor = assemble_disc(mesh, disc).factorise()
    count = CELLS[0] * CELLS[1]
    sigma = np.full(mesh.n_elements, disc.conductivity_S_per_m)
    water = factor.voltages(FULL_TABLE)
    slope = disc.conductivity_S_per_m * jacobian(factor, sigma, cell_of_element(mesh, CELLS), count, FULL_TABLE)
    full = slope / water[:, None]
    relative = (full[ROW_IN_FULL] + full[RECIPROCAL_IN_FULL]) / 2
    middles = (np.indices(CELLS)[::-1].reshape(2, -1).T + 0.5) * SIDE_MM / CELLS[0]
    places = disc.map.to_disc(middles) / disc.radius_mm
    area = disc.map.scale(middles) ** 2
    apart = np.sum((places[:, None] - places) ** 2, axis=-1)
    return TankModel(
        disc=disc,
        water_V=water,
        relative=relative,
        matrix=tikhonov_matrix(relative, FACTOR, SENSITIVITY_POWER),
        places=places,
        neighbourhoods=np.exp(-apart / (2.0 * NEIGHBOURHOOD_SIGMA**2)) * area,
    )


def front_end_of(model: TankModel, frame: TankFrame) -> OffsetAndGains:
    """Return the front end that explains a frame's water in the model.

    Raises:
        TankError: It cannot be determined.
    """
    try:
        return fit_front_end(frame.water_V, model.water_V)
    except ValueError as error:
        raise TankError(f"{frame.name}: {error}") from error
