"""The search: from the network's touches, or the last frame's, to touches that physics can explain.

::

    starts -> fit -> explained? -> moves, one after the other, the first that pays is taken -> fit -> ... until
    nothing pays, or the time is over

Where nothing explains a frame, all of it is done once more on a sheet whose material may lie farther from where its
scan shows it, once a deformation: bumps carry material as nothing else does. If that nearly explains it, the frame and
those after it are verified on that sheet; else it is asked roughly how the sheet is stretched. A sheet that was seen at
rest is known better than by its scan; where nothing explains a frame on it, it has changed since, and its scan is all
there is, as before.

What is minimised never rises, so more time gives no worse answer; time is looked at before each step of each fit. Where
the fit wants a stretch of the sheet that is too large for a derivative, the model is made again about it, once or twice
a deformation; the next frames of the same deformation have it already.
"""

import time
from collections.abc import Callable
from functools import partial
from typing import Final, TypeVar

import numpy as np
import numpy.typing as npt

from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_proto.skin.touch_kind import TouchKind
from eitskin_sim.scene.touch_table import Array
from eitskin_sim.verification.chi_squared import LEVEL
from eitskin_sim.verification.frame import change_of, check_frame
from eitskin_sim.verification.free import improve, two
from eitskin_sim.verification.free.effort import Effort
from eitskin_sim.verification.free.fit import Fit, Frame, on_sheet
from eitskin_sim.verification.free.found import (
    FreeVerdict,
    degrees_of_freedom,
    explained,
    p_of,
    scatter_of,
    touches_of,
)
from eitskin_sim.verification.free.seen import closed
from eitskin_sim.verification.free.starts import followed, starts_of, tries_of
from eitskin_sim.verification.free.usual import usual_of
from eitskin_sim.verification.free.valley import likely
from eitskin_sim.verification.residual import Noise, Rows
from eitskin_sim.verification.sheet.deformation import Deformation
from eitskin_sim.verification.sheet.model import model_of_cloud
from eitskin_sim.verification.sheet.spreads import Spreads

BUDGET_S: Final = 2.0
"""What a frame may take; most take a thirtieth of it."""

NEARLY: Final = 1e-3
"""p from which a looser sheet is gone on with."""

Made = TypeVar("Made")


class FreeVerifier:
    """Verifies frames of one deformation after another.

    Args:
        reference_V: (104,) flat and untouched, as measured; 0 in rows that every frame leaves out.
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
        touches: TouchKind = "raise",
        skin: Skin = PAPER,
        spreads: Spreads | None = None,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        self._rows = reference_V != 0.0
        self._reference = np.where(self._rows, reference_V, np.nan)
        self._noise, self._usual = noise, usual_of(touches, skin)
        self._clock = clock
        self._skin, self._spreads = skin, spreads
        self._shown = 0
        self._seen = (np.zeros((0, 8)), np.zeros((0, 8)))
        self.deformation = Deformation(clock)
        """The present one, with its models and what they took."""

    def deform(self, cloud_mm: npt.ArrayLike) -> None:
        """Take a scanned deformation for the frames that follow.

        Raises:
            ValueError: The cloud is malformed, or folds in its own plane.
        """
        self.deformation.scan(lambda: model_of_cloud(cloud_mm, self._skin, self._spreads))

    def rest(self, voltages_V: Array, frames: int = 1) -> bool:
        """Take what the deformation reads while nothing touches it, for the frames that follow.

        Args:
            voltages_V: (104,) the mean of some frames.
            frames: How many.

        Returns:
            Whether it is the scanned sheet; where it is not, nothing changes.

        Raises:
            ValueError: There is no deformation yet, or no frame; a number is not finite.
        """
        check_frame(voltages_V, self._reference)
        return self.deformation.rest(voltages_V / self._reference - 1.0, self._reference, self._noise.of_mean(frames))

    def verify(
        self,
        voltages_V: Array,
        shares: Array,
        last: Array | None = None,
        budget_s: float = BUDGET_S,
        rows: Rows | None = None,
    ) -> FreeVerdict:
        """Return the touches that explain a frame best.

        Args:
            voltages_V: (104,) of the frame.
            shares: (n, rows, columns) of the network's map, what each of its touches has of every pixel.
            last: (m, 8) the last frame's, tried first.
            budget_s: Time. What a frame takes longer is one derivative of its touches and one solution with them, and,
                where the frame shows that the sheet is stretched otherwise, one model of it.
            rows: (104,) which rows the frame has; None is all. The others are left out, whatever they read.

        Raises:
            ValueError: There is no deformation yet, or no time; a number is not finite.
        """
        effort = Effort(budget_s, self._clock)
        rows = self._rows if rows is None else self._rows & rows
        check_frame(voltages_V, self._reference, shares, rows)
        change = change_of(voltages_V, self._reference, rows)
        rectangles = starts_of(shares, self._skin.grid)
        upright = starts_of(shares, self._skin.grid, turned=False) if rectangles[:, 5].any() else None
        self._shown = max(len(rectangles), 0 if last is None else len(last))

        def start() -> tuple[Frame, Fit]:
            return self._start(self._frame(change, rows), rectangles, upright, last, effort)

        trail: list[str] = []
        fit, unfinished = self._search(start, start(), shares, effort, trail)
        fit = improve.joined(fit.frame, fit, shares, effort)
        every = likely(fit.frame, fit, effort)
        self._seen = fit.pieces, rectangles
        drawn_whole = tuple((share, closed(pieces, shares, self._skin.grid)) for share, pieces in every)
        scatter = scatter_of(fit)
        return FreeVerdict(
            touches_of(fit, scatter, [pieces for _, pieces in every[1:]]),
            fit.chi_squared,
            max(degrees_of_freedom(fit), 1),
            p_of(fit),
            LEVEL,
            effort.fits,
            effort.seconds,
            unfinished,
            fit.pieces,
            tuple(trail),
            drawn_whole,
            scatter,
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
        if not explained(fit):
            usual = improve.usually(frame, two.parted(frame, fit, effort), effort)
            frame, fit = self._settled(frame, usual, effort)
            if (anew := self._loosened(fit, start, effort)) is not None:
                trail.append("loosen")
                return self._search(start, anew, shares, effort, trail)
        unfinished = effort.searched() and not explained(fit)
        fit = improve.usually(frame, two.parted(frame, fit, effort), effort)
        fit, confirmed_all = improve.confirmed(frame, fit, shares, effort)
        fit = two.apart(frame, fit, shares, effort)
        if (anew := self._loosened(fit, start, effort)) is not None:
            trail.append("loosen")
            return self._search(start, anew, shares, effort, trail)
        return fit, unfinished or not confirmed_all

    def _loosened(self, fit: Fit, start: Callable[[], tuple[Frame, Fit]], effort: Effort) -> tuple[Frame, Fit] | None:
        """Return a start on a looser sheet that nearly explains a frame, each once a deformation; None for none."""
        while self.deformation.may_be_looser and p_of(fit) <= LEVEL and self._may_be_made(effort):
            back = self._made(partial(self.deformation.loosen, partial(self._amplitudes, fit)), effort)
            if back is None:
                continue
            found = start()
            if p_of(found[1]) > max(NEARLY, p_of(fit)):
                return found
            back()
        return None

    def _amplitudes(self, fit: Fit, *, rough: bool = True) -> Array:
        """Return amplitudes of all columns that what a fit leaves of a frame speaks for."""
        frame = fit.frame
        left = frame.change - frame.expected - frame.model.seen(fit.solved)
        if rough:
            return frame.model.roughly(frame.change, left, self._reference, self._noise, frame.white.rows)
        return frame.white.amplitudes(left)[0]

    def _may_be_made(self, effort: Effort) -> bool:
        """Return whether a frame has time for another model of its sheet."""
        return not (effort.searched() or (self.deformation.spent_s and effort.over_with_models()))

    def _made(self, make: Callable[[], Made], effort: Effort) -> Made:
        """Make another model of the sheet for a frame."""
        before = self.deformation.spent_s
        found = make()
        effort.setup_s += self.deformation.spent_s - before
        return found

    def _frame(self, change: Array, rows: Rows | None = None) -> Frame:
        model = self.deformation.model
        white = model.whitener(change, self._reference, self._noise, rows=rows)
        return Frame(model, white, change, self._usual, model.expected(model.ratio(change)), self._shown)

    def _start(
        self, frame: Frame, rectangles: Array, upright: Array | None, last: Array | None, effort: Effort
    ) -> tuple[Frame, Fit]:
        """Return the first start that explains the frame once it is fitted, or the best of them."""
        tries = tries_of(rectangles, upright, self._usual)
        if last is not None:
            tries.insert(0, on_sheet(followed(last, rectangles, self._before(last)), self._skin))
        tries.append(np.zeros((0, 8)))
        best = None
        for one in tries:
            found = improve.fitted(frame, one, bool(one[:, 5].any()), effort, effort.searched)
            frame, fit = self._settled(frame, found, effort)
            if best is not None and best.frame is not frame:
                best = frame.at(best.pieces, best.turning)
            if best is None or fit.cost < best.cost:
                best = fit
            if effort.searched() or explained(best):
                break
        assert best is not None
        return frame, best

    def _before(self, last: Array) -> Array | None:
        """Return what the network showed of the last frame, if these are its touches."""
        pieces, rectangles = self._seen
        return rectangles if np.array_equal(pieces, last) else None

    def _settled(self, frame: Frame, fit: Fit, effort: Effort) -> tuple[Frame, Fit]:
        """Return the fit on a model that is made again where the sheet is stretched otherwise by much."""
        while self.deformation.may_be_made_anew and self._may_be_made(effort):
            model = frame.model
            amplitudes = self._amplitudes(fit, rough=self.deformation.is_rough)
            if not model.differs(amplitudes):
                break
            self._made(partial(self.deformation.make_anew, amplitudes), effort)
            frame = self._frame(frame.change, frame.white.rows)
            fit = improve.fitted(frame, fit.pieces, fit.turning, effort, effort.searched)
        return frame, fit
