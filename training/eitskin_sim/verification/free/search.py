"""The search: from the network's touches, or the last frame's, to touches that physics can explain.

::

    starts -> fit -> explained? -> moves, one after the other, the first that pays is taken -> fit -> ... until
    nothing pays, or the time is over

Where nothing explains a frame, all of it is done once more on a sheet whose material may lie farther from where its
scan shows it, once a deformation: bumps carry material as nothing else does. If that nearly explains it, the frame and
those after it are verified on that sheet.

What is minimised never rises, so more time gives no worse answer; time is looked at before each step of each fit. Where
the fit wants a stretch of the sheet that is too large for a derivative, the model is made again about it, once or twice
a deformation; the next frames of the same deformation have it already.
"""

import time
from collections.abc import Callable
from functools import partial
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_proto.skin.touch_kind import TouchKind
from eitskin_sim.scene.touch_table import Array
from eitskin_sim.verification.chi_squared import LEVEL, p_value
from eitskin_sim.verification.free.effort import Effort
from eitskin_sim.verification.free.fit import Fit, Frame, refine
from eitskin_sim.verification.free.found import FreeVerdict, Likely, degrees_of_freedom, scatter_of, touches_of
from eitskin_sim.verification.free.improve import STEPS, confirmed, fewer, fitted, joined, moved, parted, usually
from eitskin_sim.verification.free.model import Model, model_of_cloud
from eitskin_sim.verification.free.seen import closed, left_out, too_small
from eitskin_sim.verification.free.starts import contrasts_of, followed, presses_of, starts_of
from eitskin_sim.verification.free.usual import usual_of
from eitskin_sim.verification.free.valley import likely
from eitskin_sim.verification.residual import Noise
from eitskin_sim.verification.spreads import Spreads

ANEW: Final = 4
"""Times that a deformation's model is made again, at most."""

BUDGET_S: Final = 2.0
"""What a frame may take; most take a thirtieth of it."""

FEW: Final = 5
"""Derivatives taken on a model that its first frames may show to be off, before that is looked at."""

LOOSER: Final = 4.0
"""Times that material may lie farther, on a sheet that nothing explained."""

NEARLY: Final = 1e-3
"""p from which a looser sheet is gone on with."""

DOUBT: Final = 0.5
"""Share of belief beyond which what contradicts the touches counts."""


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
        self._loose = False
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
        self._anew, self._loose = 0, False

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

        def start() -> tuple[Frame, Fit]:
            return self._start(self._frame(change), rectangles, last, effort)

        trail: list[str] = []
        fit, unfinished = self._search(start, start(), shares, effort, trail)
        fit = joined(fit.frame, fit, shares, effort)
        every = likely(fit.frame, fit, effort)
        self._seen = fit.pieces, rectangles
        drawn_whole = tuple((share, closed(pieces, shares, self._skin.grid)) for share, pieces in every)
        freedom = max(degrees_of_freedom(fit), 1)
        return FreeVerdict(
            touches_of(fit, [pieces for _, pieces in every[1:]]),
            fit.chi_squared,
            freedom,
            p_value(fit.chi_squared, freedom),
            LEVEL,
            effort.fits,
            effort.seconds,
            (),
            fit.pieces,
            tuple(trail),
            unfinished or self._contested(every, shares) > DOUBT,
            drawn_whole,
            scatter_of(fit),
            fit.frame.joints,
        )

    def _search(
        self,
        start: Callable[[], tuple[Frame, Fit]],
        begun: tuple[Frame, Fit],
        shares: Array,
        effort: Effort,
        trail: list[str],
    ) -> tuple[Fit, bool]:
        """Return what explains a frame best, and whether time did not suffice to find or to confirm it.

        Args:
            start: Starts anew, on the model that there is then.
            begun: What it returned.
            shares: The network's.
            effort: Of the frame.
            trail: Moves that are taken are added.
        """
        frame, fit = begun
        if not _explained(fit):
            frame, fit = self._settled(frame, usually(frame, parted(frame, fit, effort), effort), effort)
        while not effort.searched() and not _explained(fit):
            name, better = moved(frame, fit, effort)
            if better is not None:
                frame, fit = self._settled(frame, better, effort)
                trail.append(name)
            if (anew := self._loosened(fit, start, effort)) is not None:
                trail.append("loosen")
                return self._search(start, anew, shares, effort, trail)
            if better is None:
                break
        unfinished = effort.searched() and not _explained(fit)
        fit = usually(frame, parted(frame, fit, effort), effort)
        if trail:
            fit = fewer(frame, fit, effort)
        fit, confirmed_all = confirmed(frame, fit, shares, effort)
        if (anew := self._loosened(fit, start, effort)) is not None:
            trail.append("loosen")
            return self._search(start, anew, shares, effort, trail)
        return fit, unfinished or not confirmed_all

    def _loosened(self, fit: Fit, start: Callable[[], tuple[Frame, Fit]], effort: Effort) -> tuple[Frame, Fit] | None:
        """Return a start on a looser sheet that nearly explains a frame, once a deformation; None leaves the model."""
        if self._loose or _p(fit) > LEVEL or not self._may_be_made(effort):
            return None
        self._loose = True
        model, anew = self._model, self._anew
        assert model is not None
        self._remake(partial(model.looser, LOOSER), effort)
        self._anew = 0
        found = start()
        if _p(found[1]) > max(NEARLY, _p(fit)):
            return found
        self._model, self._anew = model, anew
        return None

    def _may_be_made(self, effort: Effort) -> bool:
        """Return whether a frame has time for another model of its sheet."""
        return not (effort.searched() or (effort.setup_s and effort.over_with_models()))

    def _remake(self, make: Callable[[], Model], effort: Effort) -> None:
        """Make another model of the sheet for a frame."""
        before = self.setup_s
        self._make(make)
        effort.setup_s += self.setup_s - before

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
        for log in contrasts_of(self._usual.log_contrast) if len(rectangles) else ():
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
        while self._anew < ANEW and self._may_be_made(effort):
            model = frame.model
            residual = frame.change - frame.expected - model.seen(fit.solved)
            amplitudes, _ = frame.white.amplitudes(residual)
            if not model.differs(amplitudes):
                break
            self._remake(partial(model.about, amplitudes), effort)
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


def _explained(fit: Fit) -> bool:
    return _p(fit) > 5.0 * LEVEL


def _p(fit: Fit) -> float:
    return p_value(fit.chi_squared, max(degrees_of_freedom(fit), 1))
