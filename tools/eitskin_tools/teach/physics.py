"""What physics expects of a press: the forward model's derivative by conductivity, summed over a disc.

It is the prior mean of the response field of a sheet with the project's own rows. Its weight, and whether it is used at
all, is left to the likelihood of the presses (:mod:`eitskin_tools.teach.response`).
"""

from typing import Final

import numpy as np

from eitskin_proto.files.arrays import Array
from eitskin_proto.sensor.row_table import ADJACENT_104, RowTable, row_map
from eitskin_proto.sensor.table import N_FULL_ROWS, N_ROWS
from eitskin_proto.sensor.wiring import lag_of, read_wiring
from eitskin_proto.skin.skin import Skin
from eitskin_tools.command_line.needs import missing
from eitskin_tools.teach.presses import Presses

RADIUS_MM: Final = 7.0
"""Of the disc; a finger's or a stamp's."""


def applies(skin: Skin, table: RowTable) -> bool:
    """Return whether the forward model is installed and knows the rows of this sheet: adjacent 104 of a rectangle."""
    own = table.id == ADJACENT_104.id or (table.electrodes is None and table.rows == N_ROWS)
    return own and skin.outline.kind == "rectangle" and not missing(("scipy",))


def wiring_of(presses: Presses, skin: Skin) -> str:
    """Return what is wrong with the order of readings or of rows, as far as it can be known; empty if nothing is."""
    if presses.is_change:
        return ""
    if late := lag_of(presses.readings, presses.pressed):
        return f"readings are shifted by one against xy_mm, probably {'late' if late > 0 else 'early'}"
    readings = presses.readings[~presses.pressed]
    if skin.outline.kind != "rectangle" or missing(("scipy",)):
        return ""
    if presses.table.electrodes is not None:
        try:
            mapped = row_map(presses.table, ADJACENT_104)
        except ValueError:
            return ""
        if mapped is not None:
            readings, given = np.zeros((len(readings), N_ROWS)), readings
            for row, out in zip(given, readings, strict=True):
                mapped.apply(row, out)
    if readings.shape[1] not in (N_ROWS, N_FULL_ROWS):
        return ""
    from eitskin_sim.surface.predict import flat_voltages

    wiring = read_wiring(readings, flat_voltages(skin))
    return "" if wiring.right else wiring.text


def expected_changes(skin: Skin, places_mm: Array) -> Array:
    """Return (n, 104) log(V / V_untouched) of presses, up to a common factor.

    Args:
        skin: The sheet.
        places_mm: (n, 2)
    """
    from eitskin_sim.fem.jacobian import flat_jacobian

    centres, pitch = skin.grid.pixel_centres_mm().reshape(-1, 2), skin.grid.pitch_mm
    distance = np.sqrt(((places_mm[:, None] - centres) ** 2).sum(axis=-1))
    covered = np.clip((RADIUS_MM - distance) / pitch + 0.5, 0.0, 1.0)
    return np.asarray(covered @ flat_jacobian(skin).T)
