"""The harness: phantom file -> data on an independent finer mesh -> noise -> cloud -> solver -> metrics.

Everything a solver may see is in a :class:`Case`: the noisy voltages, the reference of its kind, and the cloud that a
scanner gives of the bend (0.1 mm noise, even by arc length). A classical solver's Jacobian is computed from that
cloud, as the paper does, on a mesh 3.75 times coarser than the data's, and of the ideal device: a phantom's scene is
the true one, which no solver knows. References are averages of many frames, so
without noise::

    pre        the flat, untouched sheet, once, before what came late (paper Fig. 10; what the network gets)
    post       the bent, untouched sheet (paper Table II)
    predicted  V_pred, from the cloud by the forward model: available to a robot while the sheet is touched
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Final, Literal, get_args

import numpy as np

from eitskin_proto.files.plain import quoted
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.arrays import Array
from eitskin_sim.evaluation.metrics import Score, scaled, score
from eitskin_sim.evaluation.truth import check_truths, truth_map
from eitskin_sim.fem.solve import solve_scene
from eitskin_sim.measurement.noise import Kind, add_noise
from eitskin_sim.scene.family import draw, is_family
from eitskin_sim.scene.parts import Bend, Phantom, Scene, SceneError
from eitskin_sim.scene.shift import shifted
from eitskin_sim.solvers.l1 import ITERATIONS, l1_image
from eitskin_sim.solvers.operators import (
    SATURATED_CONTRAST,
    Cells,
    Operators,
    linear_data,
    log_data,
    operators_of_cloud,
)
from eitskin_sim.solvers.sbl import sbl_image
from eitskin_sim.solvers.tikhonov import tikhonov_matrix
from eitskin_sim.surface.measured_cloud import measured_cloud
from eitskin_sim.surface.predict import flat_voltages, predict

Reference = Literal["pre", "post", "predicted"]
"""The reference of the voltages."""

REFERENCES: Final[tuple[str, ...]] = get_args(Reference)
"""The kinds of reference."""

DATA_MM: Final = 1.2
"""Element size of the data: finer than the 1.5 mm of training and the 4.5 mm of the solvers' operators."""

CLOUD_SEED: Final = 20_000
"""The cloud's noise has its own seeds, apart from those of the voltages."""

SHIFT_SEED: Final = 21_000
"""Shifts of touches too: the same draw whatever the noise."""

CloudKind = Literal["scan", "fitted", "flat", "other"]
"""Which cloud the solvers are given: the one measured, none but the frames themselves, the flat sheet's, or that of
another deformation."""


@dataclass(frozen=True, slots=True)
class Conditions:
    """Under which conditions phantoms are measured."""

    noise: Kind = "N2"
    """Definition of the voltages' noise."""
    snr_db: float = 50.0
    """Its level."""
    seeds: int = 1
    """Draws of noise, cloud and shift for each phantom: ``first_seed`` to ``first_seed + seeds - 1``."""
    shift_px: float = 0.0
    """Every touch is moved by up to this part of a pixel along x and y."""
    cloud: CloudKind = "scan"
    """The shape that the solvers know; the others are ablations."""
    skin: Skin = PAPER
    """The skin whose model, map and clouds the solvers have; the voltages are those of the phantoms' own scenes."""
    first_seed: int = 0
    """The first draw of noise, cloud and shift."""
    fused: int = 1
    """Frames of rest that are averaged."""


@dataclass(slots=True)
class Sheet:
    """One bent sheet with its data before a touch, computed once and kept while the process runs."""

    cloud_mm: Array
    """(3, rows, columns) as measured."""
    untouched: Array
    """(104,) V of the true bent sheet."""
    skin: Skin = PAPER
    """Whose model explains it."""
    is_guess: bool = False
    """Whether nothing measured the cloud."""
    is_certain: bool = False
    """Whether frames never show another shape."""
    _operators: dict[Cells, Operators] = field(default_factory=dict)
    _matrices: dict[Cells, Array] = field(default_factory=dict)
    _predicted: Array | None = None

    def operators(self, cells: Cells) -> Operators:
        """Return the measured cloud's operators."""
        if cells not in self._operators:
            self._operators[cells] = operators_of_cloud(self.cloud_mm, cells, self.skin)
        return self._operators[cells]

    def tikhonov(self, cells: Cells) -> Array:
        """Return the measured cloud's Tikhonov matrix (n, 104)."""
        if cells not in self._matrices:
            self._matrices[cells] = tikhonov_matrix(self.operators(cells).relative_jacobian)
        return self._matrices[cells]

    def predicted(self) -> Array:
        """Return the measured cloud's V_pred (104,), V."""
        if self._predicted is None:
            self._predicted = predict(self.cloud_mm, self.skin)
        return self._predicted


@dataclass(frozen=True, slots=True)
class Case:
    """The data of one measurement that a solver may see."""

    voltages: Array
    """(104,) V, touched and noisy."""
    reference: Array
    """(104,) V of the kind asked for."""
    flat_reference: Array
    """(104,) V, flat and untouched."""
    sheet: Sheet
    labels: Literal["units", "area"]
    """What a map's pixels mean; solvers without a grid of their own take units for "units", else pixels."""
    lowering: bool = False
    """Whether all touches here lower conductance: classical solvers then look for that."""
    fused: int = 1
    """Frames that the voltages are the mean of."""


Solver = Callable[[Case], Array]
"""From a case to a (rows, columns) map, judged as it is."""

Results = list[tuple[Phantom, list[Score]]]
"""Every phantom's scores, one a seed."""


@dataclass(frozen=True, slots=True)
class Run:
    """One solver with one kind of reference."""

    solver: Solver
    reference: Reference


def _cells(case: Case, cells: Cells | None) -> Cells:
    return cells or ("units" if case.labels == "units" else "pixels")


def _sign(case: Case) -> float:
    """To first order a touch that lowers conductance is one that raises it, with the data's sign turned."""
    return -1.0 if case.lowering else 1.0


def solve_tikhonov(case: Case, cells: Cells | None = None) -> Array:
    """Return the map of one matrix times the logarithmic data."""
    on = _cells(case, cells)
    image = case.sheet.tikhonov(on) @ (_sign(case) * log_data(case.voltages, case.reference))
    return scaled(case.sheet.operators(on).to_map(image))


def solve_l1(case: Case, cells: Cells | None = None, iterations: int = ITERATIONS) -> Array:
    """Return the map of FISTA with the bounds of an effective contrast."""
    operators = case.sheet.operators(_cells(case, cells))
    data = _sign(case) * linear_data(case.voltages, case.reference)
    image = l1_image(operators.relative_jacobian, data, upper=SATURATED_CONTRAST, iterations=iterations)
    return scaled(operators.to_map(image))


def solve_sbl(case: Case, cells: Cells | None = None) -> Array:
    """Return the map of structure-aware SBL with the bounds of an effective contrast."""
    operators = case.sheet.operators(_cells(case, cells))
    data = _sign(case) * linear_data(case.voltages, case.reference)
    return scaled(
        operators.to_map(sbl_image(operators.relative_jacobian, data, operators.shape, upper=SATURATED_CONTRAST))
    )


def _registry() -> dict[str, Solver]:
    found: dict[str, Solver] = {}
    for name, solve in (("tikhonov", solve_tikhonov), ("l1", solve_l1), ("sbl", solve_sbl)):
        found[name] = solve
        for cells in get_args(Cells):
            found[f"{name}-{cells}"] = lambda case, solve=solve, cells=cells: solve(case, cells)  # type: ignore[misc]
    return found


SOLVERS: Final[Mapping[str, Solver]] = _registry()
"""Every classical solver by name; "-pixels" and "-units" fix the grid that the plain name takes from the labels."""


def evaluate_all(
    phantoms: Sequence[Phantom],
    runs: Sequence[Run],
    conditions: Conditions,
    progress: Callable[[int, int], None] | None = None,
    numbers: Sequence[int] | None = None,
) -> list[Results]:
    """Return the results of several runs, which all see the same voltages and clouds.

    A phantom's voltages are solved once and kept while the process runs; a cloud's operators and V_pred are
    computed once for all runs, and let go before the next phantom.

    Args:
        phantoms: What to look at.
        runs: Solvers and references.
        conditions: Noise, seeds and shifts.
        progress: Called with the phantoms done and all phantoms.
        numbers: Of the phantoms in their file, by which their noise and shifts are drawn; None counts these from 0.

    Raises:
        ValueError: No phantoms, no seeds, an unknown reference or noise, or touches that the map does not show.
    """
    if not phantoms or conditions.seeds < 1:
        raise ValueError(f"at least one phantom and one seed are needed, found {len(phantoms)} and {conditions.seeds}")
    for run in runs:
        if run.reference not in REFERENCES:
            raise ValueError(f"reference {run.reference!r} is unknown; expected one of {', '.join(REFERENCES)}")
    results: list[Results] = [[] for _ in runs]
    skin, grid = conditions.skin, conditions.skin.grid
    check_truths(phantoms, skin)
    numbers = range(len(phantoms)) if numbers is None else numbers
    for done, (number, phantom) in enumerate(zip(numbers, phantoms, strict=True), 1):
        bare, where = phantom.scene.untouched(), f"phantoms[{number}] {quoted(phantom.name)}"
        flat = _solved(phantom.scene.reference(), where)
        scores: list[list[Score]] = [[] for _ in runs]
        shown, truth, clean = None, np.zeros(0), np.zeros(0)
        for seed in range(conditions.first_seed, conditions.first_seed + conditions.seeds):
            rng = np.random.default_rng([seed, number])
            own = np.random.default_rng([SHIFT_SEED, seed, number])
            moved = shifted(phantom, conditions.shift_px, own, grid)
            if moved != shown:
                shown, truth, clean = moved, truth_map(moved, grid), _solved(moved.scene, where)
            frames = np.tile(clean, (conditions.fused, 1))
            noisy = add_noise(frames, flat, conditions.noise, conditions.snr_db, rng).mean(axis=0)
            cloud, kind = _cloud(bare, conditions.cloud, seed, skin), conditions.cloud
            sheet = Sheet(cloud, _solved(bare, where), skin, kind == "fitted", kind == "flat")
            for run, kept in zip(runs, scores, strict=True):
                held = _reference(run.reference, sheet, flat)
                lowering = phantom.scene.touch_kind == "lower"
                case = Case(noisy, held, flat, sheet, phantom.truth, lowering, conditions.fused)
                kept.append(score(run.solver(case), truth, labels=phantom.truth, grid=grid))
        for result, kept in zip(results, scores, strict=True):
            result.append((phantom, kept))
        if progress is not None:
            progress(done, len(phantoms))
    return results


def _solved(scene: Scene, where: str) -> Array:
    try:
        return voltages_of(scene)
    except SceneError as error:
        raise SceneError(f"{where}: {error}") from error


@lru_cache(maxsize=256)
def voltages_of(scene: Scene) -> Array:
    """Return the (104,) V of a scene on the harness's mesh, or on the scene's own if that is finer."""
    return solve_scene(replace(scene, element_size_mm=min(scene.element_size_mm, DATA_MM))).voltages


def _reference(kind: Reference, sheet: Sheet, flat: Array) -> Array:
    if kind == "pre":
        return flat
    if kind == "post":
        return sheet.untouched
    # The captured flat reference calibrates the model: their ratio carries the model's error, and the current.
    return sheet.predicted() * flat / flat_voltages(sheet.skin)


def _cloud(bare: Scene, kind: CloudKind, seed: int, skin: Skin) -> Array:
    """Return the scan of a scene's own sheet, or the cloud that solvers get instead."""
    bend = bare.bend
    if kind in ("flat", "fitted"):
        bend = Bend()
    elif kind == "other":
        if not is_family(skin.deformations):
            raise ValueError("--cloud other: the skin's [deformations] are all fixed, so no other shape can be drawn")
        bend = next(other for other in draw("A", 2 + seed, CLOUD_SEED, skin)[seed:] if other != bend)
    rng, own = np.random.default_rng([CLOUD_SEED, seed]), bare.sheet if kind == "scan" else None
    return np.asarray(measured_cloud(bend, rng, skin=skin, sheet=own), dtype=np.float64)
