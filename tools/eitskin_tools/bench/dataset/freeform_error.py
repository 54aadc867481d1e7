"""How far the free set's changes of voltage are from those of finer meshes, at several sizes of its elements.

Sets are drawn as the data set draws them, at deformations that it never has. Off is |dV - dV_scene| / |dV_scene| over
the 104 rows, dV the change of voltage over the untouched one's, the scene solved on a mesh of 1.5 mm that follows the
touches' borders. The reference's own error, a third of its scenes against meshes of 1 mm, is given beside it. Pairs of
touches with a little between them show the known limit: a gap inside one element conducts as if the touches met there.
"""

import sys
from collections.abc import Iterator
from time import process_time
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from eitskin_sim.scene.parts import Bend
    from eitskin_sim.scene.touch_table import Array, TouchTable

SCENE_MM: Final = 1.5
FINER_MM: Final = 1.0
SIZES_MM: Final = (4.0, 3.5, 3.0)
DEFORMATIONS: Final = 3
SEED: Final = 77
"""Of deformations and sets; data sets have other seeds."""
GAPS_MM: Final = (1.0, 2.0, 3.5, 5.0)
PLACES_MM: Final = ((52.3, 41.7), (93.1, 63.4), (71.6, 22.9))
"""Where pairs of 10 mm touches have their middles."""


def error_rows(count: int) -> list[dict[str, Any]]:
    """Return a row for every element size, and one for the reference itself.

    Args:
        count: Touch sets in all, spread over three unseen deformations.
    """
    import numpy as np

    from eitskin_sim.freeform.mesh import ELEMENT_MM
    from eitskin_sim.freeform.pool import set_pool
    from eitskin_sim.freeform.sheet import inverted_sheet
    from eitskin_sim.freeform.voltages import set_voltages
    from eitskin_sim.scene.family import draw

    bends = draw("A", DEFORMATIONS + 1, SEED)[1:]
    each = [len(own) for own in np.array_split(np.arange(count), len(bends))]
    tables = []
    for number, share in enumerate(each):
        pool = set_pool({number: (4 * share + 40, 0)}, SEED)
        table = pool.touches(pool.sets[number])
        touched = np.flatnonzero(np.diff(table.first) > 0)[:share]
        tables.append(table.chosen(touched))

    def scene_change(size_mm: float, step: int = 1) -> Any:
        return np.array(
            [
                solved / bare - 1.0
                for bend, table in zip(bends, tables, strict=True)
                for bare, solved in _scenes(bend, table.chosen(np.arange(0, len(table), step)), size_mm)
            ]
        )

    print(f"eitskin bench dataset: {count} sets solved as scenes of {SCENE_MM:g} mm", file=sys.stderr)
    exact = scene_change(SCENE_MM)
    rows = [_row("scene", SCENE_MM, scene_change(SCENE_MM, 3), scene_change(FINER_MM, 3), 0.0)]
    for size_mm in sorted({*SIZES_MM, ELEMENT_MM}, reverse=True):
        start = process_time()
        sheets = [inverted_sheet(bend, size_mm) for bend in bends]
        made = process_time() - start
        found = [
            set_voltages([sheet], table, size_mm)[0] / sheet.untouched_V - 1.0
            for sheet, table in zip(sheets, tables, strict=True)
        ]
        name = "free, default" if size_mm == ELEMENT_MM else "free"
        rows.append(_row(name, size_mm, np.concatenate(found), exact, made / len(bends)))
    return rows


def gap_rows() -> list[dict[str, Any]]:
    """Return a row for every gap between two touches of 10 mm, on the default mesh of the flat sheet."""
    import numpy as np

    from eitskin_sim.freeform.mesh import ELEMENT_MM
    from eitskin_sim.freeform.sheet import inverted_sheet
    from eitskin_sim.freeform.voltages import set_voltages
    from eitskin_sim.scene.parts import Bend
    from eitskin_sim.scene.touch_table import gather

    sheet, rows = inverted_sheet(Bend()), []
    for gap in GAPS_MM:
        half = 5.0 + gap / 2
        pairs = [[[0.0, x + side, y, 10.0, 10.0, 0.0, 50.0] for side in (-half, half)] for x, y in PLACES_MM]
        table = gather([np.array(pair) for pair in pairs])
        exact = np.array([solved / bare - 1.0 for bare, solved in _scenes(Bend(), table, SCENE_MM)])
        found = set_voltages([sheet], table)[0] / sheet.untouched_V - 1.0
        rows.append(_row(f"free, pair {gap:g} mm apart", ELEMENT_MM, found, exact, 0.0))
    return rows


def _scenes(bend: "Bend", table: "TouchTable", size_mm: float) -> "Iterator[tuple[Array, Array]]":
    """Yield the untouched voltages and the touched ones of every set."""
    from eitskin_sim.fem.solve import solve_scene
    from eitskin_sim.scene.parts import Scene

    bare = solve_scene(Scene(bend=bend, element_size_mm=size_mm)).voltages
    for number in range(len(table)):
        yield bare, solve_scene(Scene(bend=bend, touches=table.touches(number), element_size_mm=size_mm)).voltages


def _row(what: str, size_mm: float, found: Any, exact: Any, sheet_s: float) -> dict[str, Any]:
    import numpy as np

    off = 100.0 * np.linalg.norm(found - exact, axis=1) / np.linalg.norm(exact, axis=1)
    return {
        "what": what,
        "method": "dV error",
        "element_mm": size_mm,
        "sets": len(off),
        "median_percent": round(float(np.median(off)), 2),
        "mean_percent": round(float(np.mean(off)), 2),
        "worst_percent": round(float(np.max(off)), 2),
        "sheet_cpu_s": round(sheet_s, 2),
    }
