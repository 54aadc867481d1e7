"""Estimates how far the sheet has drifted from its reference. Drying and warmth move every row nearly alike.

Two kinds of drift are removed from the frames. First, a sheet that is known to be untouched is followed from one group
of frames to the next (:mod:`eitskin.health.baseline`), starting from a reference that was captured just now: common
drift, uneven drift and after-effects of presses. Second, where a scan gives the shape, a common factor c of at least
``MIN_COMMON`` is taken from the untouched sheet's Gaussian (:mod:`eitskin.health.untouched`), once the frames have
rested for ``REST_FRAMES`` and if the scan explains the rest to D <= ``MAX_SCAN_D``. Within that bound no touch of 16 to
25 mm with a contrast up to 0.6 or from 2 has a common part of ``MIN_COMMON``, so no scan removes such a touch. Of
fainter touches (0.85 or 1.2) up to 4 % may be mistaken for drift if the bundle's Gaussian allows for random devices.
Otherwise the last estimate stays, and its standard deviation grows as measured on real sheets ::

    frame = (1 + dV) exp(-drift) - 1          drift (104,) in log

A reference from a file says nothing about the sheet since then. So nothing but a common factor is removed until the
sheet has read like the reference or was scanned. Until then the report is the Gaussian's c with its error: half a
percent with a cloud, a tenth without, because a uniform stretch looks just like drift. Before that, and where nothing
explains the frames, the report is the prior for any sheet: zero with the standard deviation ``FILE_PRIOR``. If the gate
calls ``REST_FRAMES`` frames untouched and they still exceed ``UNEVEN_FACTOR`` times the limit of D, the reference is
reported as ``uneven``.
"""

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin.health.baseline import UntouchedBaseline
from eitskin.health.imputation import Array, Consistency
from eitskin.health.untouched import Untouched
from eitskin_proto.sensor.table import N_ROWS

REST_FRAMES: Final = 400
"""Frames at rest before a scan is used or drift is reported from it: two seconds at 200 frames/s."""

MAX_SCAN_D: Final = 0.7
"""D of a scan that explains the sheet; of sheets as modelled nine in ten are below, of touches those of 1 % rms."""

UNEVEN_FACTOR: Final = 2.0
"""Multiple of the limit: one in nine bends of family B, which clouds describe worse than A's, is 1 to 1.7 times the
limit."""

EVENT_SIGMAS: Final = 3.0
"""Drift is an event above this many of its standard deviations, and above ``MIN_COMMON``."""

MIN_COMMON: Final = 0.02
"""Smallest common drift worth an event, and the smallest that is taken over from a scan, in log."""

MIN_UNEVEN: Final = 0.01
"""Smallest uneven drift worth an event: rms, in log."""

COMMON_WALK: Final = 1e-9
"""Variance of common drift a frame: 0.1 % a press and a press in five seconds, at 200 frames/s."""

FILE_PRIOR: Final = 0.1
"""Standard deviation of a sheet's drift since a reference from a file."""

EXPECTED_PERCENT: Final = (0.0, 100.0 * FILE_PRIOR)
"""Drift and its standard deviation before the first frame."""

CAPTURE_PRIOR: Final = 5e-4
"""Standard deviation of drift at the reference."""

FEW_FRAMES: Final = 30
"""Frames of a reference whose spread is not believed below ``USUAL_SPREAD``."""

USUAL_SPREAD: Final = 0.005
"""Relative."""

_ONE: Final = np.ones((), dtype=np.float32)


class Drift:
    """Follows the reference's drift, some frames after others.

    Args:
        consistency: Of the bundle.
        compensate: Whether to correct the frames.
    """

    def __init__(self, consistency: Consistency, *, compensate: bool = True) -> None:
        self._models = Untouched.of(consistency, predicted=False), Untouched.of(consistency, predicted=True)
        self._low_high = (float(consistency.ratio_range[0]) - 1.0, float(consistency.ratio_range[1]) - 1.0)
        self._compensate = compensate
        self.resting = UntouchedBaseline()
        """The untouched sheet's voltages."""
        self._factor = np.ones(N_ROWS, dtype=np.float32)
        self.changes = 0
        """Number of changes of the correction."""
        self._gone = np.zeros(N_ROWS, dtype=np.bool_)
        self._scan = np.zeros(N_ROWS, dtype=np.float32)
        self.percent, self.sigma_percent, self.uneven_percent = *EXPECTED_PERCENT, math.nan
        """How far all voltages are from the reference alike, its standard deviation, and the rms of what is not alike;
        the last is not a number while unknown."""
        self.distance = (self.percent, self.sigma_percent, self.uneven_percent)
        """All three, for a frame."""
        self.restart(np.full(N_ROWS, USUAL_SPREAD), 100)

    def restart(self, sigma: Array, frames: int, *, fresh: bool = False) -> None:
        """Forget everything: there is a new reference.

        Args:
            sigma: (104,) relative standard deviation of its single frames.
            frames: Of which it is the mean.
            fresh: It was taken of the sheet as it is now, not read from a file.
        """
        believed = sigma if frames >= FEW_FRAMES else np.maximum(sigma, USUAL_SPREAD)
        self.resting.start(believed, frames, known=fresh)
        self._followed = fresh
        self._variance = CAPTURE_PRIOR**2 if fresh else FILE_PRIOR**2
        self._scene_variance = CAPTURE_PRIOR**2
        self._fresh_scan = True
        self._strange = 0
        self.uneven = self._told = self._told_uneven = False
        self.active = False
        self.percent, self.sigma_percent, self.uneven_percent = *EXPECTED_PERCENT, math.nan
        self._report()

    def leave_out(self, rows: npt.NDArray[np.bool_]) -> None:
        """Go by the other rows from now on.

        Args:
            rows: (104,) those that are filled in.
        """
        self._gone = rows.copy()
        self.resting.leave_out(rows)

    @property
    def taken_out(self) -> float:
        """The common part of the correction of frames, in log."""
        return self.resting.common if self._compensate and self._followed else 0.0

    @property
    def factors(self) -> npt.NDArray[np.float32] | None:
        """(104,) factors on 1 + dV, a copy; None without a correction."""
        return self._factor.copy() if self.active else None

    def set_factors(self, factors: npt.NDArray[np.float32] | None) -> None:
        """Apply a given correction from the next frame on.

        Args:
            factors: (104,) factors on 1 + dV; None for none.
        """
        before = self.factors
        self.active = factors is not None
        if factors is not None:
            self._factor[:] = factors
        same = before is None if factors is None else before is not None and np.array_equal(before, factors)
        self.changes += not same

    @property
    def known(self) -> bool:
        """Whether the sheet is followed now; else the last estimate stays."""
        return self.resting.known

    def summary(self) -> dict[str, float | bool | None]:
        """Return how far the sheet is from its reference, for a person: numbers in percent, None while unknown."""
        names = ("percent", "sd_percent", "uneven_percent")
        numbers = {name: None if math.isnan(x) else round(x, 3) for name, x in zip(names, self.distance, strict=True)}
        after = round(100.0 * self.resting.after_effect, 2)
        held_frames = self.resting.left
        return {
            **numbers,
            "after_effect_percent": after,
            "followed": self.known,
            "held_frames": held_frames,
            "taken_out": self.active,
        }

    def correct(self, change: npt.NDArray[np.float32]) -> None:
        """Take the drift out of (104,) dV, in place."""
        if self.active:
            np.add(change, _ONE, out=change)
            np.multiply(change, self._factor, out=change)
            np.subtract(change, _ONE, out=change)

    def update(
        self, change: npt.NDArray[np.float32], predicted: npt.NDArray[np.float32], *, touched: bool
    ) -> tuple[str, ...]:
        """Use the evidence of one or several frames, and return events for a frame, mostly none.

        Args:
            change: (104,) or (n, 104) dV before compensation, failed rows filled in.
            predicted: (104,) log(V_pred / V0) of the cloud in use; zeros without one.
            touched: The gate's decision on the frame, or on most of them.
        """
        seen = np.atleast_2d(change)
        frames, resting = len(seen), self.resting
        mean = np.clip(seen.mean(axis=0, dtype=np.float64), *self._low_high)
        if not np.array_equal(predicted, self._scan):
            self._scan, self._fresh_scan, self._strange = predicted.copy(), True, 0
        was_known = resting.known
        resting.add(np.log1p(mean), frames, touched=touched)
        if resting.known:
            self._followed = True
            self._variance = self._scene_variance
        elif self._followed:
            self._variance = (self._scene_variance if was_known else self._variance) + COMMON_WALK * frames
        model = self._models[bool(self._scan.any())]
        more, distance = model.estimate(resting.mean - self._scan - resting.drift)
        rested = resting.steady >= max(REST_FRAMES, resting.span)
        if rested and self._fresh_scan and self._scan.any() and not resting.known:
            self._enter(more, distance, model.sigma, touched=touched)
        self._count_strange(frames, distance, model, touched=touched)
        if not self._followed and rested and distance <= model.limit:
            self.percent, self.sigma_percent = 100.0 * math.expm1(more), 100.0 * model.sigma
        self._report()
        return self._news()

    def _enter(self, more: float, distance: float, sigma: float, *, touched: bool) -> None:
        """Continue from the present sheet if its scan explains it, and adopt its common factor if that is large."""
        clear = abs(more) >= MIN_COMMON
        if distance > MAX_SCAN_D or more**2 > 16.0 * (self._variance + sigma**2) or (touched and not clear):
            return
        if not (clear or self._followed):
            return  # too little to be told from a touch, and nothing before it
        self.resting.enter(more if clear else 0.0)
        self._scene_variance = sigma**2 if clear else min(self._variance, more**2 + sigma**2)
        self._variance, self._followed, self._fresh_scan = self._scene_variance, True, False

    def _count_strange(self, frames: int, distance: float, model: Untouched, *, touched: bool) -> None:
        """Count frames of a scanned shape that fit no untouched sheet although the gate calls them untouched."""
        far = distance > UNEVEN_FACTOR * model.limit and model is self._models[1] and not touched
        self._strange = self._strange + frames if far else 0
        self.uneven = self._strange >= REST_FRAMES
        if self.uneven and not self._followed:
            self.percent, self.sigma_percent = EXPECTED_PERCENT

    def _report(self) -> None:
        """Report the sheet's drift, and make it the correction."""
        resting = self.resting
        if self._followed:
            self.percent, self.sigma_percent = 100.0 * math.expm1(resting.common), 100.0 * math.sqrt(self._variance)
            self.uneven_percent = 100.0 * resting.uneven
        self.distance = self.percent, self.sigma_percent, self.uneven_percent
        if not self._followed:
            return
        drift, before = resting.drift, self._factor.copy()
        self.active = self._compensate and bool(np.abs(drift).max() > 1e-5)
        if self.active:
            drift[self._gone] = resting.common
            np.exp(-drift, out=drift)
            self._factor[:] = drift
            self.changes += not np.array_equal(before, self._factor)

    def _news(self) -> tuple[str, ...]:
        """Return events if drift, or its unevenness, newly exceeds its threshold."""
        told = abs(self.percent) > 100.0 * MIN_COMMON and abs(self.percent) > EVENT_SIGMAS * self.sigma_percent
        self.uneven = self.uneven or self.uneven_percent > 100.0 * MIN_UNEVEN
        events: tuple[str, ...] = ()
        if told and not self._told:
            events = (f"drift:{self.percent:+.0f}%",)
        if self.uneven and not self._told_uneven:
            events += ("drift:uneven",)
        self._told, self._told_uneven = told, self.uneven
        return events
