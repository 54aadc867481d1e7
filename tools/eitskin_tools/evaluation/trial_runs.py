"""Trials on touches and deformations that nobody chose: drawn, solved, scored and summed up."""

from collections.abc import Callable
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.skin.touch_kind import TouchKind
from eitskin_sim.evaluation import trials
from eitskin_sim.evaluation.harness import Case, Conditions, Run, evaluate_all
from eitskin_sim.evaluation.metrics import TOUCHED
from eitskin_sim.evaluation.report import summary
from eitskin_sim.scene.parts import Phantom
from eitskin_tools.evaluation.solvers import Progress, Request, evaluate_named, named, verdicts_of

BINS: Final = (0.1, 0.5, 0.9)
"""Heights that an untouched sheet's peak is held against."""


def touched_trial(
    phantoms: list[Phantom], each: int, request: Request, conditions: Conditions, progress: Progress | None
) -> dict[str, Any]:
    """Return the summary of one solver on drawn phantoms, ``each`` of them at a deformation."""
    ((solvers, results),) = evaluate_named(phantoms, [request], conditions, progress)
    found = {**_head(request, conditions, next(iter(solvers.values()))), **summary(results, each, conditions.skin.grid)}
    if (checked := verdicts_of(phantoms, solvers, conditions.seeds)) is not None:
        from eitskin_tools.evaluation.verified.solver import summary_of

        found["verified"] = summary_of([(phantom, scores, checked[id(phantom)]) for phantom, scores in results])
    return found


def untouched_trial(
    deformations: int,
    family: Any,
    labels: trials.Labels,
    request: Request,
    conditions: Conditions,
    progress: Progress | None,
) -> dict[str, Any]:
    """Return how high the maps of bent sheets rise that nothing touches, of the network for the skin's touches."""
    touches: TouchKind = "lowering" if conditions.skin.touch_kind == "lowering" else "raising"
    solver = named(request, labels, conditions.skin, touches, conditions)
    peaks: list[float] = []
    run = Run(_keeping_peaks(solver.run.solver, peaks), solver.run.reference)
    evaluate_all(trials.untouched(deformations, family, labels, conditions.skin), [run], conditions, progress)
    found = np.array(peaks)
    return {
        **_head(request, conditions, solver),
        "maps": len(found),
        "peak": float(found.max()),
        "peak_mean": float(found.mean()),
        "ghost_share": float(np.mean(found >= TOUCHED)),
        "peak_over": {f"{level:g}": float(np.mean(found >= level)) for level in BINS},
        "worst_deformation": int(np.argmax(found)) // conditions.seeds,
    }


def _keeping_peaks(
    solver: Callable[[Case], npt.NDArray[np.float64]], peaks: list[float]
) -> Callable[[Case], npt.NDArray[np.float64]]:
    def solve(case: Case) -> npt.NDArray[np.float64]:
        image = solver(case)
        peaks.append(float(image.max()))
        return image

    return solve


def _head(request: Request, conditions: Conditions, solver: Any) -> dict[str, Any]:
    return {
        "solver": request.name,
        "noise": conditions.noise,
        "snr_db": conditions.snr_db,
        "seeds": conditions.seeds,
        "cloud": conditions.cloud,
        "reference": solver.run.reference,
        "prediction": solver.prediction,
        "bundles": [solver.bundle_id] if solver.bundle_id else [],
        "skin_digest": conditions.skin.digest,
    }
