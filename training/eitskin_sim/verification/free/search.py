"""The search: from the network's touches, or the last frame's, to touches that physics can explain.

::

    starts -> fit -> explained? -> moves, one after the other, the first that pays is taken -> fit -> ... until
    nothing pays, or the time is over

What is minimised never rises, so more time gives no worse answer; time is looked at before each step of each fit. Where
the fit wants a stretch of the sheet that is too large for a derivative, the model is made again about it, once or twice
a deformation; the next frames of the same deformation have it already.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.skin.grid import Grid
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_proto.skin.touch_kind import TouchKind
from eitskin_sim.scene.touch_table import Array
from eitskin_sim.shapes.parameters import COUNT
from eitskin_sim.verification.chi_squared import LEVEL, p_value
from eitskin_sim.verification.free.effort import Effort
from eitskin_sim.verification.free.fit import Fit, Frame, refine
from eitskin_sim.verification.free.found import FreeTouch, degrees_of_freedom, scatter_of, touches_of
from eitskin_sim.verification.free.improve import STEPS, confirmed, fewer, fitted, joined, moved, parted, usually
from eitskin_sim.verification.free.model import Model, model_of_cloud
from eitskin_sim.verification.free.prior.joints import Joints, bodies
from eitskin_sim.verification.free.seen import closed, left_out, too_small
from eitskin_sim.verification.free.starts import followed, presses_of, starts_of
from eitskin_sim.verification.free.usual import usual_of
from eitskin_sim.verification.free.valley import Likely, drawn, likely
from eitskin_sim.verification.residual import Noise
from eitskin_sim.verification.spreads import Spreads
from eitskin_sim.verification.verdict import Verdict

TRUSTED: Final = 0.02
"""Stretch up to which a derivative is good enough."""

TRUSTED_GAUGE: Final = 0.2
"""Gauge factor up to which it is."""

ANEW: Final = 4
"""Times that a deformation's model is made again, at most."""

BUDGET_S: Final = 2.0
"""What a frame may take; most take a thirtieth of it."""

FEW: Final = 5
"""Derivatives taken on a model that its first frames may show to be off, before that is looked at."""

LIKELY: Final = 2.0
"""Standard deviations, by root mean square, up to which a frame is believed on how the sheet is stretched."""


DOUBT: Final = 0.5
"""Share of belief beyond which what contradicts the touches counts."""


@dataclass(frozen=True, slots=True)
class FreeVerdict(Verdict[FreeTouch]):
    """One frame, explained by shapes off the unit grid."""

    pieces: Array = field(default_factory=lambda: np.zeros((0, 8)))
    """(n, 8) the touches as a table: the next frame's first start."""
    trail: tuple[str, ...] = ()
    """Which moves were taken."""
    contested: bool = False
    """Whether the network plainly shows a touch that is not among these, one is smaller than touches of this skin are,
    or time did not suffice to find or to confirm them."""
    likely: Likely = ()
    """Shares of belief, and touches as they are drawn: ``pieces``, and those of other contrasts that the data allow."""
    scatter: Array = field(default_factory=lambda: np.zeros((0, 0, COUNT)))
    """(k, n, 7) independent ways in which the parameters of ``pieces`` may be off, of one standard deviation each."""
    joints: Joints = ()
    """Which of ``pieces`` hang together, as the network shows them and the frame allows."""

    @property
    def bodies(self) -> int:
        """Return how many touches there are, shapes that hang together counted once."""
        return bodies(len(self.pieces), self.joints)

    def map(self, grid: Grid = PAPER.grid) -> Array:
        """Return the (rows, columns) map: what depends on a contrast that nobody knows is drawn in part."""
        return drawn(self.likely, grid)

    @property
    def flagged(self) -> bool:
        """Whether physics cannot explain the frame by these touches, or the network contradicts them."""
        return self.contested or self.p_value < self.level


class FreeVerifier:
    """Verifies frames of one deformation after another.

    Args:
        reference_V: (104,) flat and untouched, as measured.
        noise: Of a frame.
        touches: Which way this skin's touches change conductance.
        skin: Whose frames.
        spreads: How much may differ between the sheet and its model; None is what the skin says.
        clock: What budgets are counted by, in seconds; ``time.process_time`` on a machine that is shared.
    """

    def __init__(
        self,
        reference_V: Array,
        noise: Noise,
        touches: TouchKind = "raising",
        skin: Skin = PAPER,
        spreads: Spreads | None = None,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        self._reference, self._noise, self._usual = reference_V, noise, usual_of(touches, skin)
        self._clock = clock
        self._skin, self._spreads = skin, spreads
        self._model: Model | None = None
        self._anew = self._shown = 0
        self._seen = (np.zeros((0, 8)), np.zeros((0, 8)))
        self.setup_s = 0.0
        """What the present deformation's models took so far, by the verifier's clock."""
        self.setup_cpu_s = 0.0
        """The same by the processor."""

    def deform(self, cloud_mm: npt.ArrayLike) -> None:
        """Take a scanned deformation for the frames that follow.

        Raises:
            ValueError: The cloud is malformed, or folds in its own plane.
        """
        self.setup_s = self.setup_cpu_s = 0.0
        self._make(lambda: model_of_cloud(cloud_mm, self._skin, self._spreads))
        self._anew = 0

    def _make(self, make: Callable[[], Model]) -> None:
        """Make a model, and count what it takes."""
        clock, processor = self._clock(), time.process_time()
        self._model = make()
        self.setup_s += self._clock() - clock
        self.setup_cpu_s += time.process_time() - processor

    def verify(
        self, voltages_V: Array, shares: Array, last: Array | None = None, budget_s: float = BUDGET_S
    ) -> FreeVerdict:
        """Return the touches that explain a frame best.

        Args:
            voltages_V: (104,) of the frame.
            shares: (n, rows, columns) of the network's map, what each of its touches has of every pixel.
            last: (m, 8) the last frame's, tried first.
            budget_s: Time. What a frame takes longer is one derivative of its touches and one solution with them, and,
                where the frame shows that the sheet is stretched otherwise, one model of it.

        Raises:
            ValueError: There is no deformation yet, or no time; a number is not finite.
        """
        if self._model is None:
            raise ValueError("no deformation to verify on; give its cloud first")
        effort = Effort(budget_s, self._clock)
        _check(voltages_V, shares, self._reference)
        change = voltages_V / self._reference - 1.0
        rectangles = starts_of(shares, self._skin.grid)
        self._shown = max(len(rectangles), 0 if last is None else len(last))
        frame, fit = self._start(self._frame(change), rectangles, last, effort)
        if not _explained(fit):
            frame, fit = self._settled(frame, usually(frame, parted(frame, fit, effort), effort), effort)
        trail: list[str] = []
        while not effort.searched() and not _explained(fit):
            name, better = moved(frame, fit, effort)
            if better is None:
                break
            frame, fit = self._settled(frame, better, effort)
            trail.append(name)
        unfinished = effort.searched() and not _explained(fit)
        fit = usually(frame, parted(frame, fit, effort), effort)
        if trail:
            fit = fewer(frame, fit, effort)
        fit, confirmed_all = confirmed(frame, fit, shares, effort)
        fit = joined(frame, fit, shares, effort)
        every = likely(fit.frame, fit, effort)
        self._seen = fit.pieces, rectangles
        drawn_whole = tuple((share, closed(pieces, shares, self._skin.grid)) for share, pieces in every)
        freedom = max(degrees_of_freedom(fit), 1)
        p = p_value(fit.chi_squared, freedom)
        return FreeVerdict(
            touches_of(fit, [pieces for _, pieces in every[1:]]),
            fit.chi_squared,
            freedom,
            p,
            LEVEL,
            effort.fits,
            effort.seconds,
            (),
            fit.pieces,
            tuple(trail),
            unfinished or not confirmed_all or self._contested(every, shares) > DOUBT,
            drawn_whole,
            scatter_of(fit),
            fit.frame.joints,
        )

    def _contested(self, every: Likely, shares: Array) -> float:
        """Return the share of belief in touches that lack one the network plainly shows, or of which one is too small.

        A gentle touch answers as a hard one that is smaller than any; at its own contrast it has its size.
        """
        grid, least_mm = self._skin.grid, self._skin.touches.size_mm[0]
        return sum(share for share, pieces in every if left_out(pieces, shares, grid) or too_small(pieces, least_mm))

    def _frame(self, change: Array) -> Frame:
        model = self._model
        assert model is not None
        white = model.whitener(change, self._reference, self._noise)
        return Frame(model, white, change, self._usual, model.expected(model.ratio(change)), self._shown)

    def _start(self, frame: Frame, rectangles: Array, last: Array | None, effort: Effort) -> tuple[Frame, Fit]:
        """Return the first start that explains the frame once it is fitted, or the best of them."""
        if self._usual.sign < 0:
            rectangles = presses_of(rectangles, self._usual.border_mm)
        tries: list[Array] = [] if last is None else [followed(last, rectangles, self._before(last))]
        for log in _contrasts(self._usual.log_contrast) if len(rectangles) else ():
            tries.append(rectangles.copy())
            tries[-1][:, 6] = np.exp(log)
        tries.append(np.zeros((0, 8)))
        best = None
        for one in tries:
            steps = STEPS if self._anew else FEW
            frame, fit = self._settled(frame, fitted(frame, one, False, effort, effort.searched, steps), effort)
            if best is not None and best.frame is not frame:
                best = frame.at(best.pieces, False)
            if best is None or fit.cost < best.cost:
                best = fit
            if effort.searched() or _explained(best):
                break
        assert best is not None
        return frame, best

    def _before(self, last: Array) -> Array | None:
        """Return what the network showed of the last frame, if these are its touches."""
        pieces, rectangles = self._seen
        return rectangles if np.array_equal(pieces, last) else None

    def _settled(self, frame: Frame, fit: Fit, effort: Effort) -> tuple[Frame, Fit]:
        """Return the fit on a model that is made again where the sheet is stretched otherwise by much."""
        whole = self._anew > 0
        while self._anew < ANEW and not (effort.searched() or (effort.setup_s and effort.over_with_models())):
            model = frame.model
            residual = frame.change - frame.expected - model.seen(fit.solved)
            amplitudes, _ = frame.white.amplitudes(residual)
            waves, gauge = model.beyond(amplitudes)
            near = np.abs(waves).max(initial=0.0) < TRUSTED and abs(gauge) < TRUSTED_GAUGE
            if near or not _likely(amplitudes, model):
                break
            before = self.setup_s
            self._make(partial(model.about, amplitudes))
            effort.setup_s += self.setup_s - before
            self._anew += 1
            frame = self._frame(frame.change)
            fit = fitted(frame, fit.pieces, fit.turning, effort, effort.searched, FEW)
            whole = False
        return frame, fit if whole else refine(frame, fit, STEPS, effort.searched)


def _check(voltages_V: Array, shares: Array, reference_V: Array) -> None:
    """Raise ValueError if a frame is no frame."""
    if voltages_V.shape != reference_V.shape:
        raise ValueError(f"voltages {voltages_V.shape}: expected {reference_V.shape}, as the reference has")
    for name, values in (("voltages", voltages_V), ("shares of the map", shares), ("the reference", reference_V)):
        wrong = int((~np.isfinite(values)).sum())
        if wrong:
            raise ValueError(f"{name}: {wrong} of {values.size} are not finite; leave out such a frame")
    if not np.all(reference_V):
        raise ValueError(f"the reference: {int((reference_V == 0.0).sum())} rows of 0 V; take one with all rows")


def _likely(amplitudes: Array, model: Model) -> bool:
    """Return whether a sheet may be stretched so: what nonsense asks for spoils the model of the frames after it."""
    own = amplitudes[: len(model.held)]
    return bool(own @ own < LIKELY**2 * len(own))


def _explained(fit: Fit) -> bool:
    return p_value(fit.chi_squared, max(degrees_of_freedom(fit), 1)) > 5.0 * LEVEL


def _contrasts(usual: float) -> tuple[float, ...]:
    if usual > 0.0:
        return (usual, np.log(8.0), np.log(2.0))
    return (usual, 2.0 * usual) if usual < 0.0 else (np.log(40.0), np.log(4.0), np.log(0.5))
