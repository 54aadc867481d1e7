"""The ways from a case to a map that are compared: classical solvers, what a bundle offers, and the verified one."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from eitskin.model.buffers import Buffers
from eitskin.model.bundle import load_bundle
from eitskin.model.engine import engines
from eitskin.model.gate import Gate
from eitskin.model.geometry import GeometryGraph
from eitskin.reference.predicted import log_ratio
from eitskin_proto.sensor.normalise import relative_change
from eitskin_proto.skin.touch_kind import TouchKind
from eitskin_sim.evaluation.harness import Case, Conditions, solve_l1, solve_sbl, solve_tikhonov
from eitskin_sim.evaluation.metrics import correlation
from eitskin_sim.surface.predict import flat_voltages
from eitskin_tools.bench.tradeoff.front import GATE
from eitskin_tools.evaluation.solvers import VERIFIED, Request, bundle_for, named

L1_STEPS: Final = (10, 50, 200, 400)
"""Iterations of FISTA that are compared; the last is the solver's own."""


@dataclass(frozen=True, slots=True)
class Variant:
    """One way from a case to a map.

    Args:
        name: What the table calls it.
        solve: Gives the (rows, columns) map of a case.
        error: Gives the error of a case, where it is not 1 - CC of the whole map.
    """

    name: str
    solve: Callable[[Case], Any]
    error: Callable[[Case, Any, Any], float]


def whole_error(case: Case, truth: Any, image: Any) -> float:
    """Return 1 - CC of a map (rows, columns)."""
    return 1.0 - float(correlation(image, truth))


def variants(labels: str, touches: TouchKind, more: Sequence[Path], conditions: Conditions) -> list[Variant]:
    """Return all ways to maps of some labels.

    Args:
        labels: ``"units"`` or ``"area"``.
        touches: Which way they change conductance.
        more: Networks beside the shipped one; those of other labels are left out.
        conditions: Whose noise the verifier is told.
    """
    found = [Variant("tikhonov", solve_tikhonov, whole_error), Variant("sbl", solve_sbl, whole_error)]
    found += [Variant(f"l1, {steps} steps", partial(solve_l1, iterations=steps), whole_error) for steps in L1_STEPS]
    shipped = bundle_for(Request("vd2t"), labels, touches).path
    for path in [shipped, *map(Path, more)]:
        found += _networks(path, labels, "" if path == shipped else f" of {path.name}")
    verified = named(Request(VERIFIED), labels, touches=touches, conditions=conditions)
    return [*found, Variant(VERIFIED, verified.run.solver, whole_error)]


def _networks(path: Path, labels: str, suffix: str) -> list[Variant]:
    """Return the variants that a bundle offers; none where its labels are not these."""
    bundle = load_bundle(path)
    if bundle.labels != labels:
        return []
    buffers, graph = Buffers(bundle), GeometryGraph(bundle)
    shown: list[Any] = [None]

    def geometry(case: Case) -> None:
        predicted = log_ratio(case.sheet.predicted(), flat_voltages(bundle.skin)) if bundle.uses_prediction else None
        buffers.take(graph.geometry(case.sheet.cloud_mm, predicted, buffers.revision + 1))
        shown[0] = case.sheet

    def solver(engine: Any, *, every: bool = False) -> Callable[[Case], Any]:
        def solve(case: Case) -> Any:
            if every or shown[0] is not case.sheet:
                geometry(case)
            buffers.change[0] = relative_change(case.voltages, case.flat_reference)
            engine.infer()
            return np.asarray(buffers.map, dtype=np.float64).reshape(bundle.skin.grid.shape)

        return solve

    whole = engines(bundle, buffers)
    found = [
        Variant(("tikhonov, one matrix" if one.name == "tikhonov" else one.name) + suffix, solver(one), whole_error)
        for one in whole
    ]
    found.append(Variant(f"{whole[0].name}, geometry a frame{suffix}", solver(whole[0], every=True), whole_error))
    arrays = bundle.gate_arrays()
    if arrays is not None:
        gate = Gate(arrays)

        def judge(case: Case) -> bool:
            gate.change[:] = relative_change(case.voltages, case.flat_reference).astype(np.float32)
            return gate.touched()

        found.append(Variant(f"{GATE}{suffix}", judge, lambda case, truth, touched: float(not touched)))
    return found
