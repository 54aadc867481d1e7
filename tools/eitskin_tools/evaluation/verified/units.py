"""The network's map checked by physics: ``eitskin evaluate --solver verified``.

The network answers as it does in the runtime; its touched units, at several thresholds, are where the verifier starts
(:mod:`eitskin_sim.verification.units`). A reduced model is made from each cloud, as in a process beside the runtime,
and others that the frames there ask for: where material lies and how it conducts belongs to the shape and not to the
frame, so that counts as set-up, and serves all frames of the shape. Voltages come from the harness's own mesh, whatever
the model's.
"""

import time
import zlib
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
from eitskin_sim.measurement.noise import add_noise
from eitskin_sim.scene.parts import Phantom
from eitskin_sim.verification.residual import Noise
from eitskin_sim.verification.unit_sheet import UnitSheet
from eitskin_sim.verification.units import UnitTouch
from eitskin_sim.verification.verdict import Verdict

THRESHOLDS: Final = (0.5, 0.25, 0.75)
"""Heights at which a unit of the network's map counts as touched: one start each."""

SEED: Final = 7041
"""Of the noise of untouched frames."""

SPREADS: Final = (1e-5, 0.01)
"""Of a row's voltage: what noise a reference is believed to have shown, as in :mod:`eitskin.pipeline.stillness`."""

Made = dict[bytes, UnitSheet]
"""Sheets by their shape, each with what its frames have shown."""


Found = TypeVar("Found", bound=Verdict[Any])
"""A verdict on units, or on shapes anywhere."""


@dataclass(frozen=True, slots=True)
class Checked(Generic[Found]):
    """One map's verdict, and what it took."""

    verdict: Found
    extra_ms: float
    """Of the verdict, by the clock: a frame that asked for another model has the time of its verdict by that."""
    cpu_ms: float
    """Of the frame's first verdict, by the processor: where it asked for another model, that search was in vain."""
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
        made: Sheets of one device's shapes, kept from one run to another; None keeps that of the last shape.
        at_rest: Untouched frames of a shape that physics sees before its first touch.
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
        at_rest: int = 0,
    ) -> None:
        self._network, self._noise, self._skin, self._budget_s = network, noise, skin, budget_s
        self._missing, self._filler = missing, filler
        self._keeps, self._made = made is not None, {} if made is None else made
        self._at_rest = at_rest
        self._seen_at_rest: tuple[npt.NDArray[np.float64], int] | None = None
        self.checked: list[Checked[Verdict[UnitTouch]]] = []
        """Verdicts in the order of the cases."""

    @property
    def run(self) -> Run:
        """Return the run that the harness takes."""
        return replace(self._network, solver=self.solve)

    def rest(self, voltages_V: npt.NDArray[np.float64], frames: int) -> None:
        """Take what the shape in use reads while nothing touches it, for its next frame and those after.

        Args:
            voltages_V: (104,) the mean of some frames.
            frames: How many.
        """
        self._seen_at_rest = voltages_V, frames

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
        sheet, setup_ms = self._of(case)
        begin = time.process_time()
        verdict = sheet.verify(
            change, case.flat_reference, starts, self._noise, rows=rows, budget_s=self._budget_s, heights=heights
        )
        asks = sheet.improves
        cpu_ms, begin = 1e3 * (time.process_time() - begin), time.process_time()
        while asks:
            verdict, asks = sheet.improve() or verdict, sheet.improves
            setup_ms, begin = setup_ms + 1e3 * (time.process_time() - begin), time.process_time()
        self.checked.append(Checked(verdict, 1e3 * verdict.seconds, cpu_ms, setup_ms, starts[0]))
        touched = np.zeros(grid.n_units)
        touched[[one.unit for one in verdict.touches]] = 1.0
        return np.asarray(grid.map_from_units(touched), dtype=np.float64)

    def _of(self, case: Case) -> tuple[UnitSheet, float]:
        """Return the sheet of a case's shape, and ms that its models took: 0 for a shape that was seen before."""
        shape, begin = shape_of(case), time.process_time()
        if shape not in self._made:
            found = UnitSheet(case.sheet.cloud_mm, self._skin, clock=time.process_time)
            if self._at_rest:
                self.rest(untouched_mean(case, self._noise, self._at_rest), self._at_rest)
            if not self._keeps:
                self._made.clear()
            self._made[shape] = found
        elif self._seen_at_rest is None:
            return self._made[shape], 0.0
        sheet = self._made[shape]
        if self._seen_at_rest is not None:
            voltages_V, frames = self._seen_at_rest
            sheet.rest(relative_change(voltages_V, case.flat_reference), case.flat_reference, self._noise, frames)
            self._seen_at_rest = None
        return sheet, 1e3 * (time.process_time() - begin)


def shape_of(case: Case) -> bytes:
    """Return what tells one sheet at one shape from another: not its scan alone, which shows no uneven stretch."""
    return case.sheet.cloud_mm.tobytes() + case.sheet.untouched.tobytes()


def untouched_mean(case: Case, noise: Noise, frames: int) -> npt.NDArray[np.float64]:
    """Return (104,) V that a case's sheet reads untouched: the mean of some frames.

    Raises:
        ValueError: The noise is measured.
    """
    untouched = case.sheet.untouched
    if noise.law == "measured":
        raise ValueError("measured frames have no untouched ones beside them; leave --at-rest out")
    rng = np.random.default_rng([SEED, zlib.crc32(untouched.tobytes())])
    every = np.tile(untouched, (frames, 1))
    return np.asarray(add_noise(every, case.flat_reference, noise.law, noise.snr_db, rng).mean(axis=0))


def noise_shown(reference_V: npt.NDArray[np.float64], spread_V: npt.NDArray[np.float64]) -> Noise:
    """Return the noise of a frame, as a reference's frames showed it.

    Args:
        reference_V: (rows,) V.
        spread_V: (rows,) V, standard deviation of a single frame.
    """
    inverse = inverse_reference(reference_V)
    sd = np.clip(spread_V * np.abs(inverse), *SPREADS)
    return Noise("measured", measured=np.where(inverse != 0.0, sd, SPREADS[1]))


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
