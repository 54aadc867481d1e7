"""``eitskin bench tradeoff``: run time against error for every solver and variant, as rows and a picture.

The error is 1 - CC, the mean over the phantoms of each file and the noise draws. The run time is that of one call every
5 ms, the variants taking turns on one thread, as on a robot. Classical solvers have their operators of the sheet ready,
as the network has its geometry, and V_pred as reference, which a robot can have. A variant is on the Pareto front
(``pareto``) if no other one beats it in both.

::

    tikhonov, l1 of N steps, sbl    with V_pred as reference, on the grid of the labels
    vd2t, vd2t-int8                 of the shipped bundles, and of every --bundle (other widths)
    verified                        the network's map checked by physics, with the search, without its set-up
"""

import argparse
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt

from eitskin.model.bundle import load_bundle
from eitskin.model.engine import solvers as solvers_of
from eitskin_proto.skin.touch_kind import TouchKind
from eitskin_sim.evaluation.harness import (
    Case,
    Conditions,
    Run,
    Solver,
    evaluate_all,
    solve_l1,
    solve_sbl,
    solve_tikhonov,
)
from eitskin_sim.evaluation.metrics import correlation
from eitskin_sim.evaluation.truth import truth_map
from eitskin_sim.measurement.noise import Kind
from eitskin_sim.scene.parts import Phantom
from eitskin_sim.scene.scene import load_phantoms
from eitskin_tools.bench.harness import Row, machine, paced, report, say
from eitskin_tools.command_line import files
from eitskin_tools.demo.score import percentiles_us
from eitskin_tools.errors import UsageError
from eitskin_tools.evaluation.solvers import NETWORKS, VERIFIED, Request, bundle_for, named
from eitskin_tools.pictures import save

L1_STEPS: Final = (10, 50, 200, 400)
"""Iterations of FISTA that are compared; the last is the solver's own."""

SMALLEST_ERROR: Final = 1e-4
"""Where the picture's axis ends."""

MAX_PANEL_COLUMNS: Final = 2
"""Panels of the picture side by side; more stand below each other."""

OFFSET: Final = "offset points"


@dataclass(frozen=True, slots=True)
class Panel:
    """Cases of one kind, which are averaged over.

    Args:
        name: What the table and the picture call it.
        labels: What the truth's pixels mean.
        touches: Which way they change conductance.
        cases: What may be seen, and the true map (rows, columns).
    """

    name: str
    labels: Literal["units", "area"]
    touches: TouchKind
    cases: list[tuple[Case, npt.NDArray[np.float64]]]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "--phantoms", action="append", required=True, metavar="FILE", help="a file, paper_units or paper_mm; repeatable"
    )
    parser.add_argument(
        "--bundle", type=files.bundle, action="append", default=[], metavar="FILE", help="another network; repeatable"
    )
    parser.add_argument("--noise", choices=["N1", "N2", "N3", "none"], default="N2", help="default: N2")
    parser.add_argument("--seeds", type=int, default=1, metavar="K", help="noise draws (default 1)")
    parser.add_argument("--calls", type=int, default=60, metavar="N", help="timed calls of each variant (default 60)")
    parser.add_argument("--plot", type=Path, metavar="FILE.png", help="draw the picture")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Measure and report."""
    if arguments.calls < 10:
        raise UsageError("--calls must be at least 10")
    if arguments.seeds < 1:
        raise UsageError("--seeds must be at least 1")
    if arguments.plot is not None:
        files.picture(arguments.plot)
    found: dict[str, list[Row]] = {}
    for panel in (one for path in arguments.phantoms for one in of_phantoms(path, arguments.noise, arguments.seeds)):
        say("tradeoff", f"{panel.name}, {len(panel.cases)} maps")
        found[panel.name] = measure(panel, arguments.bundle, arguments.noise, arguments.calls)
    if arguments.plot is not None:
        plot(found, arguments.plot)
    more = {"noise": arguments.noise, "seeds": arguments.seeds, "machine": machine()}
    return report(arguments, flat_rows(found), summary(found), **more)


def measure(panel: Panel, bundles: Sequence[Path], noise: Any, calls: int) -> list[Row]:
    """Return a row for each variant: error, paced percentiles and whether it is on the front.

    Args:
        panel: The cases.
        bundles: More networks.
        noise: Definition of the noise.
        calls: Timed calls of each variant.
    """
    ways = variants(panel.labels, panel.touches, bundles, Conditions(noise=noise))
    errors = {
        name: float(np.mean([1.0 - correlation(solve(case), truth) for case, truth in panel.cases]))
        for name, solve in ways.items()
    }
    case = panel.cases[-1][0]
    spans = paced({name: partial(solve, case) for name, solve in ways.items()}, calls)
    rows: list[Row] = [
        {"variant": name, "error": round(errors[name], 5), **percentiles_us(spans[name])} for name in ways
    ]
    mark_front(rows)
    return rows


def of_phantoms(path: str, noise: Kind, seeds: int) -> Iterator[Panel]:
    """Yield a panel for each kind of labels and touches in a file of phantoms; those that nothing touches have no CC.

    Raises:
        ValueError: Nothing is touched in any of them.
    """
    phantoms = [one for one in load_phantoms(files.find(path, files.PHANTOMS)) if one.scene.touches]
    if not phantoms:
        raise ValueError(f"{path} holds no phantom that anything touches; expected at least one: the error is 1 - CC")
    kinds = dict.fromkeys((one.truth, one.scene.touch_kind) for one in phantoms)
    for labels, touches in kinds:
        group = [one for one in phantoms if (one.truth, one.scene.touch_kind) == (labels, touches)]
        lower = ", touches lower" if touches == "lower" else ""
        yield Panel(f"{Path(path).stem}, {labels} labels{lower}", labels, touches, _ideal(group, noise, seeds))


def _ideal(phantoms: Sequence[Phantom], noise: Kind, seeds: int) -> list[tuple[Case, npt.NDArray[np.float64]]]:
    seen: list[Case] = []

    def keep(case: Case) -> npt.NDArray[np.float64]:
        seen.append(case)
        return np.zeros_like(truth_map(phantoms[0]))

    evaluate_all(phantoms, [Run(keep, "predicted")], Conditions(noise=noise, seeds=seeds))
    truths = [truth_map(phantom) for phantom in phantoms for _ in range(seeds)]
    return list(zip(seen, truths, strict=True))


def variants(labels: str, touches: TouchKind, more: Sequence[Path], conditions: Conditions) -> dict[str, Solver]:
    """Return all ways to maps of some labels.

    Args:
        labels: ``"units"`` or ``"area"``.
        touches: Which way they change conductance.
        more: Networks beside the shipped one; those of other labels are left out.
        conditions: With the noise that the verifier assumes.
    """
    found: dict[str, Solver] = {"tikhonov": solve_tikhonov, "sbl": solve_sbl}
    found |= {f"l1, {steps} steps": partial(solve_l1, iterations=steps) for steps in L1_STEPS}
    shipped = bundle_for(Request("vd2t"), labels, touches).path
    for path in [shipped, *map(Path, more)]:
        bundle = load_bundle(path, lazily=True)
        suffix = "" if path == shipped else f" of {path.name}"
        for name in [one for one in NETWORKS if one in solvers_of(bundle) and bundle.labels == labels]:
            found[name + suffix] = named(Request(name, bundle=path), labels, touches=touches).run.solver
    verified = named(Request(VERIFIED), labels, touches=touches, conditions=conditions)
    return {**found, VERIFIED: verified.run.solver}


def mark_front(rows: Sequence[Row]) -> None:
    """Say of each row in ``pareto`` whether no other row is as good as it in both error and time."""
    for row in rows:
        row["pareto"] = not any(
            other["error"] <= row["error"] and other["p50"] <= row["p50"] and other is not row for other in rows
        )


def flat_rows(panels: Mapping[str, Sequence[Row]]) -> list[Row]:
    """Return the rows of all panels in one list, each with its panel's name."""
    return [{"panel": name, **row} for name, rows in panels.items() for row in rows]


def summary(panels: Mapping[str, Sequence[Row]]) -> Row:
    """Return, by panel, what gives the most accurate map, and what is on the front."""
    return {
        name: {
            "most_accurate": min(rows, key=lambda row: row["error"])["variant"],
            "on_front": [row["variant"] for row in rows if row["pareto"]],
        }
        for name, rows in panels.items()
    }


def plot(found: Mapping[str, Sequence[Row]], path: Path) -> None:
    """Draw error against run time, a panel for each list of rows: red is what no variant beats in both, grey the rest.

    Args:
        found: Rows of ``measure`` by the name of their panel.
        path: The PNG file.

    Raises:
        OSError: The file cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    columns = min(len(found), MAX_PANEL_COLUMNS)
    lines = -(-len(found) // columns)
    figure = Figure(figsize=(7.0 * columns, 5.2 * lines), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(lines, columns, squeeze=False).ravel()
    for empty in panels[len(found) :]:
        empty.set_axis_off()
    for axes, (name, rows) in zip(panels, found.items(), strict=False):
        shown = [(row["p50"], max(row["error"], SMALLEST_ERROR), row) for row in rows]
        front = sorted((x, y) for x, y, row in shown if row["pareto"])
        axes.plot(*zip(*front, strict=True), color="tab:red", zorder=1)
        for number, (x, y, row) in enumerate(sorted(shown, key=lambda point: point[:2])):
            axes.scatter([x], [y], color="tab:red" if row["pareto"] else "tab:grey", zorder=2)
            above = number % 2 == 0  # neighbours' names would lie over each other
            axes.annotate(row["variant"], (x, y), fontsize=7, xytext=(4, 4 if above else -10), textcoords=OFFSET)
        axes.set(xscale="log", yscale="log", xlabel="paced run time, us (p50)", ylabel="1 - CC", title=name)
        axes.grid(alpha=0.3)
    save(figure, path)
