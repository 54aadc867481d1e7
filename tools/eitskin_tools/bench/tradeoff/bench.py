"""``eitskin bench tradeoff``: run time against error for every solver and variant, as a table and a picture.

Error is 1 - CC: the mean over the phantoms of each file and the noise draws, on the data of ``eitskin evaluate``, or
over the touches of each trial on devices unlike the nominal one (``--devices``), of which no solver is told. Run time
is one call a 5 ms period, the variants taking turns on one thread, as a robot sees it; classical solvers have their
operators of the sheet ready, as the network has its geometry. What no variant that gives a whole map beats in both is
on the Pareto front (``pareto``). What gives a part of a map beats nobody (``whole`` is false): its error is of another
image.

::

    tikhonov, l1 of N steps, sbl    with V_pred as reference, which a robot can have; on the grid of the labels
    tikhonov, one matrix            the runtime's fall-back: flat sheet, reference before the deformation
    vd2t, vd2t-int8                 of the shipped bundles, and of every --bundle (other widths)
    vd2t, geometry a frame          without the skip "cloud unchanged"
    verified                        the network's map checked by physics, the search included, its set-up not
    gate alone                      an untouched frame, or nobody subscribed; its error is the touches it misses
"""

import argparse
import json
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from eitskin_tools.bench.tradeoff.front import flat_rows, mark_front, markdown, summary
from eitskin_tools.command_line import files
from eitskin_tools.errors import UsageError
from eitskin_tools.processes.threads import one_blas_thread

if TYPE_CHECKING:
    from eitskin_tools.bench.tradeoff.seen import Panel

PERIOD_S: Final = 0.005
"""Between two calls."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "--phantoms", action="append", default=[], metavar="FILE", help="a file, paper_units or paper_mm; repeatable"
    )
    parser.add_argument(
        "--devices", metavar="NAME", help="trials on devices unlike the nominal one: lab, random, single, drift or FILE"
    )
    parser.add_argument("--trials", default="single,press04", metavar="A,B", help="which (default: single,press04)")
    parser.add_argument("--draws", type=int, default=2, metavar="N", help="devices of each mismatch (default: 2)")
    parser.add_argument("--deformations", type=int, default=4, metavar="N", help="of drawn trials (default: 4)")
    parser.add_argument("--each", type=int, default=2, metavar="N", help="touches at each of them (default: 2)")
    parser.add_argument(
        "--bundle", type=files.bundle, action="append", default=[], metavar="FILE", help="another network; repeatable"
    )
    parser.add_argument("--noise", choices=["N1", "N2", "N3", "none"], default="N2", help="default: N2")
    parser.add_argument("--seeds", type=int, default=1, metavar="K", help="noise draws of phantoms (default 1)")
    parser.add_argument("--calls", type=int, default=60, metavar="N", help="timed calls of each variant (default 60)")
    parser.add_argument("--plot", type=Path, metavar="FILE.png", help="draw the picture")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Measure and report."""
    one_blas_thread()
    from eitskin_tools.bench.frame.bench import machine

    if not arguments.phantoms and arguments.devices is None:
        raise UsageError(
            "--phantoms FILE is missing: the error is measured on phantoms, such as the paper's eight, or on --devices"
        )
    if arguments.calls < 10:
        raise UsageError("--calls must be at least 10")
    if min(arguments.seeds, arguments.draws, arguments.deformations, arguments.each) < 1:
        raise UsageError("--seeds, --draws, --deformations and --each must be at least 1")
    if arguments.plot is not None:
        files.picture(arguments.plot)
    found: dict[str, list[dict[str, Any]]] = {}
    for panel in _panels(arguments):
        print(f"eitskin bench tradeoff: {panel.name}, {len(panel.cases)} maps", file=sys.stderr)
        found[panel.name] = measure(panel, arguments.bundle, arguments.noise, arguments.calls)
    if arguments.plot is not None:
        from eitskin_tools.bench.tradeoff.picture import plot

        plot(found, arguments.plot)
    if arguments.json:
        told = {"rows": flat_rows(found), "summary": summary(found), "files": found}
        print(json.dumps({"noise": arguments.noise, "seeds": arguments.seeds, **told, "machine": machine()}))
    else:
        for name, rows in found.items():
            print(f"\n{name}\n")
            print(markdown(rows))
    return 0


def _panels(arguments: argparse.Namespace) -> "Iterator[Panel]":
    from eitskin_sim.evaluation.device_runs import Plan
    from eitskin_tools.bench.tradeoff.seen import of_devices, of_phantoms

    for path in arguments.phantoms:
        yield from of_phantoms(path, arguments.noise, arguments.seeds)
    if arguments.devices is not None:
        plan = Plan(arguments.draws, noise=arguments.noise)
        kinds = arguments.trials.split(",")
        yield from of_devices(arguments.devices, kinds, arguments.deformations, arguments.each, plan)


def measure(panel: "Panel", bundles: Sequence[Path], noise: Any, calls: int) -> list[dict[str, Any]]:
    """Return a row for each variant: error, paced percentiles and whether it is on the front.

    Args:
        panel: The cases.
        bundles: More networks.
        noise: Definition of the noise.
        calls: Timed calls of each variant.
    """
    import numpy as np

    from eitskin_sim.evaluation.harness import Conditions
    from eitskin_tools.bench.tradeoff.variants import variants, whole_error
    from eitskin_tools.demo.score import percentiles_us

    ways = variants(panel.labels, panel.touches, bundles, Conditions(noise=noise))
    errors = {
        way.name: float(np.mean([way.error(case, truth, way.solve(case)) for case, truth in panel.cases]))
        for way in ways
    }
    spans: dict[str, list[int]] = {way.name: [] for way in ways}
    case = panel.cases[-1][0]
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
        row["whole"] = way.error is whole_error
    mark_front(rows)
    return rows
