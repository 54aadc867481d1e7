"""The network's map checked by physics: ``eitskin evaluate --solver verified``.

The network answers as it does in the runtime; its touched units, at several thresholds, are where the verifier starts
(:mod:`eitskin_sim.verification.units`). A reduced model is made from each cloud, as in a process beside the runtime,
and once more with the uneven stretch that the first frame there shows, which no scan can: that belongs to the shape and
not to the frame, so it counts as set-up, and serves all frames of the shape. Voltages come from the harness's own mesh,
whatever the model's.
"""

import time
from dataclasses import dataclass, replace
from typing import Any, Final, Generic, TypeVar

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.normalise import inverse_reference, relative_change
from eitskin_proto.skin.skin import Skin
from eitskin_sim.evaluation.harness import Case, Results, Run
from eitskin_sim.evaluation.metrics import Score
from eitskin_sim.scene.parts import Phantom
from eitskin_sim.verification.prepared import prepared
from eitskin_sim.verification.residual import Noise
from eitskin_sim.verification.units import BUDGET_S, UnitTouch, UnitVerifier
from eitskin_sim.verification.verdict import Verdict

THRESHOLDS: Final = (0.5, 0.25, 0.75)
"""Heights at which a unit of the network's map counts as touched: one start each."""

CLEAR: Final = 3.0
"""Uneven stretch that is so many standard errors from 0 goes into the model."""

REBUILT: Final = 2
"""How often a model is made anew with the stretch found."""

LEAST_STRETCH: Final = 0.02
"""Less of it is left to the nuisance."""


Found = TypeVar("Found", bound=Verdict[Any])
"""A verdict on units, or on shapes anywhere."""


@dataclass(frozen=True, slots=True)
class Checked(Generic[Found]):
    """One map's verdict, and what it took."""

    verdict: Found
    extra_ms: float
    """The verifier's own time on the frame, by the clock."""
    cpu_ms: float
    """The same by the processor: what it takes where nothing else runs."""
    setup_ms: float
    """Making the models of its shape."""


class Verified:
    """A network and the verifier behind it.

    Args:
        network: The network's run.
        noise: What the instrument's noise is.
        skin: Whose models.
        budget_s: What a frame may take.
    """

    def __init__(self, network: Run, noise: Noise, skin: Skin, budget_s: float = BUDGET_S) -> None:
        self._network, self._noise, self._skin, self._budget_s = network, noise, skin, budget_s
        self.checked: list[Checked[Verdict[UnitTouch]]] = []
        """Verdicts in the order of the cases."""
        self._shape: tuple[bytes, UnitVerifier, float] | None = None

    @property
    def run(self) -> Run:
        """Return the run that the harness takes."""
        return replace(self._network, solver=self.solve)

    def solve(self, case: Case) -> npt.NDArray[np.float64]:
        """Return the map of the touched units."""
        grid = self._skin.grid
        starts = _starts(self._network.solver(case), grid)
        change = relative_change(case.voltages, case.flat_reference)
        rows = inverse_reference(case.flat_reference) != 0.0
        verifier, stretch, setup_ms = self._of(case)
        before: tuple[UnitTouch, ...] = ()
        for attempt in range(REBUILT + 1):
            start = time.process_time()
            verdict = verifier.verify(
                change, case.flat_reference, starts, self._noise, rows=rows, budget_s=self._budget_s, before=before
            )
            cpu_ms = 1e3 * (time.process_time() - start)
            more = next((one for one in verdict.nuisances if one.name == "stretch"), None)
            if attempt == REBUILT or more is None or abs(more.value) < max(CLEAR * more.error, LEAST_STRETCH):
                break
            before, stretch = verdict.touches, stretch + more.value
            begin = time.perf_counter()
            verifier = prepared(case.sheet.cloud_mm, self._skin, stretch=stretch)
            setup_ms += 1e3 * (time.perf_counter() - begin)
            self._shape = case.sheet.cloud_mm.tobytes(), verifier, stretch
        self.checked.append(Checked(verdict, 1e3 * verdict.seconds, cpu_ms, setup_ms))
        touched = np.zeros(grid.n_units)
        touched[[one.unit for one in verdict.touches]] = 1.0
        return np.asarray(grid.map_from_units(touched), dtype=np.float64)

    def _of(self, case: Case) -> tuple[UnitVerifier, float, float]:
        """Return the verifier of a case's shape, the stretch in it, and ms that it took: 0 for the shape just seen."""
        cloud = case.sheet.cloud_mm.tobytes()
        if self._shape is not None and self._shape[0] == cloud:
            return self._shape[1], self._shape[2], 0.0
        begin = time.perf_counter()
        verifier = prepared(case.sheet.cloud_mm, self._skin)
        self._shape = cloud, verifier, 0.0
        return verifier, 0.0, 1e3 * (time.perf_counter() - begin)


def _starts(image: npt.NDArray[np.float64], grid: Any) -> list[npt.NDArray[np.bool_]]:
    """Return the units of a map that are touched, at each threshold."""
    unit = grid.unit_of_pixel.ravel()
    pixels = np.maximum(np.bincount(unit, minlength=grid.n_units), 1)
    height = np.bincount(unit, weights=image.ravel(), minlength=grid.n_units) / pixels
    return [height >= one for one in THRESHOLDS]


def add_verdicts(found: dict[str, Any], results: Results, checked: dict[int, list[Checked[Any]]]) -> None:
    """Add to a report what the verifier said of each phantom, and of all of them.

    Args:
        found: The report.
        results: Phantoms and their scores.
        checked: A phantom's verdicts, one a score, by its ``id``.
    """
    for row, (phantom, _) in zip(found["phantoms"], results, strict=True):
        own = checked[id(phantom)]
        row["p_value"] = float(np.median([one.verdict.p_value for one in own]))
        row["flagged"] = float(np.mean([one.verdict.flagged for one in own]))
        row["extra_ms"] = float(np.median([one.extra_ms for one in own]))
    found["verified"] = summary_of([(phantom, scores, checked[id(phantom)]) for phantom, scores in results])


def summary_of(every: list[tuple[Phantom, list[Score], list[Checked[Any]]]]) -> dict[str, Any]:
    """Return what verdicts come to, over all maps."""
    exact = np.array([one.exact for _, scores, _ in every for one in scores]) == 1.0
    all_ = [one for _, _, checked in every for one in checked]
    flagged = np.array([one.verdict.flagged for one in all_])
    extra, cpu = np.array([one.extra_ms for one in all_]), np.array([one.cpu_ms for one in all_])
    setup = [one.setup_ms for one in all_ if one.setup_ms]
    return {
        "maps": len(all_),
        "exact": float(exact.mean()),
        "wrong": int((~exact).sum()),
        "wrong_unflagged": int((~exact & ~flagged).sum()),
        "right_flagged": int((exact & flagged).sum()),
        "extra_ms_median": float(np.median(extra)),
        "extra_ms_p95": float(np.percentile(extra, 95)),
        "cpu_ms_median": float(np.median(cpu)),
        "cpu_ms_p95": float(np.percentile(cpu, 95)),
        "setup_ms_median": float(np.median(setup)),
        "chi_squared_median": float(np.median([one.verdict.chi_squared for one in all_])),
    }
