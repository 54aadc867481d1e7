"""Unordered points to a cloud, a cloud to V_pred and operators, and what solvers then take.

One core: BLAS is held to one thread. ``median_ms`` is wall time, ``cpu_ms`` the process's own, which is the one that
counts on a machine that does other work too; ``cpu_least_ms``, the least of all, is what others' use of the caches
disturbed least. The points have no order, an arbitrary pose, 0.1 mm noise and 1 % outliers;
``off_mm`` is the cloud's rms distance from the true surface, taken from 2 million points on it.
"""

import argparse
import json
import sys
from collections.abc import Callable
from statistics import median
from time import perf_counter, process_time
from typing import Any

from eitskin_tools.bench.harness import program, row_text
from eitskin_tools.errors import UsageError
from eitskin_tools.processes.threads import one_blas_thread


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--points", type=int, default=100_000, metavar="N", help="points (default 100000)")
    parser.add_argument("--repeats", type=int, default=7, metavar="N", help="how often each is timed (default 7)")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Measure and report."""
    if arguments.points < 1_500 or arguments.repeats < 1:
        raise UsageError("--points must be at least 1500 and --repeats at least 1")
    one_blas_thread()
    rows = [*_cloud_rows(arguments.points, arguments.repeats), *_solver_rows(arguments.repeats)]
    summary = {row["what"]: row["cpu_ms"] for row in rows}
    if arguments.json:
        print(json.dumps({"rows": rows, "summary": summary}))
    else:
        for row in rows:
            print(row_text(row))
    return 0


def _timed(what: str, repeats: int, action: Callable[[], object], **extra: Any) -> dict[str, Any]:
    action()
    wall, cpu = [], []
    for _ in range(repeats):
        start, start_cpu = perf_counter(), process_time()
        action()
        wall.append(1e3 * (perf_counter() - start))
        cpu.append(1e3 * (process_time() - start_cpu))
    times = {"median_ms": median(wall), "cpu_ms": median(cpu), "cpu_least_ms": min(cpu)}
    return {"what": what, **{name: round(value, 1) for name, value in times.items()}, **extra}


def _cloud_rows(count: int, repeats: int) -> list[dict[str, Any]]:
    import numpy as np
    from scipy.spatial import cKDTree

    from eitskin_proto.skin.skin import PAPER
    from eitskin_sim.scene.bend import surface
    from eitskin_sim.scene.nominal import nominal_sheet
    from eitskin_sim.scene.parts import Bend
    from eitskin_sim.surface.ordered_cloud import organise

    rows, sheet = [], nominal_sheet(PAPER)
    for name, bend in (
        ("cylinder 90 degrees", Bend(angle_deg=90)),
        ("180 degrees, slanted, skewed, stretched", Bend(angle_deg=180, axis_deg=25, skew=0.4, stretch_along=1.1)),
    ):
        rng = np.random.default_rng(0)
        points = surface(bend, sheet, rng.uniform((0.0, 0.0), sheet.size_mm, (count, 2)))
        points += 0.1 * rng.standard_normal(points.shape)
        stray = rng.choice(count, count // 100, replace=False)
        points[stray] = rng.uniform(points.min(axis=0) - 20, points.max(axis=0) + 20, (len(stray), 3))
        turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
        turn *= np.sign(np.linalg.det(turn))
        seen = points @ turn.T + 100.0
        found = organise(seen)
        x, y = np.meshgrid(*(np.arange(0.0, extent + 0.05, 0.1) for extent in sheet.size_mm))
        dense = surface(bend, sheet, np.stack([x.ravel(), y.ravel()], -1)) @ turn.T + 100.0
        there = (found.cloud_mm.reshape(3, -1).T - found.translation_mm) @ found.rotation
        # The nearest of points 0.1 mm apart lies up to 0.05 mm beside the foot: 0.04 rms, taken out in squares.
        gap = cKDTree(dense).query(there)[0]
        off = float(max(float(np.mean(gap**2)) - 0.1**2 / 6, 0.0) ** 0.5)
        extra = {"points": count, "bend": name, "off_mm": round(off, 4), "outliers": found.outliers}
        rows.append(_timed(f"scan, {name}", repeats, lambda seen=seen: organise(seen), **extra))  # type: ignore[misc]
    return rows


def _solver_rows(repeats: int) -> list[dict[str, Any]]:
    import numpy as np

    from eitskin_sim.scene.scene import Bend
    from eitskin_sim.solvers.l1 import l1_image
    from eitskin_sim.solvers.operators import SATURATED, Cells, operators_of_cloud
    from eitskin_sim.solvers.sbl import sbl_image
    from eitskin_sim.solvers.tikhonov import tikhonov_matrix
    from eitskin_sim.surface.measured_cloud import measured_cloud
    from eitskin_sim.surface.predict import predict

    rng = np.random.default_rng(0)
    cloud = measured_cloud(Bend(angle_deg=120, stretch_along=1.1), rng)
    rows = [_timed("predicted reference", repeats, lambda: predict(cloud))]
    grids: tuple[Cells, ...] = ("pixels", "units")
    for cells in grids:
        operators = operators_of_cloud(cloud, cells)
        operator, shape = operators.relative_jacobian, operators.shape
        data = operator[:, ::97].sum(axis=1)
        matrix = tikhonov_matrix(operator)
        actions: dict[str, Callable[[], object]] = {
            "operators": lambda cells=cells: operators_of_cloud(cloud, cells),  # type: ignore[misc]
            "Tikhonov matrix": lambda operator=operator: tikhonov_matrix(operator),  # type: ignore[misc]
            "Tikhonov image": lambda matrix=matrix, data=data: matrix @ data,  # type: ignore[misc]
            "l1 image": lambda operator=operator, data=data: l1_image(operator, data, upper=SATURATED),  # type: ignore[misc]
            "SBL image": lambda operator=operator, data=data, shape=shape: sbl_image(  # type: ignore[misc]
                operator, data, shape, upper=SATURATED
            ),
        }
        rows += [_timed(f"{name}, {cells}", repeats, action) for name, action in actions.items()]
    return rows


if __name__ == "__main__":
    sys.exit(program(__doc__, add_arguments, run))
