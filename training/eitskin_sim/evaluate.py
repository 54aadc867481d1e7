"""The harness: phantom file -> data on an independent finer mesh -> noise -> scan -> solver -> metrics.

Everything a solver may see is in a :class:`Case`: the noisy voltages, the reference of its kind, and the cloud that a
scanner gives of the bend (0.1 mm noise, even by arc length). A classical solver's Jacobian is computed from that
cloud, as the paper does, on a mesh 3.75 times coarser than the data's. References are averages of many frames, so
without noise::

    pre        the flat, untouched sheet, once and for all (paper Fig. 10; what the network gets)
    post       the bent, untouched sheet (paper Table II)
    predicted  V_pred, from the cloud by the forward model: what a robot can have while the sheet is being touched
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache
from typing import Final, Literal, get_args

import numpy as np
import numpy.typing as npt

from eitskin_proto.grid import map_from_units
from eitskin_sim.area import area_map
from eitskin_sim.metrics import Score, scaled, score, touched_units
from eitskin_sim.noise import Kind, add_noise
from eitskin_sim.parts import Bend, Phantom, Scene
from eitskin_sim.predict import flat_voltages, predict
from eitskin_sim.scanned import scanned_cloud
from eitskin_sim.solve import solve_scene
from eitskin_sim.solvers.l1 import l1_image
from eitskin_sim.solvers.operators import (
    SATURATED,
    Cells,
    Operators,
    linear_data,
    log_data,
    operators_of_cloud,
)
from eitskin_sim.solvers.sbl import sbl_image
from eitskin_sim.solvers.tikhonov import tikhonov_matrix

Array = npt.NDArray[np.float64]

Reference = Literal["pre", "post", "predicted"]
"""What the voltages are compared with."""

REFERENCES: Final[tuple[str, ...]] = get_args(Reference)
"""The kinds of reference."""

DATA_MM: Final = 1.2
"""Element size of the data: finer than the 1.5 mm of training and the 4.5 mm of the solvers' operators."""

SCAN_SEED: Final = 20_000
"""The scan's noise has its own seeds, apart from those of the voltages."""

MEASURES: Final = ("cc", "psnr_db", "rie", "localisation_mm", "exact")
"""What is reported of each phantom and of their mean."""


@dataclass(slots=True)
class Sheet:
    """One bent sheet: what is known of it before a touch, computed once and kept while the process runs."""

    cloud_mm: Array
    """(3, 30, 45) as scanned."""
    untouched: Array
    """(104,) V of the true bent sheet."""
    _operators: dict[Cells, Operators] = field(default_factory=dict)
    _matrices: dict[Cells, Array] = field(default_factory=dict)
    _predicted: Array | None = None

    def operators(self, cells: Cells) -> Operators:
        """Return the scanned sheet's operators."""
        if cells not in self._operators:
            self._operators[cells] = operators_of_cloud(self.cloud_mm, cells)
        return self._operators[cells]

    def tikhonov(self, cells: Cells) -> Array:
        """Return the scanned sheet's Tikhonov matrix (n, 104)."""
        if cells not in self._matrices:
            self._matrices[cells] = tikhonov_matrix(self.operators(cells).relative_jacobian)
        return self._matrices[cells]

    def predicted(self) -> Array:
        """Return the scanned sheet's V_pred (104,), V."""
        if self._predicted is None:
            self._predicted = predict(self.cloud_mm)
        return self._predicted


@dataclass(frozen=True, slots=True)
class Case:
    """What a solver may see of one measurement."""

    voltages: Array
    """(104,) V, touched and noisy."""
    reference: Array
    """(104,) V of the kind asked for."""
    flat_reference: Array
    """(104,) V, flat and untouched."""
    sheet: Sheet
    labels: Literal["units", "area"]
    """What a map's pixels mean; solvers without a grid of their own take units for "units", else pixels."""


Solver = Callable[[Case], Array]
"""From a case to a (30, 45) map, judged as it is."""


def _cells(case: Case, cells: Cells | None) -> Cells:
    return cells or ("units" if case.labels == "units" else "pixels")


def solve_tikhonov(case: Case, cells: Cells | None = None) -> Array:
    """Return the map of one matrix times the logarithmic data."""
    on = _cells(case, cells)
    image = case.sheet.tikhonov(on) @ log_data(case.voltages, case.reference)
    return scaled(case.sheet.operators(on).to_map(image))


def solve_l1(case: Case, cells: Cells | None = None) -> Array:
    """Return the map of FISTA with the bounds of an effective contrast."""
    operators = case.sheet.operators(_cells(case, cells))
    data = linear_data(case.voltages, case.reference)
    return scaled(operators.to_map(l1_image(operators.relative_jacobian, data, upper=SATURATED)))


def solve_sbl(case: Case, cells: Cells | None = None) -> Array:
    """Return the map of structure-aware SBL with the bounds of an effective contrast."""
    operators = case.sheet.operators(_cells(case, cells))
    data = linear_data(case.voltages, case.reference)
    return scaled(operators.to_map(sbl_image(operators.relative_jacobian, data, operators.shape, upper=SATURATED)))


def _registry() -> dict[str, Solver]:
    found: dict[str, Solver] = {}
    for name, solve in (("tikhonov", solve_tikhonov), ("l1", solve_l1), ("sbl", solve_sbl)):
        found[name] = solve
        for cells in get_args(Cells):
            found[f"{name}-{cells}"] = lambda case, solve=solve, cells=cells: solve(case, cells)  # type: ignore[misc]
    return found


SOLVERS: Final[Mapping[str, Solver]] = _registry()
"""Every classical solver by name; "-pixels" and "-units" fix the grid that the plain name takes from the labels."""


def truth_map(phantom: Phantom) -> Array:
    """Return the (30, 45) truth of a phantom: hard labels of the touched units, or the touched share of each pixel."""
    area = area_map(phantom.scene.touches)
    return np.asarray(map_from_units(touched_units(area).astype(np.float64))) if phantom.truth == "units" else area


def evaluate(
    phantoms: Sequence[Phantom],
    solver: Solver,
    *,
    noise: Kind = "N2",
    snr_db: float = 50.0,
    reference: Reference = "post",
    seeds: int = 1,
) -> list[tuple[Phantom, list[Score]]]:
    """Return every phantom's scores, one a seed.

    Args:
        phantoms: What to look at.
        solver: From a case to a map.
        noise: Definition of the voltages' noise.
        snr_db: Its level.
        reference: Kind of reference.
        seeds: Noise draws for each phantom: 0 to seeds - 1.

    Raises:
        ValueError: No phantoms, no seeds, or an unknown reference.
    """
    if not phantoms or seeds < 1:
        raise ValueError(f"at least one phantom and one seed are needed, found {len(phantoms)} and {seeds}")
    if reference not in REFERENCES:
        raise ValueError(f"reference {reference!r} is unknown; expected one of {', '.join(REFERENCES)}")
    results = []
    for index, phantom in enumerate(phantoms):
        truth, clean = truth_map(phantom), _voltages(phantom.scene)
        scores = []
        for seed in range(seeds):
            rng = np.random.default_rng([seed, index])
            flat = _voltages(replace(phantom.scene.untouched(), bend=Bend()))
            noisy = add_noise(clean, flat, noise, snr_db, rng)
            sheet = _sheet(phantom.scene.untouched(), seed)
            case = Case(noisy, _reference(reference, phantom.scene, sheet, flat), flat, sheet, phantom.truth)
            scores.append(score(solver(case), truth, labels=phantom.truth))
        results.append((phantom, scores))
    return results


def mean_scores(scores: Sequence[Score]) -> dict[str, float]:
    """Return the mean of each of ``MEASURES``; None of them is hidden when infinite."""
    rows = [asdict(one) for one in scores]
    return {name: float(np.mean([row[name] for row in rows])) for name in MEASURES}


def report(solver: str, noise: str, results: Sequence[tuple[Phantom, list[Score]]]) -> dict[str, object]:
    """Return the results as the object that ``eitskin evaluate --json`` prints; what is not finite becomes None."""
    phantoms = [{"name": phantom.name, **_finite(mean_scores(scores))} for phantom, scores in results]
    means = [mean_scores(scores) for _, scores in results]
    mean = {name: float(np.mean([row[name] for row in means])) for name in MEASURES}
    return {"solver": solver, "noise": noise, "phantoms": phantoms, "mean": _finite(mean)}


def _finite(values: dict[str, float]) -> dict[str, float | None]:
    return {name: value if math.isfinite(value) else None for name, value in values.items()}


def _reference(kind: Reference, scene: Scene, sheet: Sheet, flat: Array) -> Array:
    if kind == "pre":
        return flat
    if kind == "post":
        return sheet.untouched
    # The captured flat reference calibrates the model: their ratio carries the model's error, and the current.
    return sheet.predicted() * flat / flat_voltages()


@lru_cache(maxsize=256)
def _voltages(scene: Scene) -> Array:
    return solve_scene(replace(scene, element_size_mm=min(scene.element_size_mm, DATA_MM))).voltages


@lru_cache(maxsize=64)
def _sheet(untouched: Scene, seed: int) -> Sheet:
    cloud = scanned_cloud(untouched.bend, np.random.default_rng([SCAN_SEED, seed]))
    return Sheet(np.asarray(cloud, dtype=np.float64), _voltages(untouched))
