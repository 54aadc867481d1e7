"""What reduced models take to make, and how far off they are: on the fine mesh, and on the coarse one corrected."""

import time
from collections.abc import Callable
from typing import Any, Final

import numpy as np

from eitskin_proto.skin.skin import PAPER
from eitskin_sim.evaluation import trials
from eitskin_sim.fem.mesh import Metric
from eitskin_sim.reduced.exact import exact_sheet
from eitskin_sim.reduced.making import reduced
from eitskin_sim.reduced.model import ReducedModel, rows_of
from eitskin_sim.reduced.quick import quick_model
from eitskin_sim.reduced.state import state_of
from eitskin_sim.scene.bend import bend_metric
from eitskin_sim.scene.parts import Sheet
from eitskin_sim.verification.units import CONTRAST

COUNTS: Final = (1, 6, 12)
"""Units in a set."""

SETS: Final = 12
"""Sets of each count at each deformation, half of them of contrast 50 and half of mixed ones."""

ROUNDS: Final = 3
"""Times that each model is made at each deformation, in turn."""


def models(deformations: int) -> list[dict[str, Any]]:
    """Return a row for each way of making models: what one takes of the processor, and how far off its log V is.

    Args:
        deformations: How many of family A.
    """
    makers: dict[str, Callable[[Metric], ReducedModel]] = {
        "fine mesh": lambda metric: reduced(exact_sheet(metric)),
        "coarse mesh, corrected": quick_model,
    }
    rng = np.random.default_rng(9)
    took: dict[str, list[float]] = {name: [] for name in makers}
    off: dict[str, dict[int, list[float]]] = {name: {count: [] for count in COUNTS} for name in makers}
    for bend in trials.deformations_of(deformations, "A"):
        metric = bend_metric(bend, Sheet())
        exact = exact_sheet(metric)
        made = {name: make(metric) for name, make in makers.items()}  # what is kept for all shapes is there now
        for _ in range(ROUNDS):
            for name, make in makers.items():
                start = time.process_time()
                make(metric)
                took[name].append(1e3 * (time.process_time() - start))
        for count in COUNTS:
            for number in range(SETS):
                units = rng.choice(PAPER.grid.n_units, count, replace=False)
                contrasts = np.full(count, CONTRAST) if number % 2 else np.exp(rng.uniform(-2.3, -0.2, count))
                truth = rows_of(exact.currents(units, contrasts)[1])
                for name, model in made.items():
                    off[name][count].append(
                        float(np.mean(np.log(state_of(model, units, contrasts).volts / truth) ** 2))
                    )
    return [
        {
            "what": name,
            "cpu_ms_median": float(np.median(took[name])),
            "cpu_ms_p95": float(np.percentile(took[name], 95)),
            **{f"rms_{count}": float(np.sqrt(np.mean(off[name][count]))) for count in COUNTS},
        }
        for name in makers
    ]
