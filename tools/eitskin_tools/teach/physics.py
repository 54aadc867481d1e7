"""What physics expects of a press: the forward model's derivative by conductivity, summed over a disc.

It is the prior mean of the response field of a sheet with the project's own rows. Its weight, and whether it is used at
all, is left to the likelihood of the presses (:mod:`eitskin_tools.teach.response`).
"""

from typing import Final

import numpy as np

from eitskin_proto.files.arrays import Array
from eitskin_proto.sensor.row_table import ADJACENT_104, RowTable
from eitskin_proto.sensor.table import N_ROWS
from eitskin_proto.skin.skin import Skin
from eitskin_tools.command_line.needs import missing

RADIUS_MM: Final = 7.0
"""Of the disc; a finger's or a stamp's."""


def applies(skin: Skin, table: RowTable) -> bool:
    """Return whether the forward model is installed and knows the rows of this sheet: adjacent 104 of a rectangle."""
    own = table.id == ADJACENT_104.id or (table.electrodes is None and table.rows == N_ROWS)
    return own and skin.outline.kind == "rectangle" and not missing(("scipy",))


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
