"""How far apart the two rules for cut elements are, on one mesh: the scenes' and the generators'.

Both rules are used on the mesh of the free set, whose lines know nothing of the touches. Apart is |dV - dV'| over |dV|
of the generators', over the 104 rows, dV the change of voltage over the untouched one's; off is the same against a
scene whose own mesh of 1.5 mm follows the touch. Touches are single ones by kind and size, at bends that no data set
has, a third of them flat.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from eitskin_sim.scene.parts import Bend
    from eitskin_sim.scene.touch_table import Array

SIDES_MM: Final = (5.0, 10.0, 20.0, 40.0)
KINDS: Final = {"rectangle": (0.0, 0.0), "turned": (0.0, 30.0), "disc": (1.0, 0.0)}
"""Name, and the kind and angle of its piece."""
PLACES_MM: Final = ((52.3, 41.7), (93.1, 63.4))
"""Middles of the touches, off every line of the mesh."""
CONTRAST: Final = 50.0
SCENE_MM: Final = 1.5
SEED: Final = 77


def rule_rows(sides_mm: Sequence[float] = SIDES_MM) -> list[dict[str, Any]]:
    """Return a row for every kind and size, and one for all.

    Args:
        sides_mm: Sides of squares and diameters of discs.
    """
    import numpy as np

    from eitskin_sim.fem.borders.cut_elements import factorise
    from eitskin_sim.fem.solve import solve_scene
    from eitskin_sim.freeform.sheet import inverted_sheet
    from eitskin_sim.freeform.voltages import set_voltages
    from eitskin_sim.scene.family import draw
    from eitskin_sim.scene.parts import Bend, Scene
    from eitskin_sim.scene.touch_table import gather

    names = [(kind, side) for kind in KINDS for side in sides_mm]
    pieces = [
        np.array([[KINDS[kind][0], x, y, side, side, KINDS[kind][1], CONTRAST]])
        for kind, side in names
        for x, y in PLACES_MM
    ]
    table = gather(pieces)
    sheets = [(bend, inverted_sheet(bend)) for bend in (Bend(), *draw("A", 3, SEED)[1:])]
    sets = [table.touches(number) for number in range(len(table))]

    def followed(bend: "Bend") -> "Array":
        scenes = [Scene(bend=bend, touches=touches, element_size_mm=SCENE_MM) for touches in ((), *sets)]
        bare, *touched = (solve_scene(scene).voltages for scene in scenes)
        return np.array(touched) / bare - 1.0

    generators = np.stack([set_voltages([sheet], table)[0] / sheet.untouched_V - 1.0 for _, sheet in sheets], axis=1)
    scenes = np.array(
        [[factorise(sheet.system, some).voltages() / sheet.untouched_V - 1.0 for _, sheet in sheets] for some in sets]
    )
    exact = np.stack([followed(bend) for bend, _ in sheets], axis=1)

    def percent(one: "Array", other: "Array") -> "Array":
        return np.asarray(100.0 * np.linalg.norm(one - other, axis=-1) / np.linalg.norm(other, axis=-1))

    apart, off, off_scene = percent(scenes, generators), percent(generators, exact), percent(scenes, exact)
    rows = []
    for number, (kind, side) in [*enumerate(names), (-1, ("all", 0.0))]:
        own = slice(None) if number < 0 else slice(len(PLACES_MM) * number, len(PLACES_MM) * (number + 1))
        rows.append(
            {
                "what": f"cut rules, {kind}" + (f" {side:g} mm" if side else ""),
                "method": "dV apart",
                "sets": int(apart[own].size),
                "apart_rms_percent": round(float(np.sqrt(np.mean(apart[own] ** 2))), 3),
                "apart_max_percent": round(float(apart[own].max()), 3),
                "generators_off_rms_percent": round(float(np.sqrt(np.mean(off[own] ** 2))), 2),
                "generators_off_max_percent": round(float(off[own].max()), 2),
                "scenes_off_rms_percent": round(float(np.sqrt(np.mean(off_scene[own] ** 2))), 2),
                "scenes_off_max_percent": round(float(off_scene[own].max()), 2),
            }
        )
    return rows
