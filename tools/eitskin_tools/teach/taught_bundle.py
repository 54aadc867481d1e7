"""Writes what a sheet was taught as a bundle; with a skin's file and the project's own rows it has Tikhonov too."""

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from eitskin.model.bundle import taught_file
from eitskin_proto.files.arrays import pack_arrays
from eitskin_tools.teach import card, physics
from eitskin_tools.teach.presses import Presses
from eitskin_tools.teach.teaching import Taught


def write_taught(path: Path, taught: dict[str, Taught], presses: Presses, *, tikhonov: bool) -> str:
    """Write the bundle in one rename, and return its id.

    Args:
        path: Where.
        taught: What was learned, by the names of the sheet's shapes.
        presses: Of one of them; they state the rows.
        tikhonov: Whether the skin is known well enough for the classical solver.
    """
    from eitskin_export.bundle import projection_bytes, write

    files = {taught_file(number): pack_arrays(one.arrays) for number, one in enumerate(taught.values())}
    report = card.of_shapes({name: one.report for name, one in taught.items()})
    skin = next(iter(taught.values())).skin.touched(report["touches"])
    if tikhonov and physics.applies(skin, presses.table):
        from eitskin_sim.fem.jacobian import flat_jacobian
        from eitskin_sim.solvers.tikhonov import tikhonov_matrix

        files["tikhonov.npy"] = projection_bytes(tikhonov_matrix(flat_jacobian(skin)), skin.grid)
    facts: dict[str, Any] = {
        "created_utc": datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        "labels": "area",
        "touches": report["touches"],
        "rows": presses.table.rows,
        "shapes": list(taught),
        "gate": {"false_alarm_rate": report["false_alarms"]},
        "metrics": {"taught": report},
    }
    if presses.table.electrodes is not None:
        facts["table"] = presses.table.electrodes.tolist()
    return write(path, files, facts, skin)
