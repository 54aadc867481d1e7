"""Digests that every artefact carries: ``PROTOCOL_ID`` for what is measured, ``GRID_ID`` for where results are drawn.

A bundle, data set, reference or device that was made for another table, sign or grid would give plausible nonsense.
The digests make it refuse instead. They change only when the meaning of the numbers changes.
"""

from typing import Final

from eitskin_proto.files.digest import id_of_values
from eitskin_proto.sensor import grid, table

PROTOCOL_ID: Final = id_of_values(
    {
        "table": table.TABLE.tolist(),
        "full_table": table.FULL_TABLE.tolist(),
        "drive": "+1 A into k, out of k + 1",
        "measure": "U[m] - U[m + 1]",
        "normalisation": "(V - V0) / V0",
        "electrodes": "counter-clockwise from (0, 0)",
    }
)
"""16 hex digits that stand for the table of measurements, its signs and the normalisation."""

GRID_ID: Final = id_of_values(
    {
        "sheet_mm": grid.SHEET_MM,
        "shape": grid.GRID_SHAPE,
        "order": "row-major from (0, 0), x along columns",
        "units": grid.UNIT_SHAPE,
        "electrode_arc_mm": grid.ELECTRODE_ARC_MM.tolist(),
    }
)
"""16 hex digits that stand for the map, the units and the electrodes on the flat sheet."""
