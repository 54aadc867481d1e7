"""Makes the shards of a data set: one deformation each or a few, the same bits whoever makes them.

Everything follows from the plan: the touch sets, the bend, the noise of the scan. A worker process computes with one
BLAS thread, because the order of a threaded sum changes the last bits.
"""

from collections.abc import Iterator
from dataclasses import asdict
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from eitskin_sim.dataset import bend_from_json
from eitskin_sim.free import free_sheet, free_voltages
from eitskin_sim.free_patterns import chosen_touch_sets, free_touch_sets
from eitskin_sim.free_touches import FreeTouches
from eitskin_sim.parts import Bend, Scene
from eitskin_sim.patterns import Bits, pack, paper_touch_sets, rich_touch_sets
from eitskin_sim.plan import Plan
from eitskin_sim.scanned import scanned_cloud
from eitskin_sim.solve import solve_scene
from eitskin_sim.units import UnitGenerator

Arrays = dict[str, npt.NDArray[Any]]
"""What one ``.npz`` holds."""


def unit_sets(plan: Plan) -> Bits:
    """Return the (T, 126) touch sets of a plan on the unit grid."""
    return _unit_sets(plan.set_name, plan.touch_sets, plan.seed)


@lru_cache(maxsize=2)
def _unit_sets(set_name: str, count: int, seed: int) -> Bits:
    return paper_touch_sets(seed)[:count] if set_name == "paper" else rich_touch_sets(count, seed)


def free_sets(plan: Plan) -> FreeTouches:
    """Return the touch sets of a plan whose touches are anywhere."""
    return _free_sets(plan.touch_sets, plan.seed)


@lru_cache(maxsize=2)
def _free_sets(count: int, seed: int) -> FreeTouches:
    return free_touch_sets(count, seed)


def touches_file(plan: Plan) -> Arrays:
    """Return what ``touches.npz`` holds."""
    common: Arrays = {"validation": plan.validation(), "reference": reference()}
    if plan.set_name == "free":
        sets = free_sets(plan)
        return {**common, "pieces": sets.pieces, "first": sets.first}
    return {**common, "units": pack(unit_sets(plan))}


def reference() -> npt.NDArray[np.float64]:
    """Return (104,) V of the flat, untouched sheet."""
    return untouched(Bend())


def untouched(bend: Bend) -> npt.NDArray[np.float64]:
    """Return (104,) V of a bent, untouched sheet on the mesh of a scene, 1e-5 from converged."""
    return solve_scene(Scene(bend=bend)).voltages


def shard_job(plan: Plan, deformations: list[int]) -> dict[str, Any]:
    """Return all that a worker needs to make some deformations, which show the same touch sets, as plain values."""
    return {
        "set": plan.set_name,
        "seed": plan.seed,
        "deformations": deformations,
        "bends": [asdict(plan.bends[number]) for number in deformations],
        "touch_sets": plan.touch_sets,
        "shown": plan.shown(deformations[0]),
    }


def make_shard(job: dict[str, Any]) -> list[Arrays]:
    """Return what each deformation's file holds.

    Voltages come from the generator's mesh and are multiplied by what a finer mesh says of the untouched sheet over
    what the generator's says: that takes the mesh's own error out of every reference.
    """
    bends = [bend_from_json(bend) for bend in job["bends"]]
    shown: npt.NDArray[np.int32] = job["shown"]
    make = _free_voltages if job["set"] == "free" else _unit_voltages
    found: list[Arrays] = []
    for number, bend, (voltages, coarse) in zip(job["deformations"], bends, make(job, bends, shown), strict=True):
        fine = untouched(bend)
        noise = np.random.default_rng([job["seed"], 3, number])
        found.append(
            {
                "touch_set": shown,
                "voltages": (voltages * (fine / coarse)).astype(np.float32),
                "untouched": fine,
                "cloud": scanned_cloud(bend, noise),
            }
        )
    return found


_Made = Iterator[tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]]
"""(n, 104) and (104,) V of a deformation, touched and not."""


def _unit_voltages(job: dict[str, Any], bends: list[Bend], shown: npt.NDArray[np.int32]) -> _Made:
    sets = _unit_sets(job["set"], job["touch_sets"], job["seed"])[shown]
    for bend in bends:
        generator = UnitGenerator(bend)
        yield generator.voltages(sets), generator.untouched_V


def _free_voltages(job: dict[str, Any], bends: list[Bend], shown: npt.NDArray[np.int32]) -> _Made:
    sheets = [free_sheet(bend) for bend in bends]
    voltages = free_voltages(sheets, chosen_touch_sets(shown, job["seed"]))
    yield from zip(voltages, (sheet.untouched_V for sheet in sheets), strict=True)
