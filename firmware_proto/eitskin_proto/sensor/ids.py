"""The digest of the measurement table, which every artefact carries beside a skin's ``grid_id``, the digest of its map.

A bundle, data set, reference or device that was made for another table, sign or grid would give plausible nonsense.
The digests make it refuse instead. They change only when the meaning of the numbers changes.
"""

from typing import Final

from eitskin_proto.files.digest import id_of_values
from eitskin_proto.sensor import table

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
