"""Makes the shards of a data set: one deformation each, the same bits whoever makes them.

Everything follows from the plan: the touch sets, the bend, the noise of the scan. A worker process computes with one
BLAS thread, because the order of a threaded sum changes the last bits.
"""

from dataclasses import asdict
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from eitskin_sim.dataset import bend_from_json
from eitskin_sim.free_patterns import free_touch_sets
from eitskin_sim.free_touches import FreeTouches
from eitskin_sim.parts import Bend
from eitskin_sim.patterns import Bits, pack, paper_touch_sets, rich_touch_sets
from eitskin_sim.plan import Plan
from eitskin_sim.scanned import scanned_cloud
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
    common: Arrays = {"validation": plan.validation(), "reference": reference(plan)}
    if plan.set_name == "free":
        sets = free_sets(plan)
        return {**common, "pieces": sets.pieces, "first": sets.first}
    return {**common, "units": pack(unit_sets(plan))}


def reference(plan: Plan) -> npt.NDArray[np.float64]:
    """Return (104,) V of the flat, untouched sheet, from the same mesh as the samples."""
    return UnitGenerator(Bend()).untouched_V


def shard_job(plan: Plan, deformation: int) -> dict[str, Any]:
    """Return all that a worker needs to make one shard, as plain values."""
    return {
        "set": plan.set_name,
        "seed": plan.seed,
        "deformation": deformation,
        "bend": asdict(plan.bends[deformation]),
        "touch_sets": plan.touch_sets,
        "shown": plan.shown(deformation),
    }


def make_shard(job: dict[str, Any]) -> Arrays:
    """Return what one deformation's file holds."""
    bend = bend_from_json(job["bend"])
    shown: npt.NDArray[np.int32] = job["shown"]
    sets = _unit_sets(job["set"], job["touch_sets"], job["seed"])[shown]
    generator = UnitGenerator(bend)
    noise = np.random.default_rng([job["seed"], 3, job["deformation"]])
    return {
        "touch_set": shown,
        "voltages": generator.voltages(sets).astype(np.float32),
        "untouched": generator.untouched_V,
        "cloud": scanned_cloud(bend, noise),
    }
