"""The sheet model beside the solid, on the paper's sheet, flat and bent: V and dV, with the solid's own error.

The solid is solved on two meshes, one of half the elements' size; their limit by Richardson is the truth, and how far
the finer mesh is from it is its error bar. Both contact laws of :func:`eitskin_sim.fem.solve.solve_scene` stand beside
it.
"""

import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.table import TABLE
from eitskin_proto.skin.skin import PAPER
from eitskin_sim.fem.contacts import FRINGE
from eitskin_sim.fem.forward import assemble
from eitskin_sim.fem.meshing import scene_mesh
from eitskin_sim.fem.solve import solve_scene
from eitskin_sim.scene.bend import bend_metric
from eitskin_sim.scene.parts import Bend, Scene, Touch
from eitskin_sim.scene.shapes import Rect
from eitskin_tools.bench.physics.solid import build_solid
from eitskin_tools.bench.physics.solid_mesh import Resolution, extrapolated

Array = npt.NDArray[np.float64]
Row = dict[str, Any]

FLAT: Final = Bend()
BENT: Final = Bend(angle_deg=120, axis_deg=20, stretch_along=1.1)
PLACES: Final[Mapping[str, tuple[float, float, float, float]]] = {
    "interior": PAPER.grid.unit_rect_mm(6, 4),
    "edge": PAPER.grid.unit_rect_mm(6, 0),
    "corner": PAPER.grid.unit_rect_mm(0, 0),
    "under a contact": (8.0, 0.0, 18.0, 10.0),
}
"""The edge unit's border halves a contact, the corner unit's cuts 0.2 mm off one; the last covers one."""
COARSE: Final = Resolution(contact_mm=0.8, touch_mm=2.0, largest_mm=12.0, growth=4.0)
LAWS: Final = ("constant", "modes")


@dataclass(frozen=True, slots=True)
class Truth:
    """What two solids say of one sheet: voltages by place, extrapolated, and the finer one's distance from that."""

    voltages: dict[str, Array]
    error: dict[str, Array]
    change: dict[str, Array]
    """dV / V of each touch."""
    change_error: dict[str, float]
    """Relative, of the finer mesh."""
    unknowns: int
    rounds: int


def slab_rows() -> list[Row]:
    """Return the rows of the flat and the bent sheet, and the fit of the constant to the flat one."""
    rows: list[Row] = []
    for name, bend in (("flat", FLAT), ("bent", BENT)):
        scene = Scene(bend=bend)
        start = perf_counter()
        truth = solve_truth(scene, PLACES, COARSE)
        seconds = perf_counter() - start
        print(f"slab: {name}, {truth.unknowns} unknowns, {truth.rounds} rounds, {seconds:.0f} s", file=sys.stderr)
        rows += compare(scene, PLACES, truth, name)
        if bend == FLAT:
            rows += [fit_constant(scene, truth.voltages["untouched"], truth.error["untouched"])]
    return rows


def solve_truth(scene: Scene, places: Mapping[str, tuple[float, float, float, float]], coarse: Resolution) -> Truth:
    """Return what a solid of twice the given fineness says, and how sure that is."""
    touches = {"untouched": (), **{place: (Touch((Rect(*box),)),) for place, box in places.items()}}
    every = tuple(touch for some in touches.values() for touch in some)
    found: list[dict[str, Array]] = []
    rounds, unknowns = 0, 0
    for resolution in (coarse, coarse.halved()):
        solid = build_solid(scene, resolution, every)
        unknowns = int(np.prod(solid.shape)) + 15
        solutions = {place: solid.voltages(some) for place, some in touches.items()}
        rounds = max(count for _, count in solutions.values())
        found.append({place: voltages for place, (voltages, _) in solutions.items()})
    limits = {place: extrapolated(found[0][place], found[1][place]) for place in touches}
    changes = [{place: voltages / one["untouched"] - 1 for place, voltages in one.items()} for one in found]
    change, off = {}, {}
    for place in places:
        change[place], gap = extrapolated(changes[0][place], changes[1][place])
        off[place] = float(np.linalg.norm(gap) / np.linalg.norm(change[place]))
    return Truth(
        {place: limit for place, (limit, _) in limits.items()},
        {place: np.abs(gap / limit) for place, (limit, gap) in limits.items()},
        change,
        off,
        unknowns,
        rounds,
    )


def compare(
    scene: Scene, places: Mapping[str, tuple[float, float, float, float]], truth: Truth, name: str
) -> list[Row]:
    """Return a row for each contact law and each place."""
    rows = []
    for law in LAWS:
        base = solve_scene(scene, law).voltages
        rows.append({"what": "slab", "sheet": name, "law": law, "touch": "untouched", **_voltage_errors(base, truth)})
        for place, box in places.items():
            touched = solve_scene(replace(scene, touches=(Touch((Rect(*box),)),)), law).voltages
            expected = truth.change[place]
            error = np.linalg.norm(touched / base - 1 - expected) / np.linalg.norm(expected)
            row: Row = {"what": "slab", "sheet": name, "law": law, "touch": place}
            row |= _voltage_errors(touched, truth, place)
            rows.append({**row, "dv_error": float(error), "dv_error_of_solid": truth.change_error[place]})
    return rows


def _voltage_errors(voltages: Array, truth: Truth, place: str = "untouched") -> Row:
    off = voltages / truth.voltages[place] - 1
    return {
        "v_error_max": float(np.abs(off).max()),
        "v_error_rms": float(np.sqrt(np.mean(off**2))),
        "v_error_of_solid_max": float(truth.error[place].max()),
    }


def fit_constant(scene: Scene, truth: Array, error: Array) -> Row:
    """Return the constant c of z + c t / sigma that fits untouched voltages best, with three measures of its spread.

    Args:
        scene: Untouched.
        truth: (104,) V.
        error: (104,) relative, of the truth.
    """
    system = assemble(scene_mesh(scene), scene.sheet, scene.electrodes, bend_metric(scene.bend, scene.sheet))

    def voltages(constant: float) -> Array:
        contacts = replace(system.contacts, fringe_m=system.contacts.fringe_m * (constant / FRINGE))
        return replace(system, contacts=contacts).factorise().voltages()

    low, high = 0.15, 0.22
    at_low, at_high = voltages(low) / truth - 1, voltages(high) / truth - 1
    slope = (at_high - at_low) / (high - low)

    def best(rows: npt.NDArray[np.bool_], offset: Array | float = 0.0) -> float:
        wanted = np.broadcast_to(at_low + offset, slope.shape)[rows]
        return low - float(slope[rows] @ wanted / (slope[rows] @ slope[rows]))

    everything = np.ones(len(truth), dtype=bool)
    fitted = best(everything)
    left_out = [best(TABLE[:, 0] != drive) for drive in range(16) if np.any(TABLE[:, 0] != drive)]
    rest = at_low + slope * (fitted - low)
    return {
        "what": "constant",
        "fitted": fitted,
        "spread_over_drives": float(np.sqrt(15 / 16 * np.sum((np.array(left_out) - np.mean(left_out)) ** 2))),
        "spread_by_solid": max(abs(best(everything, sign * error) - fitted) for sign in (1.0, -1.0)),
        "v_error_max": float(np.abs(rest).max()),
        "v_error_rms": float(np.sqrt(np.mean(rest**2))),
        "used": FRINGE,
    }
