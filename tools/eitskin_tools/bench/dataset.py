"""``eitskin bench dataset``: samples a second of the data generators, beside one solve a sample.

All rows come from one run on one core. The ratios use ``cpu_s``, which counts on a machine that does other work too. A
row's ``note`` names the set-up that its seconds include. "naive" factorises the same mesh for every sample, and its
voltages check ours.

Fewer free sets, at deformations of no data set, measure the error of the generators' mesh: |dV - dV_scene| / |dV_scene|
over the 104 rows, with dV the change of voltage from the untouched sheet and the scene solved on a mesh of 1.5 mm that
follows the touches' borders. A third of the scenes, solved on meshes of 1 mm, give the scenes' own error.
"""

import argparse
from collections.abc import Callable, Iterator
from time import perf_counter, process_time
from typing import Any, Final

import numpy as np

from eitskin_sim.dataset.plan import DEFORMATIONS_PER_POOL, VALIDATION_SHARE, make_plan
from eitskin_sim.dataset.shards import make_shard, reference, shard_job, unit_contrasts, unit_sets
from eitskin_sim.fem.forward import Factor
from eitskin_sim.fem.solve import solve_scene
from eitskin_sim.freeform.draws import set_pool
from eitskin_sim.freeform.mesh import ELEMENT_MM, shared_mesh
from eitskin_sim.freeform.parts import geometry
from eitskin_sim.freeform.sheet import inverted_sheet, sheet_blocks
from eitskin_sim.freeform.voltages import pool_voltages, set_voltages
from eitskin_sim.scene.family import draw, paper_bends
from eitskin_sim.scene.parts import Bend, Scene
from eitskin_sim.scene.touch_table import Array, TouchTable
from eitskin_sim.unit_grid.patterns import paper_touch_sets
from eitskin_sim.unit_grid.skeleton import unit_system
from eitskin_sim.unit_grid.units import UnitGenerator
from eitskin_tools.bench.harness import Row, report, say
from eitskin_tools.errors import UsageError

SCENE_MM: Final = 1.5
FINER_MM: Final = 1.0
DEFORMATIONS: Final = 3
SEED: Final = 77
"""Of deformations and sets; data sets have other seeds."""


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
    parser.add_argument(
        "--scenes",
        type=int,
        default=24,
        metavar="N",
        help="free sets solved on finer meshes too, 0 for none (default 24)",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Measure and report."""
    for name in ("bends", "touch_sets", "free", "checked"):
        if getattr(arguments, name) < 1:
            raise UsageError(f"--{name.replace('_', '-')} must be at least 1")
    if arguments.scenes < 0 or 0 < arguments.scenes < 3:
        raise UsageError(f"--scenes is {arguments.scenes}; it must be 0, or 3 or more")
    rows = [*_paper(arguments), *_free(arguments)]
    rows += [row for kind in ("press", "raise", "both") for row in (*_units(arguments, kind), *_free(arguments, kind))]
    rows += [_files(arguments, devices) for devices in ("ideal", "random")]
    errors = error_rows(arguments.scenes) if arguments.scenes else []
    naive = {row["what"]: row["samples_per_cpu_s"] for row in rows if row["method"] == "naive"}
    ours = {row["what"]: row for row in rows if row["method"] == "ours"}
    slowest = min(ours.values(), key=lambda row: float(row["samples_per_cpu_s"]))
    default = next((row for row in errors if row["what"] == "free, default"), {})
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
        "free_dV_off_percent": default.get("median_percent"),
    }
    return report(arguments, [*rows, *errors], summary)


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
            made.append(pool_voltages(sheet, grid, pool, batches, number))
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


def error_rows(count: int) -> list[Row]:
    """Return a row for the generators' mesh, and one for the scenes that it is compared with.

    Args:
        count: Touch sets in all, spread over three unseen deformations.
    """
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

    say("dataset", f"{count} sets solved as scenes of {SCENE_MM:g} mm")
    exact = scene_change(SCENE_MM)
    rows = [_off("scene", SCENE_MM, scene_change(SCENE_MM, 3), scene_change(FINER_MM, 3), 0.0)]
    start = process_time()
    sheets = [inverted_sheet(bend) for bend in bends]
    made = process_time() - start
    found = [
        set_voltages([sheet], table)[0] / sheet.untouched_V - 1.0 for sheet, table in zip(sheets, tables, strict=True)
    ]
    return [*rows, _off("free, default", ELEMENT_MM, np.concatenate(found), exact, made / len(bends))]


def _scenes(bend: Bend, table: TouchTable, size_mm: float) -> Iterator[tuple[Array, Array]]:
    """Yield the untouched voltages and the touched ones of every set."""
    bare = solve_scene(Scene(bend=bend, element_size_mm=size_mm)).voltages
    for number in range(len(table)):
        yield bare, solve_scene(Scene(bend=bend, touches=table.touches(number), element_size_mm=size_mm)).voltages


def _off(what: str, size_mm: float, found: Any, exact: Any, sheet_s: float) -> Row:
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
