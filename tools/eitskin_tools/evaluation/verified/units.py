"""The network's map checked by physics: ``eitskin evaluate --solver verified``.

The network answers as it does in the runtime; its touched units, at several thresholds, are where the verifier starts
(:mod:`eitskin_sim.verification.units`). A reduced model is made from each cloud, as in a process beside the runtime,
and once more with the uneven stretch that the first frame there shows, which no scan can: that belongs to the shape and
not to the frame, so it counts as set-up, and serves all frames of the shape. Voltages come from the harness's own mesh,
whatever the model's.
"""

import time
from dataclasses import asdict, dataclass, replace
from typing import Any, Final, Generic, TypeVar

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.normalise import inverse_reference, relative_change
from eitskin_proto.sensor.row_gaussian import rows_of
from eitskin_proto.skin.skin import Skin
from eitskin_sim.evaluation.harness import Case, Results, Run
from eitskin_sim.evaluation.metrics import Score
from eitskin_sim.measurement.consistency import Filler
from eitskin_sim.scene.parts import Phantom
from eitskin_sim.verification.material import MATERIAL
from eitskin_sim.verification.prepared import prepared
from eitskin_sim.verification.residual import Noise
from eitskin_sim.verification.units import UnitTouch, UnitVerifier
from eitskin_sim.verification.verdict import Fitted, Verdict

THRESHOLDS: Final = (0.5, 0.25, 0.75)
"""Heights at which a unit of the network's map counts as touched: one start each."""

CLEAR: Final = 3.0
"""An amplitude of material that is so many standard errors from 0 goes into the model."""

REBUILT: Final = 2
"""How often a model is made anew with what was found."""

LEAST: Final = 0.02
"""Less of it is left to the nuisance."""

MOST: Final = 0.3
"""No amplitude of a real sheet is larger."""

SPARED: Final = 0.7
"""A model made anew is kept if it leaves less than this part of a frame's chi-squared, or explains the frame."""

SPREADS: Final = (1e-5, 0.01)
"""Of a row's voltage: what noise a reference is believed to have shown, as in :mod:`eitskin.pipeline.stillness`."""

Material = tuple[float, ...]
Made = dict[bytes, tuple[UnitVerifier, Material]]
"""Verifiers by their shape, each with the material that frames of it have shown."""
STILL: Final = (0.0, 0.0, 0.0)
NOTHING: Final = Fitted("", 0.0, 0.0)


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
    """Making the models of its shape, by the processor."""
    network: npt.NDArray[np.bool_]
    """(units,) or (pixels,) what the network alone says is touched."""


class Verified:
    """A network and the verifier behind it.

    Args:
        network: The network's run.
        noise: What the instrument's noise is.
        skin: Whose models.
        budget_s: What a frame may take; None is what the verifier gives it.
        missing: Electrodes that are gone: their rows are not looked at, and filled in for the network.
        filler: Fills them in.
        made: Verifiers of one device's shapes, kept from one run to another; None keeps that of the last shape.
    """

    def __init__(
        self,
        network: Run,
        noise: Noise,
        skin: Skin,
        budget_s: float | None = None,
        missing: tuple[int, ...] = (),
        filler: Filler | None = None,
        made: Made | None = None,
    ) -> None:
        self._network, self._noise, self._skin, self._budget_s = network, noise, skin, budget_s
        self._missing, self._filler = missing, filler
        self._keeps, self._made = made is not None, {} if made is None else made
        self.checked: list[Checked[Verdict[UnitTouch]]] = []
        """Verdicts in the order of the cases."""

    @property
    def run(self) -> Run:
        """Return the run that the harness takes."""
        return replace(self._network, solver=self.solve)

    def solve(self, case: Case) -> npt.NDArray[np.float64]:
        """Return the map of the touched units."""
        grid = self._skin.grid
        change = relative_change(case.voltages, case.flat_reference)
        rows = inverse_reference(case.flat_reference) != 0.0
        if self._missing and self._filler is not None:
            rows &= ~rows_of(self._missing)
            filled = change[None].copy()
            self._filler.fill(filled, self._missing)
            case = replace(case, voltages=case.flat_reference * (1.0 + filled[0]))
        image = self._network.solver(case)
        heights = unit_heights(image, grid)
        starts = unit_starts(heights)
        verifier, material, setup_ms = self._of(case)

        def verify(by: UnitVerifier, before: tuple[UnitTouch, ...] = ()) -> tuple[Verdict[UnitTouch], float]:
            start = time.process_time()
            verdict = by.verify(
                change,
                case.flat_reference,
                starts,
                self._noise,
                rows=rows,
                budget_s=self._budget_s,
                before=before,
                heights=heights,
                clock=time.process_time,
            )
            return verdict, 1e3 * (time.process_time() - start)

        verdict, cpu_ms = verify(verifier)
        for _ in range(REBUILT):
            found = material_shown(verdict, material)
            if found is None:
                break
            begin = time.process_time()
            other = prepared(case.sheet.cloud_mm, self._skin, material=found)
            setup_ms += 1e3 * (time.process_time() - begin)
            again, again_ms = verify(other, verdict.touches)
            if not better_with_material(again, verdict):
                setup_ms += again_ms
                break
            verdict, cpu_ms, verifier, material = again, again_ms, other, found
            self._keep(shape_of(case), verifier, material)
        self.checked.append(Checked(verdict, 1e3 * verdict.seconds, cpu_ms, setup_ms, starts[0]))
        touched = np.zeros(grid.n_units)
        touched[[one.unit for one in verdict.touches]] = 1.0
        return np.asarray(grid.map_from_units(touched), dtype=np.float64)

    def _of(self, case: Case) -> tuple[UnitVerifier, Material, float]:
        """Return the verifier of a case's shape, the material in it, and ms that it took: 0 for the shape just seen."""
        shape = shape_of(case)
        if shape in self._made:
            return *self._made[shape], 0.0
        begin = time.process_time()
        self._keep(shape, prepared(case.sheet.cloud_mm, self._skin), STILL)
        return *self._made[shape], 1e3 * (time.process_time() - begin)

    def _keep(self, shape: bytes, verifier: UnitVerifier, material: Material) -> None:
        if not self._keeps:
            self._made.clear()
        self._made[shape] = verifier, material


def shape_of(case: Case) -> bytes:
    """Return what tells one sheet at one shape from another: not its scan alone, which shows no uneven stretch."""
    return case.sheet.cloud_mm.tobytes() + case.sheet.untouched.tobytes()


def noise_shown(reference_V: npt.NDArray[np.float64], spread_V: npt.NDArray[np.float64]) -> Noise:
    """Return the noise of a frame, as a reference's frames showed it.

    Args:
        reference_V: (rows,) V.
        spread_V: (rows,) V, standard deviation of a single frame.
    """
    inverse = inverse_reference(reference_V)
    sd = np.clip(spread_V * np.abs(inverse), *SPREADS)
    return Noise("measured", measured=np.where(inverse != 0.0, sd, SPREADS[1]))


def material_shown(verdict: Verdict[UnitTouch], material: Material) -> Material | None:
    """Return the amplitudes of material that a model should have after a frame; None where it has them.

    Args:
        verdict: Of the frame.
        material: What the model has.
    """
    more = [next((one for one in verdict.nuisances if one.name == name), NOTHING) for name in MATERIAL]
    if all(abs(one.value) <= max(CLEAR * one.error, LEAST) for one in more):
        return None
    return tuple(float(np.clip(old + one.value, -MOST, MOST)) for old, one in zip(material, more, strict=True))


def better_with_material(again: Verdict[UnitTouch], before: Verdict[UnitTouch]) -> bool:
    """Return whether a frame is so much better explained by a model made anew that the model is kept.

    A frame whose touches are not found asks for any material; made of it, the model would spoil the frames after it.

    Args:
        again: The frame's verdict by the model with the material that it has shown.
        before: By the model without.
    """
    return again.p_value >= again.level or again.chi_squared < SPARED * before.chi_squared


def unit_heights(image: npt.NDArray[np.float64], grid: Any) -> npt.NDArray[np.float64]:
    """Return (units,) the mean of a map over each unit's pixels: how sure the network is of each."""
    unit = grid.unit_of_pixel.ravel()
    pixels = np.maximum(np.bincount(unit, minlength=grid.n_units), 1)
    return np.asarray(np.bincount(unit, weights=image.ravel(), minlength=grid.n_units) / pixels)


def unit_starts(heights: npt.NDArray[np.float64]) -> list[npt.NDArray[np.bool_]]:
    """Return the units that are touched by their heights, at each threshold."""
    return [heights >= one for one in THRESHOLDS]


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
        row["touch_list"] = [asdict(touch) for touch in own[0].verdict.touches]  # of the first draw
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
