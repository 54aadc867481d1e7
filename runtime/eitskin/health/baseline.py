"""Estimates the untouched sheet's voltages, updated after each group of frames.

A single frame cannot distinguish a common factor from a touch: a touch moves every row, and its common part is up to
0.7 of its rms. But a touch never moves all rows *alike*: the uneven part of each tested touch, on the flat and on bent
sheets, is at least its common part (1.05 times; ``tests/runtime/health/test_drift_and_touches.py``). So let d = l - b
be the change of the mean of some frames against the untouched sheet::

    c = sum w d        e = d - c        still:  chi2(e) <= MAX_CHI2,  or  rms(e) <= MAX_UNEVEN_RATIO |c|  and small

A sheet that was untouched and has been still ever since is untouched. If rms(e) <= MAX_UNEVEN_RATIO |c|, b follows the
common change at once, and the rest of d with a time constant of ``UNEVEN_FRAMES`` frames, so that a touch which
develops within minutes is seen before it is learned. Any other change, a touch or a bend, ends the untouched state: b
stays, for hours if need be, until the sheet is still against b again. A press leaves behind a small share of its own
pattern p, which no touch elsewhere resembles::

    d = c + k p + e,   |k| <= AFTER_EFFECT,   the gate says untouched
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.sensor.table import N_ROWS

Array = npt.NDArray[np.float64]

MAX_UNEVEN_RATIO: Final = 0.25
"""Largest ratio of the uneven to the common part of a change without touch: a quarter of that of touches."""

MAX_CHI2: Final = 1.0 + 5.0 * np.sqrt(2.0 / N_ROWS)
"""Mean square of e over its noise: five standard deviations above 1."""

MEAN_NOISE: Final = 0.0005
"""Relative noise that the running mean of the last looks is to have, so that a touch of ten times that is seen."""

MIN_FRAMES: Final = 180
MAX_FRAMES: Final = 10_000
"""Frames that the running mean is of, at least and at most: one second at 200 frames/s, and 50."""

UNEVEN_FRAMES: Final = 2000.0
"""Frames in which a still sheet's uneven part is followed, at least: ten seconds at 200 frames/s."""

AFTER_EFFECT: Final = 0.08
"""Share of a press that may stay behind: twice that of real sheets (3 to 4 %)."""

UNEVEN_STEP: Final = 0.0007
"""Rms of the uneven part of drift from before a press to after it, as measured on real sheets."""

UNEVEN_WALK: Final = 2e-10
"""Additional variance a frame: a fifth of the common part's."""

MAX_UNEVEN: Final = 0.002
"""Rms by which a sheet may come back unlike itself: less than half of the weakest touch that must stay one."""

MAX_DIFFERENCE_AT_RETURN: Final = 0.2
"""Share of the farthest it was that it may be unlike itself then: what creeps away has not come back."""

CREEP_WALK: Final = 2e-11
"""Variance a frame by which it may be unlike itself all the same, after it left without ever having been far."""

MAX_CREEP: Final = 0.001
"""Rms of that: a quarter of the uneven part of the weakest touch that must stay one."""

LEAST_SIGMA: Final = 1e-4
"""Relative noise that is believed in a single frame: rounding, and a reference that is itself a mean."""

EVEN_SIGMA: Final = 0.01
"""Noise below which a row weighs no more: a common factor is looked for in all rows."""


@dataclass(frozen=True, slots=True, eq=False)
class Split:
    """A change of all rows, taken apart."""

    common: float
    rest: Array
    """(104,) e."""
    chi: float
    """Mean square of e over its noise."""
    rms: float
    """Of e, weighted."""
    noise: float
    """``rms`` of noise alone."""

    @property
    def still(self) -> bool:
        """Whether no touch did it, as far as noise lets one see."""
        return self.chi <= MAX_CHI2 or self.even

    @property
    def even(self) -> bool:
        """Whether it is so even that neither a touch nor a bend did it, noise or not."""
        return bool(self.rms <= min(MAX_UNEVEN_RATIO * abs(self.common), MAX_CHI2 * self.noise + MAX_UNEVEN))


class UntouchedBaseline:
    """Follows the untouched sheet.

    Attributes:
        known: Whether the sheet has been untouched and still since that was last certain.
        after_effect: Share of the last press that stayed behind; 0 before the first.
        left: Frames since the sheet was known to be untouched.
        span: Frames that the running mean is of, at rest.
        steady: Frames in a row that were like the ones before, touched or not.
        base: (104,) log(V / V0) of the untouched sheet in its present shape.
        scene: (104,) part of ``base`` that the sheet's shape causes.
    """

    def __init__(self) -> None:
        self.start(np.full(N_ROWS, LEAST_SIGMA), 1, known=False)

    def start(self, sigma: Array, frames: int, *, known: bool) -> None:
        """Begin with a sheet that equals its reference.

        Args:
            sigma: (104,) relative standard deviation of a single frame's rows.
            frames: Of which the reference is the mean.
            known: It was taken just now, of this sheet; else the sheet may have changed since.
        """
        self._variance = np.maximum(sigma, LEAST_SIGMA) ** 2
        self.base, self.scene = np.zeros(N_ROWS), np.zeros(N_ROWS)
        self._base_share = 1.0 / frames
        self._slow, self._slow_share = np.zeros(N_ROWS), 0.0
        self._press = self._peak = np.zeros(N_ROWS)
        self.known = self._known_once = known
        self.left, self.after_effect = 0, 0.0
        self.steady = 0
        noise = float(np.sqrt(np.mean(np.minimum(self._variance, EVEN_SIGMA**2 * 9))))
        self.span = int(np.clip((noise / MEAN_NOISE) ** 2, MIN_FRAMES, MAX_FRAMES))
        self._used, self._new = np.ones(N_ROWS, dtype=np.bool_), np.zeros(N_ROWS, dtype=np.bool_)
        self._weigh()

    def leave_out(self, rows: npt.NDArray[np.bool_]) -> None:
        """Go by the other rows; those that are filled in from them say nothing of their own.

        Rows that are used again have to be learned first, while nothing touches the sheet.
        """
        self._new = (self._new | ~self._used) & ~rows
        self._used = ~(rows | self._new)
        self._slow_share, self.steady = 0.0, 0
        self._weigh()

    def _weigh(self) -> None:
        weights = np.where(self._used, 1.0 / np.maximum(self._variance, EVEN_SIGMA**2), 0.0)
        self._weights = weights / max(float(weights.sum()), 1e-300)
        self._noise = float(self._weights @ self._variance) ** 0.5
        self._chi_weights = np.where(self._used, 1.0 / self._variance, 0.0) / max(int(self._used.sum()), 1)

    @property
    def drift(self) -> Array:
        """(104,) change of the untouched sheet since the reference, without that of its shape."""
        return np.asarray(self.base - self.scene)

    @property
    def common(self) -> float:
        """The common part of ``drift``."""
        return float(self._weights @ self.drift)

    @property
    def uneven(self) -> float:
        """Rms of the rest."""
        rest = self.drift - self.common
        return float(np.sqrt(self._weights @ (rest * rest)))

    @property
    def mean(self) -> Array:
        """(104,) l, the running mean of the last looks."""
        return self._slow

    def split(self, change: Array, share: float) -> Split:
        """Take a (104,) change apart.

        Args:
            change: Of l.
            share: Its variance over that of a single frame.
        """
        common = float(self._weights @ change)
        rest = change - common
        square = rest * rest
        chi, rms = float(self._chi_weights @ square) / share, float(self._weights @ square) ** 0.5
        return Split(common, rest, chi, rms, self._noise * share**0.5)

    def add(self, logs: Array, frames: int, *, touched: bool) -> None:
        """Take the next look.

        Args:
            logs: (104,) l of the mean of some frames.
            frames: How many.
            touched: The gate's decision on most of them.
        """
        share = 1.0 / frames
        self._average(logs, share, frames)
        if not self.known:
            self.left += frames
            self._come_back(logs, touched=touched)
            return
        now = self.split(logs - self.base, share + self._base_share)
        long = self.split(self._slow - self.base, self._slow_share + self._base_share)
        if now.still and long.still:
            if not touched:
                self._follow(long, frames)
        elif touched or not self._is_after_effect(logs - self.base, share + self._base_share, self._press):
            self.known, self.left, self._peak = False, frames, logs - self.base
            self._slow, self._slow_share, self.steady = logs.copy(), share, 0  # what came before says nothing now

    def enter(self, common: float) -> None:
        """Accept the present sheet as untouched, because a scan says so.

        Args:
            common: Its common drift, in log.
        """
        drift = self.drift + common
        self.base = self._slow.copy()
        self.scene = self.base - drift
        self._base_share = self._slow_share
        self._press = np.zeros(N_ROWS)
        self._know()

    def _average(self, logs: Array, share: float, frames: int) -> None:
        """Add a group of frames to the running mean, which restarts whenever the sheet moves."""
        if self._slow_share and self.split(logs - self._slow, share + self._slow_share).still:
            part = max(2.0 * frames / (self.span + frames), self._slow_share / (self._slow_share + share))
            self._slow = self._slow + part * (logs - self._slow)
            self._slow_share = (1.0 - part) ** 2 * self._slow_share + part**2 * share
            self.steady += frames
        else:
            self._slow, self._slow_share, self.steady = logs.copy(), share, 0

    def _follow(self, long: Split, frames: int) -> None:
        """Adopt the running mean as the untouched sheet, its common part at once."""
        if long.even:
            self.base = self.base + long.common
        part = min(frames / max(UNEVEN_FRAMES, 8.0 * self.span), 1.0)
        self.base = self.base + part * (self._slow - self.base)
        if self._new.any() and self.steady >= self.span:
            self.base[self._new] = self._slow[self._new]
            self._used, self._new = self._used | self._new, np.zeros(N_ROWS, dtype=np.bool_)
            self._weigh()
        self._base_share += (1.0 - (1.0 - part) ** 2) * (self._slow_share - self._base_share)

    def _come_back(self, logs: Array, *, touched: bool) -> None:
        """Recognise the sheet that has returned to its earlier state, except for drift and the press's after-effect."""
        change = logs - self.base
        if self._square(change) > self._square(self._peak):
            self._peak = change
        if self.steady < self.span:
            return
        share = self._slow_share + self._base_share
        now = self.split(self._slow - self.base, share)
        allowed = MAX_UNEVEN**2
        if self._known_once:
            allowed = min(UNEVEN_STEP**2 + UNEVEN_WALK * self.left, allowed)
        returned = min(allowed, MAX_DIFFERENCE_AT_RETURN**2 * self._square(self._peak))
        crept = min(CREEP_WALK * self.left, MAX_CREEP**2)
        press = max(self._press, self._peak, key=self._square)
        if now.chi <= MAX_CHI2:  # an even change proves nothing here: drift adds up while the sheet is touched
            self.base = self.base + now.common
        elif touched:
            return
        elif now.rms**2 <= now.noise**2 + max(returned, crept):
            self.base, self._base_share = self._slow.copy(), self._slow_share
        elif not self._is_after_effect(self._slow - self.base, share, press):
            return
        self._know()

    def _know(self) -> None:
        self.known = self._known_once = True
        self.left = 0

    def _square(self, values: Array) -> float:
        return float(self._weights @ (values * values))

    def _is_after_effect(self, change: Array, share: float, press: Array) -> bool:
        """Adopt a press's after-effect, d = c + k p + e, and return whether it explains the whole change."""
        pattern = press - float(self._weights @ press)
        size = self._square(pattern)
        if not size:
            return False
        part = float(self._weights @ (pattern * change)) / size
        found = self.split(change - part * press, share)
        if abs(part) > AFTER_EFFECT or not found.still:
            return False
        self.base = self.base + found.common + part * press
        self.after_effect = part + (self.after_effect if press is self._press else 0.0)
        self._press = press
        return True
