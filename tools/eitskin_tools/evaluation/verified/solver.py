"""The network's map checked by physics: ``eitskin evaluate --solver verified``.

The search starts from the touches of the network's map, as the stream finds them
(:mod:`eitskin_sim.verification.shape_verifier`). The map is drawn from the shapes that were found, with a share of the
network's own (``NETWORK_SHARE``): the two err in part independently, so both together are nearer to the truth than
either. A map of units is snapped to units (:mod:`eitskin_sim.verification.snapped_units`). If
the verifier cannot explain the frame, or the network shows too many units, the network's own map stays, and the frame
is flagged.

Making the model of a shape, once or twice more where the frame shows that the sheet is stretched otherwise than its
scan, counts as set-up: it serves all frames of the shape. So does seeing it untouched first, where that is asked for.
"""

import time
import zlib
from dataclasses import asdict, dataclass, replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin.touches.moments import TouchFinder
from eitskin_proto.sensor.noise_law import own_sd
from eitskin_proto.sensor.normalise import inverse_reference
from eitskin_proto.skin.familiar_shape import unlike_family
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_proto.skin.touch_kind import TouchKind
from eitskin_sim.evaluation.harness import Case, Results, Run, Sheet
from eitskin_sim.evaluation.metrics import TOUCHED, Score
from eitskin_sim.measurement.noise import add_noise
from eitskin_sim.scene.parts import Phantom
from eitskin_sim.verification.fit import Budget
from eitskin_sim.verification.network_map import shares_of
from eitskin_sim.verification.residual import Noise, Rows
from eitskin_sim.verification.shape_verdict import ShapeVerdict
from eitskin_sim.verification.shape_verifier import BUDGET_S, ShapeVerifier
from eitskin_sim.verification.snapped_units import UnitFrame, UnitVerdict, too_many, unit_shares, unverified
from eitskin_sim.verification.touch_prior import touch_prior
from eitskin_sim.verification.verdict import Verdict

Array = npt.NDArray[np.float64]

SEED: Final = 7041
"""Of the noise of untouched frames."""

NETWORK_SHARE: Final = 0.3
"""Of a verified map; none on a shape unlike those of the training, or where the scan was wrong. Without it presses on
lab devices lose 0.008 of CC, and touches of contrast 2 0.009."""

SPREADS: Final = (1e-5, 0.01)
"""Of a row's voltage: what noise a reference is believed to have shown, as in :mod:`eitskin.model.stillness`."""


class MapVerifier:
    """Verifies maps of one shape of the sheet after another, whatever their labels.

    Args:
        reference_V: (104,) flat and untouched; 0 in rows that every frame leaves out.
        noise: Of a frame.
        labels: Of the maps: "units" or "area".
        touches: Which way touches change conductance.
        skin: Whose models.
        clock: What budgets are counted by, s.
    """

    def __init__(
        self,
        reference_V: Array,
        noise: Noise,
        labels: str,
        touches: TouchKind,
        skin: Skin = PAPER,
        clock: Any = time.perf_counter,
    ) -> None:
        self._reference_V, self._noise, self._labels, self._skin, self._clock = reference_V, noise, labels, skin, clock
        self._prior = touch_prior(touches, skin)
        self._finder = TouchFinder(skin.grid)
        self.shapes = ShapeVerifier(reference_V, noise, touches, skin, clock=clock)

    def refused(self, image: Array) -> str:
        """Return why a (rows, columns) map is not verified; nothing where it is."""
        return too_many(self._shown(image)) if self._labels == "units" else ""

    def verify(
        self, voltages_V: Array, image: Array, budget_s: float, rows: Rows | None = None, frames: int = 1
    ) -> ShapeVerdict | UnitVerdict:
        """Return what explains a frame best: shapes, or units where the map is of units.

        Args:
            voltages_V: (104,) of the frame.
            image: (rows, columns) the network's map.
            budget_s: What the frame may take.
            rows: (104,) which rows the frame has; None is all.
            frames: That it is the mean of.
        """
        budget, grid = Budget(budget_s, self._clock), self._skin.grid
        touches = self._finder.find(image)
        shares = shares_of(touches.pixels, touches.touch, touches.weights, touches.count, grid)
        before_s = self.shapes.deformation.spent_s
        found = self.shapes.verify(voltages_V, shares, budget_s, rows, frames)
        if self._labels != "units":
            return found
        budget.models_s = self.shapes.deformation.spent_s - before_s
        model = self.shapes.deformation.model
        noise = self._noise.of_mean(frames)
        frame = UnitFrame(model, voltages_V, self._reference_V, noise, self._prior, rows)
        return frame.snapped(found, self._shown(image), budget)

    def _shown(self, image: Array) -> npt.NDArray[np.bool_]:
        return unit_shares(image, self._skin.grid) >= TOUCHED


@dataclass(frozen=True, slots=True)
class MapVerdict:
    """One map's verdict, and what it took."""

    verdict: Verdict[Any]
    extra_ms: float
    """Of the verdict."""
    cpu_ms: float
    """The same by the processor."""
    setup_ms: float
    """Making the models of its shape, by the processor."""
    not_verified: str = ""
    """Why there is no verdict; nothing where there is one."""


class VerifiedNetwork:
    """A network and the verifier behind it.

    Args:
        network: The network's run.
        noise: What the instrument's noise is.
        labels: Of the network's maps: "units" or "area".
        touches: Which way touches change conductance.
        skin: Whose models.
        at_rest: Untouched frames of a shape that physics sees before its first touch.
    """

    def __init__(
        self,
        network: Run,
        noise: Noise,
        labels: str,
        touches: TouchKind,
        skin: Skin,
        at_rest: int = 0,
    ) -> None:
        self._network, self._noise, self._labels, self._touches, self._skin = network, noise, labels, touches, skin
        self._at_rest = at_rest
        self.checked: list[MapVerdict] = []
        """Verdicts in the order of the cases."""
        self._shape: tuple[bytes, MapVerifier] | None = None
        self._untouched: tuple[Array, int] | None = None
        self._found: Sheet | None = None
        """The shape in use as physics found it."""

    @property
    def run(self) -> Run:
        """Return the run that the harness takes."""
        return replace(self._network, solver=self.solve)

    def use_untouched(self, voltages_V: Array, frames: int) -> None:
        """Take what the shape in use reads while nothing touches it, for its next frame and those after.

        Args:
            voltages_V: (104,) the mean of some frames.
            frames: How many.
        """
        self._untouched = voltages_V, frames

    def solve(self, case: Case) -> Array:
        """Return the map as physics leaves it; rows whose flat reference is 0 V are left out."""
        return self._solved(case)[0]

    def on_found_shape(self, case: Case) -> Array:
        """Return the network's map with the shape that physics finds in this frame, or found in one before it."""
        return self._solved(case)[1]

    def _solved(self, case: Case) -> tuple[Array, Array]:
        """Return the map as physics leaves it, and the network's."""
        image = self._network.solver(case)
        verifier, setup_s = self._verifier(case)
        if why := verifier.refused(image):
            self.checked.append(MapVerdict(unverified(), 0.0, 0.0, 1e3 * setup_s, why))
            return image, image
        made_s, start = verifier.shapes.deformation.spent_cpu_s, time.process_time()
        rows = case.flat_reference != 0.0
        verdict = verifier.verify(case.voltages, image, BUDGET_S, rows, case.fused)
        made_s = verifier.shapes.deformation.spent_cpu_s - made_s
        cpu_s = time.process_time() - start - made_s
        self.checked.append(MapVerdict(verdict, 1e3 * verdict.seconds, 1e3 * cpu_s, 1e3 * (setup_s + made_s)))
        if (cloud_mm := verifier.shapes.another_cloud()) is not None:
            self._found = Sheet(cloud_mm, case.sheet.untouched, case.sheet.skin)
        shown = image if self._found is None else self._network.solver(replace(case, sheet=self._found))
        if verdict.flagged:
            return shown, shown
        grid = self._skin.grid
        if isinstance(verdict, UnitVerdict):
            touched = np.zeros(grid.n_units)
            touched[[one.unit for one in verdict.touches]] = 1.0
            return np.asarray(grid.map_from_units(touched), dtype=np.float64), shown
        unlike = unlike_family(np.asarray(case.sheet.cloud_mm, dtype=np.float64), self._skin)
        is_wrong_scan = verifier.shapes.is_fitted and self._found is None
        share = 0.0 if unlike or is_wrong_scan else NETWORK_SHARE
        return (1.0 - share) * verdict.map(grid) + share * np.clip(shown, 0.0, 1.0), shown

    def _verifier(self, case: Case) -> tuple[MapVerifier, float]:
        """Return the verifier of a case's shape, and CPU seconds that its models took: 0 for the shape in use."""
        key, spent_s = shape_of(case) + case.flat_reference.tobytes(), 0.0
        if self._shape is None or self._shape[0] != key:
            verifier = MapVerifier(
                case.flat_reference, self._noise, self._labels, self._touches, self._skin, time.process_time
            )
            sheet = case.sheet
            verifier.shapes.deform(sheet.cloud_mm, is_guess=sheet.is_guess, is_certain=sheet.is_certain)
            if self._at_rest:
                self.use_untouched(untouched_mean(case, self._noise, self._at_rest), self._at_rest)
            self._shape, self._found = (key, verifier), None
        else:
            verifier = self._shape[1]
            spent_s = verifier.shapes.deformation.spent_cpu_s
        if self._untouched is not None:
            verifier.shapes.use_untouched(*self._untouched)
            self._untouched = None
        return verifier, verifier.shapes.deformation.spent_cpu_s - spent_s


def shape_of(case: Case) -> bytes:
    """Return what tells one sheet at one shape from another: not its scan alone, which shows no uneven stretch."""
    return case.sheet.cloud_mm.tobytes() + case.sheet.untouched.tobytes()


def untouched_mean(case: Case, noise: Noise, frames: int) -> Array:
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


def noise_shown(reference_V: Array, spread_V: Array, shared_V: Array | None = None) -> Noise:
    """Return the noise of a frame, as a reference's frames showed it.

    Args:
        reference_V: (rows,) V.
        spread_V: (rows,) V, standard deviation of a single frame.
        shared_V: (rows, k) V, the part of it that rows share; None for none.
    """
    inverse = inverse_reference(reference_V)
    if shared_V is None or not shared_V.size:
        sd = np.clip(spread_V * np.abs(inverse), *SPREADS)
        return Noise("measured", measured=np.where(inverse != 0.0, sd, SPREADS[1]))
    sd = np.maximum(own_sd(spread_V, shared_V) * np.abs(inverse), SPREADS[0])
    return Noise("measured", measured=np.where(inverse != 0.0, sd, SPREADS[1]), shared=shared_V * inverse[:, None])


def add_verdicts(found: dict[str, Any], results: Results, checked: dict[int, list[MapVerdict]]) -> None:
    """Add the verifier's verdicts on each phantom, and their totals, to a report.

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
        if why := next((one.not_verified for one in own if one.not_verified), ""):
            row["not_verified"] = why
    found["verified"] = summary_of([(phantom, scores, checked[id(phantom)]) for phantom, scores in results])


def summary_of(every: list[tuple[Phantom, list[Score], list[MapVerdict]]]) -> dict[str, Any]:
    """Return what verdicts come to, over all maps; times and chi-squared of those that were verified."""
    exact = np.array([one.exact for _, scores, _ in every for one in scores]) == 1.0
    all_ = [one for _, _, checked in every for one in checked]
    flagged = np.array([one.verdict.flagged for one in all_])
    verified = [one for one in all_ if not one.not_verified] or all_
    extra, cpu = np.array([one.extra_ms for one in verified]), np.array([one.cpu_ms for one in verified])
    setup = [one.setup_ms for one in all_ if one.setup_ms]
    return {
        "maps": len(all_),
        "not_verified": sum(bool(one.not_verified) for one in all_),
        "exact": float(exact.mean()),
        "flagged": float(flagged.mean()),
        "wrong": int((~exact).sum()),
        "wrong_unflagged": int((~exact & ~flagged).sum()),
        "right_flagged": int((exact & flagged).sum()),
        "extra_ms_median": float(np.median(extra)),
        "extra_ms_p95": float(np.percentile(extra, 95)),
        "cpu_ms_median": float(np.median(cpu)),
        "cpu_ms_p95": float(np.percentile(cpu, 95)),
        "setup_ms_median": float(np.median(setup)),
        "chi_squared_median": float(np.median([one.verdict.chi_squared for one in verified])),
    }
