"""``eitskin bench dataset``: samples a second of the data generators, beside one solve a sample.

All rows come from one run on one core. The ratios use ``cpu_s``, which counts on a machine that does other work too. A
row's ``note`` names the set-up that its seconds include. "naive" factorises the same mesh for every sample, and its
voltages check ours.
"""

import argparse
from collections.abc import Callable
from time import perf_counter, process_time
from typing import Any

import numpy as np

from eitskin_sim.arrays import Array
from eitskin_sim.dataset.plan import DEFORMATIONS_PER_POOL, VALIDATION_SHARE, make_plan
from eitskin_sim.dataset.shards import make_shard, reference, shard_job, unit_contrasts, unit_sets
from eitskin_sim.fem.forward import Factor
from eitskin_sim.freeform.draws import set_pool
from eitskin_sim.freeform.mesh import shared_mesh
from eitskin_sim.freeform.parts import geometry
from eitskin_sim.freeform.sheet import inverted_sheet, sheet_blocks
from eitskin_sim.freeform.voltages import pool_responses
from eitskin_sim.measurement.front_end import to_voltages
from eitskin_sim.scene.family import draw, paper_bends
from eitskin_sim.unit_grid.patterns import paper_touch_sets
from eitskin_sim.unit_grid.skeleton import unit_system
from eitskin_sim.unit_grid.units import UnitGenerator
from eitskin_tools.bench.harness import Row, report, say
from eitskin_tools.errors import UsageError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--bends", type=int, default=10, metavar="N", help="bends of the paper's set (default 10)")
    parser.add_argument(
        "--touch-sets", type=int, default=10_259, metavar="N", help="of the paper's, from the first (default 10259)"
    )
    parser.add_argument(
        "--free", type=int, default=5_000, metavar="N", help="free touch sets at a deformation (default 5000)"
    )
    parser.add_argument("--checked", type=int, default=24, metavar="N", help="samples solved naively (default 24)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Measure and report."""
    for name in ("bends", "touch_sets", "free", "checked"):
        if getattr(arguments, name) < 1:
            raise UsageError(f"--{name.replace('_', '-')} must be at least 1")
    rows = [*_paper(arguments), *_free(arguments)]
    rows += [row for kind in ("press", "raise", "both") for row in (*_units(arguments, kind), *_free(arguments, kind))]
    rows += [_files(arguments, devices) for devices in ("ideal", "random")]
    naive = {row["what"]: row["samples_per_cpu_s"] for row in rows if row["method"] == "naive"}
    ours = {row["what"]: row for row in rows if row["method"] == "ours"}
    slowest = min(ours.values(), key=lambda row: float(row["samples_per_cpu_s"]))
    summary = {
        "paper_samples": ours["paper"]["samples"],
        "paper_seconds": ours["paper"]["seconds"],
        "paper_cpu_s": ours["paper"]["cpu_s"],
        "paper_times_naive": round(ours["paper"]["samples_per_cpu_s"] / naive["paper"], 1),
        "paper_largest_error": ours["paper"]["largest_error"],
        "free_samples_per_s": ours["free"]["samples_per_s"],
        "free_samples_per_cpu_s": ours["free"]["samples_per_cpu_s"],
        "free_times_naive": round(ours["free"]["samples_per_cpu_s"] / naive["free"], 1),
        "free_largest_error": ours["free"]["largest_error"],
        "slowest": slowest["what"],
        "slowest_samples_per_cpu_s": slowest["samples_per_cpu_s"],
    }
    return report(arguments, rows, summary)


def _row(what: str, method: str, samples: int, times: tuple[float, float], note: str) -> Row:
    seconds, cpu_s = times
    return {
        "what": what,
        "method": method,
        "samples": samples,
        "seconds": round(seconds, 3),
        "cpu_s": round(cpu_s, 3),
        "samples_per_s": round(samples / seconds, 2) if seconds else None,
        "samples_per_cpu_s": round(samples / cpu_s, 2) if cpu_s else None,
        "largest_error": None,
        "note": note,
    }


def _timed(work: Callable[[], Any]) -> tuple[Any, tuple[float, float]]:
    """Return what the work returns, and its seconds by the wall's clock and by the processor's."""
    start, cpu_start = perf_counter(), process_time()
    found = work()
    return found, (perf_counter() - start, process_time() - cpu_start)


def _beside_naive(ours: Row, voltages: Array, checked: int, solve: Callable[[int], Array], note: str) -> list[Row]:
    """Return a generator's row with its largest error, and the row of one factorisation a sample.

    Args:
        ours: The generator's row.
        voltages: (samples, 104) V that it made.
        checked: How many of them are solved again.
        solve: Solves a sample by its number.
        note: Of the naive row.
    """
    pick = np.unique(np.linspace(0, len(voltages) - 1, checked).astype(int))
    solved, seconds = _timed(lambda: np.array([solve(int(number)) for number in pick]))
    ours["largest_error"] = float(np.abs(voltages[pick] / solved - 1.0).max())
    return [ours, _row(ours["what"], "naive", len(pick), seconds, note)]


def _paper(arguments: argparse.Namespace) -> list[Row]:
    sets = paper_touch_sets(0)[: arguments.touch_sets]
    say("dataset", f"{len(sets)} touch sets at {arguments.bends} bends")
    bends = paper_bends(arguments.bends)
    last, seconds = _timed(lambda: [UnitGenerator(bend).voltages(sets) for bend in bends][-1])
    ours = _row("paper", "ours", len(sets) * len(bends), seconds, "set-up of every bend included")
    parts, system = unit_system(bends[-1])

    def solve(number: int) -> Array:
        return system.factorise(np.where(sets[number][parts.unit_of_element], 50.0, 1.0)).voltages()

    note = f"one factorisation a sample, {parts.mesh.n_nodes} nodes"
    return _beside_naive(ours, last, arguments.checked, solve, note)


def _units(arguments: argparse.Namespace, kind: str) -> list[Row]:
    plan = make_plan("units", deformations=1, kept=0, touch_sets=max(arguments.touch_sets, 10), touches=kind)
    bend, sets = plan.bends[0], unit_sets(plan)
    contrast = unit_contrasts(plan).of(np.arange(len(sets)))
    found, seconds = _timed(lambda: UnitGenerator(bend).voltages(sets, contrast))
    ours = _row(f"units, {kind}", "ours", len(sets), seconds, "set-up of the bend included; each touch of its contrast")
    parts, system = unit_system(bend)

    def solve(number: int) -> Array:
        sigma = np.where(sets[number], contrast[number], 1.0)
        return system.factorise(sigma[parts.unit_of_element]).voltages()

    return _beside_naive(ours, found, arguments.checked, solve, "one factorisation a sample")


def _free(arguments: argparse.Namespace, kind: Any = "hard") -> list[Row]:
    say("dataset", f"{arguments.free} free touch sets at each of {DEFORMATIONS_PER_POOL} deformations")
    bends, grid = draw("A", DEFORMATIONS_PER_POOL, 0), shared_mesh()
    what = "free" if kind == "hard" else f"free, {kind}"

    def ours() -> Any:
        count = (arguments.free, round(VALIDATION_SHARE * arguments.free))
        pool = set_pool(dict.fromkeys(range(DEFORMATIONS_PER_POOL), count), 0, touches=kind)
        batches = geometry(pool.parts, grid)
        made, used = [], None
        for number, bend in enumerate(bends):
            sheet = inverted_sheet(bend, into=used)
            made.append(to_voltages(pool_responses(sheet, grid, pool, batches, number)))
            used = sheet.inverse
        return pool.touches(pool.sets[DEFORMATIONS_PER_POOL - 1]), made

    (touches, made), seconds = _timed(ours)
    note = "drawing, geometry and set-up included; every sample a set of its own"
    row = _row(what, "ours", DEFORMATIONS_PER_POOL * arguments.free, seconds, note)
    sheet = inverted_sheet(bends[-1])

    def solve(number: int) -> Array:
        return Factor(sheet.system, *sheet_blocks(sheet, touches, number)).voltages()

    note = f"one factorisation a sample, {sheet.system.mesh.n_nodes} nodes"
    return _beside_naive(row, made[-1], arguments.checked, solve, note)


def _files(arguments: argparse.Namespace, devices: str) -> Row:
    plan = make_plan(
        "free",
        deformations=DEFORMATIONS_PER_POOL,
        kept=0,
        per_deformation=arguments.free,
        touches="press",
        devices=devices,
    )
    reference()
    _, seconds = _timed(lambda: make_shard(shard_job(plan, list(range(DEFORMATIONS_PER_POOL)))))
    note = "whole files: untouched sheets, references and clouds included"
    return _row(f"free, press, {devices} device", "ours", DEFORMATIONS_PER_POOL * arguments.free, seconds, note)
