"""The verified solver on recorded frames: ``eitskin reinfer --solver verified``.

The search starts from the network's map of each touched frame, as in ``eitskin evaluate --solver verified``. The frame
is the network's input: relative to the recorded reference, corrected for drift; filled-in rows are ignored. The noise
is that of the reference's frames, as for ``eitskin run --verify``.
"""

import math
from collections import Counter
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from eitskin.model.bundle import Bundle
from eitskin.reference.captured import Reference
from eitskin_proto.sensor.table import N_ROWS
from eitskin_proto.wire.volts import step_of
from eitskin_sim.evaluation.harness import Case, Run, Sheet
from eitskin_sim.scene.family import is_family
from eitskin_tools.evaluation.verified.solver import MapVerdict, VerifiedNetwork, noise_shown
from eitskin_tools.evaluation.verified.untouched_baseline import BASELINE_FRAMES, UntouchedBaseline
from eitskin_tools.recording.reinfer import NO_SOLVER, ComputedFrame, Rerun
from eitskin_tools.recording.script import Script, Step, reference_of

NETWORK: Final = "vd2t"
"""Whose map physics starts from."""

WITHOUT_NETWORK: Final = "l1"
"""Whose it is in a bundle of ``eitskin build --physics``."""


class VerifiedSolver:
    """A bundle's network, or l1, and the verifier behind it.

    Args:
        script: The recording.
        bundle: Has the network, or l1.

    Raises:
        ValueError: It has neither.
    """

    def __init__(self, script: Script, bundle: Bundle) -> None:
        self._script, self._bundle = script, bundle
        self._rerun = Rerun(script, bundle, NETWORK if bundle.has_network else WITHOUT_NETWORK)
        self.bundle_id = bundle.id
        self._judged: list[MapVerdict] = []
        self._not_verified = Counter[str]()
        self._reference: Reference | None = None
        self._sheet: Sheet | None = None
        self._verified: VerifiedNetwork | None = None
        self._image: npt.NDArray[np.float64] = np.zeros(bundle.skin.grid.shape)
        self._fits = False
        self._unfit = ""
        self._baseline = UntouchedBaseline()
        self._at_rest_V: npt.NDArray[np.float64] | None = None

    @property
    def verified(self) -> dict[str, Any]:
        """What the verdicts so far come to; None where no frame was verified."""
        some, ms = bool(self._judged), np.array([one.extra_ms for one in self._judged])
        return {
            "frames": len(self._judged),
            "flagged_share": float(np.mean([one.verdict.flagged for one in self._judged])) if some else None,
            "p_value_median": float(np.median([one.verdict.p_value for one in self._judged])) if some else None,
            "ms_median": round(float(np.median(ms)), 3) if some else None,
            "ms_p95": round(float(np.percentile(ms, 95)), 3) if some else None,
            "not_verified": dict(self._not_verified),
        }

    def compute(self, step: Step) -> ComputedFrame | None:
        """Compute a frame; None if the recording lacks its reference, or nothing verifies it."""
        skin = self._bundle.skin
        if step.reference is not None:
            self._reference = reference_of(self._script, step.reference, skin).flat()
        if step.cloud is not None:
            is_guess = step.cloud.why != "given" and is_family(skin.deformations)
            self._sheet = Sheet(step.cloud.cloud.astype(np.float64), np.full(N_ROWS, np.nan), skin, is_guess)
        if self._reference is not None and not (step.reference is None and step.cloud is None):
            self._begin(self._reference)
        found = self._rerun.compute(step)
        if found is None or self._reference is None or self._sheet is None:
            return None
        if found.solver == NO_SOLVER:
            self._rest(found, self._reference)
            return found
        self._baseline.reset()
        return self._checked(found, self._reference, self._sheet)

    def _begin(self, reference: Reference) -> None:
        """Begin with another surface or reference."""
        self._verified = self._at_rest_V = None
        step_V = step_of(self._script.hello)
        self._baseline.start(reference.voltages_V, reference.spread_V, reference.frames, step_V, reference.shared_V)

    def _missing(self, reference: Reference) -> npt.NDArray[np.bool_]:
        """Return (104,) rows that are not looked at."""
        missing = self._rerun.missing.copy()
        missing[reference.weak] = True
        return missing

    def _rest(self, found: ComputedFrame, reference: Reference) -> None:
        """Take an untouched frame, and tell physics what the sheet reads then, where that is news."""
        if found.touched:
            self._baseline.reset()
        if found.touched or found.gate_logit is None or self._missing(reference).any():
            return
        if (mean := self._baseline.add(self._rerun.change)) is not None:
            self._at_rest_V = reference.voltages_V * (1.0 + mean)
            self._tell_rest()

    def _tell_rest(self) -> None:
        if self._at_rest_V is not None and self._verified is not None:
            self._verified.use_untouched(self._at_rest_V, BASELINE_FRAMES)

    def _checked(self, found: ComputedFrame, reference: Reference, sheet: Sheet) -> ComputedFrame | None:
        """Return the network's map as physics leaves it; None, and counted, where there is no verdict."""
        if self._verified is None:
            self._verified, self._fits, self._unfit = self._of(reference), False, ""
            self._tell_rest()
        missing = self._missing(reference)
        if self._unfit:
            self._not_verified[self._unfit] += 1
            return None
        flat_V = np.where(missing, 0.0, reference.voltages_V)  # a row of 0 V is not looked at
        volts = flat_V * (1.0 + self._rerun.change.astype(np.float64))
        labels: Any = "units" if self._bundle.labels == "units" else "area"
        case = Case(
            volts, flat_V, flat_V, sheet, labels, lowering=self._bundle.touch_kind == "lower", fused=found.fused
        )
        self._image = found.map.astype(np.float64)
        try:
            image = self._verified.solve(case)
        except (ValueError, ArithmeticError) as error:
            if not self._fits:  # not one frame of this shape: it is the shape's own fault
                self._unfit = f"no model can be made of cloud and reference: {error}"
            self._not_verified[self._unfit or str(error)] += 1
            return None
        self._fits = True
        checked = self._verified.checked.pop()
        if checked.not_verified:
            self._not_verified[checked.not_verified] += 1
            return None
        self._judged.append(checked)
        return ComputedFrame(np.asarray(image, dtype=np.float32), True, "verified", found.gate_logit, checked)

    def _of(self, reference: Reference) -> VerifiedNetwork:
        """Return the solver of a reference's frames."""
        bundle, step_V = self._bundle, step_of(self._script.hello)
        spread_V = np.hypot(reference.spread_V, step_V / math.sqrt(12.0))
        noise = noise_shown(reference.voltages_V, spread_V, reference.shared_V)
        network = Run(lambda case: self._image, "pre")
        return VerifiedNetwork(network, noise, bundle.labels, bundle.touch_kind, bundle.skin)
