"""What accuracy is left without one, two or three electrodes, for every solver, and what going on without them costs.

Every solver sees the same noisy voltages. A network gets the missing rows as zeros, as a runtime without any care
would give them, or filled in from the others (:mod:`eitskin.health.imputation`), those weighed by the noise of the
reference as the runtime does it (:mod:`eitskin.reference.row_noise`); a classical solver loses them from its operators
(:mod:`eitskin_sim.solvers.downdate`).
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import combinations
from time import process_time
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin.health.electrodes import ElectrodeWatch
from eitskin.health.imputation import Consistency, Imputation
from eitskin.model.bundle import Bundle
from eitskin.reference.predicted import log_ratio
from eitskin_proto.sensor.normalise import relative_change
from eitskin_proto.sensor.row_gaussian import rows_of
from eitskin_proto.sensor.table import N_ELECTRODES
from eitskin_sim.evaluation.harness import Case, Conditions, Run, Solver, evaluate_all
from eitskin_sim.evaluation.metrics import scaled
from eitskin_sim.measurement.noise import Kind
from eitskin_sim.scene.parts import Phantom
from eitskin_sim.solvers.downdate import Precomputed, precompute
from eitskin_sim.solvers.l1 import l1_image
from eitskin_sim.solvers.operators import SATURATED, Operators, linear_data, log_data
from eitskin_sim.solvers.sbl import sbl_image
from eitskin_sim.solvers.tikhonov import tikhonov_matrix
from eitskin_sim.surface.predict import flat_voltages
from eitskin_tools.evaluation.solvers import Request, named

SETS: Final = 12
"""Sets of two, and of three, electrodes that are tried, drawn once; of one, all 16."""

Array = npt.NDArray[np.float64]

Lost = tuple[int, ...]


def lost_sets(count: int, most: int = SETS) -> list[Lost]:
    """Return sets of so many electrodes: none, all 16 single ones, else ``most`` drawn ones."""
    every = list(combinations(range(N_ELECTRODES), count))
    if count <= 1:
        return every
    rng = np.random.default_rng(count)
    return [every[index] for index in sorted(rng.choice(len(every), min(most, len(every)), replace=False))]


def accuracy(
    phantoms: Sequence[Phantom],
    bundle: Bundle,
    consistency: Consistency,
    conditions: Conditions,
    *,
    classical: bool = True,
    most_sets: int = SETS,
) -> list[dict[str, Any]]:
    """Return mean CC by solver, remedy and number of lost electrodes; the worst set's beside it.

    Args:
        phantoms: All with the labels of the bundle.
        bundle: The network.
        consistency: Of the bundle.
        conditions: Noise and seeds.
        classical: Whether Tikhonov, l1 and SBL are measured too.
        most_sets: Sets of two and of three electrodes.
    """
    network = named(Request("vd2t", bundle=bundle.path), bundle.labels).run
    spread = spread_of(consistency.reference, conditions.noise, conditions.snr_db)
    plan: list[tuple[str, str, Lost, Run]] = [("vd2t", "intact", (), network)]
    for count in (1, 2, 3):
        for lost in lost_sets(count, most_sets):
            plan.append(("vd2t", "zeros", lost, Run(_zeroed(network.solver, lost), "pre")))
            plan.append(("vd2t", "imputed", lost, Run(_imputed(network.solver, lost, consistency, spread), "pre")))
            if consistency.layers is not None:
                solver = _imputed(network.solver, lost, replace(consistency, layers=None), spread)
                plan.append(("vd2t", "imputed, Gaussian alone", lost, Run(solver, "pre")))
    if classical:
        kept: dict[int, Precomputed] = {}
        for name, solve in _CLASSICAL.items():
            for count in (0, 1):
                for lost in lost_sets(count, most_sets):
                    remedy = "down-dated" if lost else "intact"
                    plan.append((name, remedy, lost, Run(_without(solve, lost, kept), "post")))
    results = evaluate_all(phantoms, [run for *_, run in plan], conditions)
    scores = [float(np.mean([one.cc for _, scores in result for one in scores])) for result in results]
    intact = {name: score for (name, remedy, _, _), score in zip(plan, scores, strict=True) if remedy == "intact"}
    rows = []
    for name, remedy, count in dict.fromkeys((name, remedy, len(lost)) for name, remedy, lost, _ in plan):
        group = [
            (score, lost)
            for (a, b, lost, _), score in zip(plan, scores, strict=True)
            if (a, b, len(lost)) == (name, remedy, count)
        ]
        worst = min(group)
        mean = float(np.mean([score for score, _ in group]))
        rows.append(
            {"what": "accuracy", "solver": name, "remedy": remedy, "lost": count, "sets": len(group),
             "cc": round(mean, 4), "of_intact": round(mean / intact[name], 4), "worst_cc": round(worst[0], 4),
             "worst_of_intact": round(worst[0] / intact[name], 4), "worst_set": list(worst[1])}
        )  # fmt: skip
    return rows


def _zeroed(solver: Solver, lost: Lost) -> Solver:
    rows = rows_of(lost)
    return lambda case: solver(replace(case, voltages=np.where(rows, case.flat_reference, case.voltages)))


def spread_of(reference: Array, noise: Kind, snr_db: float) -> Array:
    """Return (104,) V by which frames of the flat, untouched sheet vary; N1 is noise of a touch, and makes none."""
    level = 10.0 ** (-snr_db / 20.0)
    if noise == "N3":
        return np.full_like(reference, level * np.sqrt(np.mean(reference**2)))
    return level * np.abs(reference) if noise == "N2" else np.zeros_like(reference)


def _imputed(solver: Solver, lost: Lost, consistency: Consistency, spread: Array) -> Solver:
    watch = ElectrodeWatch(consistency, consistency.reference, spread, lost)

    def solve(case: Case) -> Array:
        change = relative_change(case.voltages, case.flat_reference).astype(np.float32)
        watch.correct(change, log_ratio(case.sheet.predicted(), flat_voltages()))
        return solver(replace(case, voltages=case.flat_reference * (1.0 + change.astype(np.float64))))

    return solve


def _tikhonov(kept: Precomputed, gone: npt.NDArray[np.bool_], case: Case) -> Array:
    return np.asarray(kept.tikhonov(gone) @ log_data(case.voltages, case.reference)[~gone])


def _l1(kept: Precomputed, gone: npt.NDArray[np.bool_], case: Case) -> Array:
    operator, lipschitz = kept.left(gone)
    data = linear_data(case.voltages, case.reference)[~gone]
    return l1_image(operator, data, upper=SATURATED, lipschitz=lipschitz)


def _sbl(kept: Precomputed, gone: npt.NDArray[np.bool_], case: Case) -> Array:
    operator, _ = kept.left(gone)
    data = linear_data(case.voltages, case.reference)[~gone]
    return sbl_image(operator, data, kept.operators.shape, upper=SATURATED)


_CLASSICAL: Final[dict[str, Callable[[Precomputed, npt.NDArray[np.bool_], Case], Array]]] = {
    "tikhonov": _tikhonov,
    "l1": _l1,
    "sbl": _sbl,
}


def _without(
    solve: Callable[[Precomputed, npt.NDArray[np.bool_], Case], Array], lost: Lost, kept: dict[int, Precomputed]
) -> Solver:
    rows = rows_of(lost)

    def solver(case: Case) -> Array:
        operators = case.sheet.operators("units" if case.labels == "units" else "pixels")
        if id(operators) not in kept:
            kept.clear()  # operators of a phantom are let go before the next one: so are these
            kept[id(operators)] = precompute(operators)
        return scaled(operators.to_map(solve(kept[id(operators)], rows, case)))

    return solver


def costs(operators: Operators, consistency: Consistency, repeats: int = 20) -> list[dict[str, Any]]:
    """Return CPU milliseconds of what a lost electrode changes, beside building it anew."""
    kept, gone = precompute(operators), rows_of((5,))
    filling = Imputation(consistency.mean, consistency.precision(), consistency.ratio_range, consistency.layers)
    precision = consistency.precision()
    change = np.zeros(len(gone), dtype=np.float32)
    jobs: dict[str, Callable[[], object]] = {
        "tikhonov, down-dated": lambda: kept.tikhonov(gone),
        "tikhonov, built anew": lambda: tikhonov_matrix(operators.relative_jacobian[~gone]),
        "l1 and sbl, rows removed": lambda: kept.left(gone),
        "network, rows chosen": lambda: filling.leave_out(gone, precision, (5,)),
        "network, rows filled in, a frame": lambda: filling.fill(change),
    }
    rows = []
    for name, job in jobs.items():
        job()
        start = process_time()
        for _ in range(repeats):
            job()
        rows.append({"what": "cost", "job": name, "cpu_ms": round(1e3 * (process_time() - start) / repeats, 4)})
    return rows
