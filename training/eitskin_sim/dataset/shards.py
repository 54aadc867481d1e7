"""Makes the shards of a data set: one deformation each or a few, the same bits from any worker.

Everything follows from the plan: touch sets, bends, devices, the noise of clouds. A worker process computes with one
BLAS thread, because the order of a threaded sum changes the last bits.
"""

from collections.abc import Iterator
from dataclasses import asdict
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_proto.skin.toml import to_toml
from eitskin_sim.dataset.device_files import device_file, device_job, job_skin, moment_of, referenced_device, true_bend
from eitskin_sim.dataset.plan import Plan
from eitskin_sim.dataset.reader import bend_from_json
from eitskin_sim.devices.device import Device, ideal
from eitskin_sim.fem.solve import solve_scene
from eitskin_sim.freeform.draws import SetPool, set_pool
from eitskin_sim.freeform.mesh import shared_mesh
from eitskin_sim.freeform.parts import geometry
from eitskin_sim.freeform.sheet import inverted_sheet
from eitskin_sim.freeform.touches import CLASSES, Ranges, contrasts_of, ranges_of
from eitskin_sim.freeform.voltages import pool_responses
from eitskin_sim.measurement.front_end import to_voltages
from eitskin_sim.scene.parts import Bend, Scene
from eitskin_sim.scene.touch_table import TouchTable
from eitskin_sim.surface.measured_cloud import measured_cloud
from eitskin_sim.unit_grid.patterns import Bits, UnitContrasts, pack, paper_touch_sets, rich_touch_sets, touch_classes
from eitskin_sim.unit_grid.units import UnitGenerator

Arrays = dict[str, npt.NDArray[Any]]
"""The arrays of one ``.npz``."""


def unit_sets(plan: Plan) -> Bits:
    """Return the (T, units) touch sets of a plan on the unit grid."""
    return _unit_sets(plan.set_name, plan.touch_sets, plan.seed, plan.skin.grid.units)


@lru_cache(maxsize=2)
def _unit_sets(set_name: str, count: int, seed: int, shape: tuple[int, int]) -> Bits:
    return paper_touch_sets(seed, shape)[:count] if set_name == "paper" else rich_touch_sets(count, seed, shape)


def unit_contrasts(plan: Plan) -> UnitContrasts:
    """Return the contrasts of a plan's touches on the unit grid, which are not hard ones."""
    ranges = ranges_of(plan.touches, plan.skin)
    return _unit_contrasts(plan.set_name, plan.touch_sets, plan.seed, plan.skin.grid.units, ranges)


@lru_cache(maxsize=2)
def _unit_contrasts(set_name: str, count: int, seed: int, shape: tuple[int, int], ranges: Ranges) -> UnitContrasts:
    generator = np.random.default_rng([seed, 6])
    contrast = contrasts_of(ranges, CLASSES, generator)
    sets = _unit_sets(set_name, count, seed, shape)
    return UnitContrasts(touch_classes(sets, CLASSES, generator, shape), contrast)


def freeform_sets(plan: Plan) -> TouchTable:
    """Return the touch sets of a plan whose touches are anywhere, deformation after deformation."""
    found: dict[int, TouchTable] = {}
    for shard in plan.shards():
        pool = _pool(shard_job(plan, shard))
        found.update((number, pool.touches(sets)) for number, sets in pool.sets.items())
    tables = [found[number] for number in range(len(plan.bends))]
    counts = np.concatenate([np.diff(table.first) for table in tables])
    first = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    return TouchTable(np.concatenate([table.pieces for table in tables]), first)


def touches_file(plan: Plan) -> Arrays:
    """Return the arrays of ``touches.npz``."""
    common: Arrays = {"validation": plan.validation(), "reference": reference(plan.skin)}
    if plan.set_name == "free":
        sets = freeform_sets(plan)
        return {**common, "pieces": sets.pieces, "first": sets.first}
    common["units"] = pack(unit_sets(plan))
    if plan.touches != "hard":
        own = unit_contrasts(plan)
        common.update(contrast_class=own.number, contrast=own.contrast)
    return common


@lru_cache(maxsize=4)
def reference(skin: Skin = PAPER) -> npt.NDArray[np.float64]:
    """Return (104,) V of the flat, untouched sheet that a skin states."""
    return untouched(Bend(), skin)


def untouched(bend: Bend, skin: Skin = PAPER) -> npt.NDArray[np.float64]:
    """Return (104,) V of a bent, untouched sheet on the mesh of a scene, 1e-5 from converged."""
    nominal = ideal(skin)
    return solve_scene(Scene(nominal.sheet, nominal.electrodes, bend)).voltages


def shard_job(plan: Plan, deformations: list[int]) -> dict[str, Any]:
    """Return all that a worker needs to make some deformations, as plain values."""
    together = next(shard for shard in plan.shards() if deformations[0] in shard)
    return {
        "set": plan.set_name,
        "skin": to_toml(plan.skin),
        "seed": plan.seed,
        "deformations": deformations,
        "bends": [asdict(plan.bends[number]) for number in deformations],
        "touch_sets": plan.touch_sets,
        "shown": [plan.shown(number) for number in deformations],
        "pool": {number: (plan.counts[number], plan.held_out(number)) for number in together},
        "near": plan.near,
        "touches": plan.touches,
        **device_job(plan, together[0]),
    }


def make_shard(job: dict[str, Any]) -> list[Arrays]:
    """Return the arrays of each deformation's file.

    Potentials come from the generator's mesh, and what a finer mesh says of the untouched sheet over what the
    generator's says takes the mesh's own error out of every reference.
    """
    bends = [bend_from_json(bend) for bend in job["bends"]]
    own = referenced_device(job, reference(job_skin(job))) if "device" in job else None
    devices = [ideal(job_skin(job))] * len(bends)
    if own is not None:
        devices = [own.drawn.device.since(moment_of(job, number).late) for number in job["deformations"]]
        bends = [true_bend(own.drawn, bend) for bend in bends]
    make = _free_responses if job["set"] == "free" else _unit_responses
    cases = zip(job["deformations"], bends, job["shown"], make(job, bends, devices), strict=True)
    found: list[Arrays] = []
    for (number, bend, shown, made), device in zip(cases, devices, strict=True):
        if own is None:
            file = _ideal_file(job, number, bend, made)
        else:
            file = device_file(job, number, bend, device, made, (own.reference_V, reference(job_skin(job))))
        found.append({"touch_set": shown, **file})
    return found


_Made = tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]
"""(n, 16, 16) and (16, 16) potentials of electrodes at a deformation, V for 1 A into each, touched and not."""


def _ideal_file(job: dict[str, Any], number: int, bend: Bend, made: _Made) -> Arrays:
    fine, coarse = untouched(bend, job_skin(job)), to_voltages(made[1])
    voltages = (to_voltages(made[0]) * (fine / coarse)).astype(np.float32)
    if job["set"] != "free" and job["touches"] == "hard":
        voltages = np.ascontiguousarray(voltages)  # these files have always been so, and digests are of their bytes
    return {
        "voltages": voltages,
        "untouched": fine,
        "cloud": measured_cloud(bend, np.random.default_rng([job["seed"], 3, number]), skin=job_skin(job)),
    }


def _unit_responses(job: dict[str, Any], bends: list[Bend], devices: list[Device]) -> Iterator[_Made]:
    drawn = (job["set"], job["touch_sets"], job["seed"], job_skin(job).grid.units)
    sets = _unit_sets(*drawn)
    for bend, device, shown in zip(bends, devices, job["shown"], strict=True):
        generator = UnitGenerator(bend, device=device, skin=job_skin(job))
        contrast = None
        if job["touches"] != "hard":
            contrast = _unit_contrasts(*drawn, ranges_of(job["touches"], job_skin(job))).of(shown)
        yield generator.responses(sets[shown], contrast), generator.at_terminals


def _pool(job: dict[str, Any]) -> SetPool:
    """Return the touches of a free shard and their sets, also of those of its deformations that are made already."""
    return set_pool(job["pool"], job["seed"], job["near"], job["touches"], job_skin(job))


def _free_responses(job: dict[str, Any], bends: list[Bend], devices: list[Device]) -> Iterator[_Made]:
    pool, grid = _pool(job), shared_mesh(electrodes=devices[0].electrodes, skin=job_skin(job))
    batches = geometry(pool.parts, grid)
    used = None
    for number, bend, device in zip(job["deformations"], bends, devices, strict=True):
        sheet = inverted_sheet(bend, into=used, device=device, skin=job_skin(job))
        yield pool_responses(sheet, grid, pool, batches, number), sheet.at_terminals
        used = sheet.inverse
