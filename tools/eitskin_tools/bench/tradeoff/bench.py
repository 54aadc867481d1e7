"""``eitskin bench tradeoff``: run time against error for every solver and variant, as a table and a picture.

Error is 1 - CC, the mean over the phantoms of each file and the noise draws, on the data of ``eitskin evaluate``. Run
time is one call a 5 ms period, the variants taking turns on one thread, as a robot sees it; classical solvers have
their operators of the sheet ready, as the network has its geometry. What no variant that gives a whole map beats in
both is on the Pareto front (``pareto``). What gives a part of a map beats nobody (``whole`` is false): its error is of
another image.

::

    tikhonov, l1 of N steps, sbl    with V_pred as reference, which a robot can have; on the grid of the labels
    tikhonov, one matrix            the runtime's fall-back: flat sheet, reference before the deformation
    vd2t, vd2t-int8                 of the shipped bundles, and of every --bundle (other widths)
    vd2t, quarter of the sheet      what a subscriber to a region costs; its CC is of that quarter
    vd2t, geometry a frame          without the skip "cloud unchanged"
    gate alone                      an untouched frame, or nobody subscribed; its error is the touches it misses
"""

import argparse
import json
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from eitskin_tools.command_line import files
from eitskin_tools.errors import UsageError
from eitskin_tools.processes.threads import one_blas_thread

PERIOD_S: Final = 0.005
"""Between two calls."""

GATE: Final = "gate alone"
"""Judges and gives no map; its error is of another kind."""

L1_STEPS: Final = (10, 50, 200, 400)
"""Iterations of FISTA that are compared; the last is the solver's own."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "--phantoms", action="append", default=[], metavar="FILE", help="a file, paper_units or paper_mm; repeatable"
    )
    parser.add_argument("--bundle", action="append", default=[], metavar="FILE", help="another network; repeatable")
    parser.add_argument("--noise", choices=["N1", "N2", "N3", "none"], default="N2", help="default: N2")
    parser.add_argument("--seeds", type=int, default=1, metavar="K", help="noise draws (default 1)")
    parser.add_argument("--calls", type=int, default=60, metavar="N", help="timed calls of each variant (default 60)")
    parser.add_argument("--plot", type=Path, metavar="FILE.png", help="draw the picture")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Measure and report."""
    one_blas_thread()
    from eitskin_sim.scene.scene import load_phantoms
    from eitskin_tools.bench.frame.bench import machine

    if not arguments.phantoms:
        raise UsageError("--phantoms FILE is missing: the error is measured on phantoms, such as the paper's eight")
    if arguments.calls < 10 or arguments.seeds < 1:
        raise UsageError("--calls must be at least 10 and --seeds at least 1")
    if arguments.plot is not None:
        files.writable(arguments.plot)
    found: dict[str, list[dict[str, Any]]] = {}
    for path in arguments.phantoms:
        phantoms = load_phantoms(files.find(path, files.PHANTOMS))
        for labels in dict.fromkeys(one.truth for one in phantoms):
            group = [one for one in phantoms if one.truth == labels]
            print(f"eitskin bench tradeoff: {len(group)} phantoms of {path}", file=sys.stderr)
            rows = measure(group, arguments.bundle, arguments.noise, arguments.seeds, arguments.calls)
            found[f"{Path(path).stem}, {labels} labels"] = rows
    if arguments.plot is not None:
        from eitskin_tools.bench.tradeoff.picture import plot

        plot(found, arguments.plot)
    if arguments.json:
        print(json.dumps({"noise": arguments.noise, "seeds": arguments.seeds, "files": found, "machine": machine()}))
    else:
        for name, rows in found.items():
            print(f"\n{name}\n")
            print(markdown(rows))
    return 0


@dataclass(frozen=True, slots=True)
class Variant:
    """One way from a case to a map.

    Args:
        name: What the table calls it.
        solve: Gives the (30, 45) map of a case.
        error: Gives the error of a case, where it is not 1 - CC of the whole map.
    """

    name: str
    solve: Callable[[Any], Any]
    error: Callable[[Any, Any, Any], float]


def measure(
    phantoms: Sequence[Any], bundles: Sequence[str], noise: Any, seeds: int, calls: int
) -> list[dict[str, Any]]:
    """Return a row for each variant: error, paced percentiles and whether it is on the front.

    Args:
        phantoms: With labels of one kind.
        bundles: More networks.
        noise: Definition of the noise.
        seeds: Noise draws for each phantom.
        calls: Timed calls of each variant.
    """
    import numpy as np

    from eitskin_tools.demo.score import percentiles_us

    cases = _cases(phantoms, noise, seeds)
    ways = _variants(phantoms[0].truth, bundles)
    errors = {
        way.name: float(np.mean([way.error(case, truth, way.solve(case)) for case, truth in cases])) for way in ways
    }
    spans: dict[str, list[int]] = {way.name: [] for way in ways}
    case = cases[-1][0]
    due = time.perf_counter()
    for _ in range(calls):
        for way in ways:
            due = max(due + PERIOD_S, time.perf_counter())
            time.sleep(max(due - time.perf_counter(), 0.0))
            start = time.perf_counter_ns()
            way.solve(case)
            spans[way.name].append(time.perf_counter_ns() - start)
    rows: list[dict[str, Any]] = [
        {"variant": way.name, "error": round(errors[way.name], 5), **percentiles_us(np.array(spans[way.name]))}
        for way in ways
    ]
    for row, way in zip(rows, ways, strict=True):
        row["whole"] = way.error is _whole_error
    mark_front(rows)
    return rows


def mark_front(rows: Sequence[dict[str, Any]]) -> None:
    """Say of each row in ``pareto`` whether nothing that gives a whole map beats it in both."""
    for row in rows:
        row["pareto"] = not row["variant"].startswith(GATE) and not _beaten(row, rows)


def _beaten(row: dict[str, Any], rows: Sequence[dict[str, Any]]) -> bool:
    """Return whether another variant, one that gives a whole map, is as good in both and not the same."""
    return any(
        other["whole"] and other["error"] <= row["error"] and other["p50"] <= row["p50"] and other is not row
        for other in rows
    )


def _cases(phantoms: Sequence[Any], noise: Any, seeds: int) -> list[tuple[Any, Any]]:
    """Return what a solver may see, with V_pred as its reference, and the truth, of every phantom and draw."""
    import numpy as np

    from eitskin_proto.sensor.grid import GRID_SHAPE
    from eitskin_sim.evaluation.harness import Conditions, Run, evaluate_all, truth_map

    seen: list[Any] = []

    def keep(case: Any) -> Any:
        seen.append(case)
        return np.zeros(GRID_SHAPE)

    evaluate_all(phantoms, [Run(keep, "predicted")], Conditions(noise=noise, seeds=seeds))
    truths = [truth_map(phantom) for phantom in phantoms for _ in range(seeds)]
    return list(zip(seen, truths, strict=True))


def _whole_error(case: Any, truth: Any, image: Any) -> float:
    from eitskin_sim.evaluation.metrics import correlation

    return 1.0 - float(correlation(image, truth))


def _variants(labels: str, more: Sequence[str]) -> list[Variant]:
    from eitskin.model.bundle import default_path
    from eitskin_sim.evaluation.harness import solve_sbl, solve_tikhonov
    from eitskin_sim.evaluation.metrics import scaled
    from eitskin_sim.solvers.l1 import l1_image
    from eitskin_sim.solvers.operators import SATURATED, linear_data

    def l1(steps: int) -> Callable[[Any], Any]:
        def solve(case: Any) -> Any:
            operators = case.sheet.operators(labels if labels == "units" else "pixels")
            data = linear_data(case.voltages, case.reference)
            image = l1_image(operators.relative_jacobian, data, upper=SATURATED, iterations=steps)
            return scaled(operators.to_map(image))

        return solve

    found = [Variant("tikhonov", solve_tikhonov, _whole_error), Variant("sbl", solve_sbl, _whole_error)]
    found += [Variant(f"l1, {steps} steps", l1(steps), _whole_error) for steps in L1_STEPS]
    shipped = default_path(labels)
    for path in [shipped, *map(Path, more)]:
        found += _networks(path, labels, "" if path == shipped else f" of {path.name}")
    return found


def _networks(path: Path, labels: str, suffix: str) -> list[Variant]:
    """Return the variants that a bundle offers; none where its labels are not these."""
    import numpy as np

    from eitskin.model.buffers import Buffers
    from eitskin.model.bundle import load_bundle
    from eitskin.model.engine import engines
    from eitskin.model.gate import Gate
    from eitskin.model.geometry import GeometryGraph
    from eitskin.reference.predicted import log_ratio
    from eitskin_proto.sensor.grid import GRID_SHAPE, N_PIXELS
    from eitskin_proto.sensor.normalise import relative_change
    from eitskin_sim.evaluation.metrics import correlation
    from eitskin_sim.surface.predict import flat_voltages

    bundle = load_bundle(path)
    if bundle.labels != labels:
        return []
    buffers, graph = Buffers(bundle), GeometryGraph(bundle)
    shown: list[Any] = [None]

    def geometry(case: Any) -> None:
        predicted = log_ratio(case.sheet.predicted(), flat_voltages()) if bundle.uses_prediction else None
        buffers.take(graph.geometry(case.sheet.cloud_mm, predicted, buffers.revision + 1))
        shown[0] = case.sheet

    def solver(engine: Any, *, every: bool = False) -> Callable[[Any], Any]:
        def solve(case: Any) -> Any:
            if every or shown[0] is not case.sheet:
                geometry(case)
            buffers.change[0] = relative_change(case.voltages, case.flat_reference)
            engine.infer()
            return np.asarray(buffers.map, dtype=np.float64).reshape(GRID_SHAPE)

        return solve

    whole = engines(bundle, buffers)
    found = [
        Variant(("tikhonov, one matrix" if one.name == "tikhonov" else one.name) + suffix, solver(one), _whole_error)
        for one in whole
    ]
    quarter = np.zeros(GRID_SHAPE, dtype=bool)
    quarter[: GRID_SHAPE[0] // 2, : GRID_SHAPE[1] // 2] = True
    part = engines(bundle, buffers, np.flatnonzero(quarter.reshape(N_PIXELS)), best=whole[0].name, alone=True)[0]

    def part_error(case: Any, truth: Any, image: Any) -> float:
        inside = truth[quarter]
        if inside.max() == inside.min():
            return float(np.abs(image[quarter] - inside).max())  # nothing to correlate with: the largest wrong pixel
        return 1.0 - float(correlation(image[quarter], inside))

    found.append(Variant(f"{whole[0].name}, quarter of the sheet{suffix}", solver(part), part_error))
    found.append(Variant(f"{whole[0].name}, geometry a frame{suffix}", solver(whole[0], every=True), _whole_error))
    arrays = bundle.gate_arrays()
    if arrays is not None:
        gate = Gate(arrays)

        def judge(case: Any) -> bool:
            gate.change[:] = relative_change(case.voltages, case.flat_reference).astype(np.float32)
            return gate.touched()

        found.append(Variant(f"{GATE}{suffix}", judge, lambda case, truth, touched: float(not touched)))
    return found


def markdown(rows: Sequence[dict[str, Any]]) -> str:
    """Return the table, the most accurate first."""
    lines = ["| variant | 1 - CC | p50, us | p99, us | on the front |", "|---|---|---|---|---|"]
    for row in sorted(rows, key=lambda row: row["error"]):
        front = ("yes" if row["whole"] else "yes, for its part") if row["pareto"] else ""
        lines.append(f"| {row['variant']} | {row['error']:.4f} | {row['p50']:.0f} | {row['p99']:.0f} | {front} |")
    return "\n".join(lines)
