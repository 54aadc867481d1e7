"""The search: from the network's touches, or the last frame's, to touches that physics can explain.

::

    starts -> fit -> explained? -> moves, one after the other, the first that pays is taken -> fit -> ... until
    nothing pays, or the time is over

What is minimised never rises, so more time gives no worse answer. Where the fit wants a stretch of the sheet that is
too large for a derivative, the model is made again about it, once or twice a deformation; the next frames of the same
deformation have it already.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_proto.skin.touch_kind import TouchKind
from eitskin_sim.scene.touch_table import Array
from eitskin_sim.shapes.parameters import areas_mm2
from eitskin_sim.verification.chi_squared import LEVEL, p_value
from eitskin_sim.verification.free.fit import Fit, Frame, refine
from eitskin_sim.verification.free.found import FreeTouch, degrees_of_freedom, touches_of
from eitskin_sim.verification.free.model import Model, model_of_cloud
from eitskin_sim.verification.free.moves import Move, moves
from eitskin_sim.verification.free.seen import DECISIVE, left_out, unseen
from eitskin_sim.verification.free.starts import presses_of, starts_of
from eitskin_sim.verification.free.usual import usual_of
from eitskin_sim.verification.residual import Noise
from eitskin_sim.verification.spreads import Spreads
from eitskin_sim.verification.verdict import Verdict

TRUSTED: Final = 0.02
"""Stretch up to which a derivative is good enough."""

ANEW: Final = 4
"""Times that a deformation's model is made again, at most."""

BUDGET_S: Final = 2.0
"""What a frame may take; most take a thirtieth of it."""

ALMOST: Final = 3
"""Derivatives taken of a move before it is judged."""


@dataclass(frozen=True, slots=True)
class FreeVerdict(Verdict[FreeTouch]):
    """One frame, explained by shapes off the unit grid."""

    pieces: Array = field(default_factory=lambda: np.zeros((0, 8)))
    """(n, 8) the touches as a table: the next frame's first start."""
    trail: tuple[str, ...] = ()
    """Which moves were taken."""
    contested: bool = False
    """Whether the network plainly shows a touch that is not among these."""

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
        self._anew = 0
        self._fits = self._shown = 0
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
            budget_s: Time; what is underway is ended.

        Raises:
            ValueError: There is no deformation yet, or no time.
        """
        if self._model is None:
            raise ValueError("no deformation to verify on; give its cloud first")
        if not budget_s > 0.0:
            raise ValueError(f"a budget of {budget_s:g} s: it must be above 0")
        begin, setup = self._clock(), self.setup_s
        change = voltages_V / self._reference - 1.0

        def left() -> float:
            return budget_s - (self._clock() - begin - (self.setup_s - setup))

        self._fits = 0
        rectangles = starts_of(shares, self._skin.grid)
        self._shown = max(len(rectangles), 0 if last is None else len(last))
        frame = self._frame(change)
        frame, fit = self._start(frame, rectangles, last)
        trail: list[str] = []
        while left() > 0.0 and not self._explained(frame, fit):
            name, better = self._moved(frame, fit, left)
            if better is None:
                break
            frame, fit = self._settled(frame, better)
            trail.append(name)
        if left() > 0.0:
            fit = self._usually(frame, fit)
        if trail and left() > 0.0:
            fit = self._fewer(frame, fit)
        fit = self._confirmed(frame, fit, shares)
        freedom = max(degrees_of_freedom(fit), 1)
        seconds = self._clock() - begin - (self.setup_s - setup)
        p = p_value(fit.chi_squared, freedom)
        return FreeVerdict(
            touches_of(fit),
            fit.chi_squared,
            freedom,
            p,
            LEVEL,
            self._fits,
            seconds,
            (),
            fit.pieces,
            tuple(trail),
            left_out(fit.pieces, shares, self._skin.grid),
        )

    def _frame(self, change: Array) -> Frame:
        model = self._model
        assert model is not None
        white = model.whitener(change, self._reference, self._noise)
        return Frame(model, white, change, self._usual, model.expected(model.ratio(change)), self._shown)

    def _start(self, frame: Frame, rectangles: Array, last: Array | None) -> tuple[Frame, Fit]:
        """Return the first start that explains the frame once it is fitted, or the best of them."""
        if self._usual.sign < 0:
            rectangles = presses_of(rectangles, self._usual.border_mm)
        tries: list[Array] = [] if last is None else [last]
        for log in _contrasts(self._usual.log_contrast) if len(rectangles) else ():
            tries.append(rectangles.copy())
            tries[-1][:, 6] = np.exp(log)
        tries.append(np.zeros((0, 8)))
        best = None
        for one in tries:
            frame, fit = self._settled(frame, self._refined(frame, self._at(frame, one, False)))
            if best is None or fit.cost < best.cost:
                best = fit
            if self._explained(frame, best):
                break
        assert best is not None
        return frame, self._at(frame, best.pieces, False)

    def _at(self, frame: Frame, pieces: Array, turning: bool) -> Fit:
        self._fits += 1
        return frame.at(pieces, turning)

    def _refined(self, frame: Frame, fit: Fit, steps: int = 10) -> Fit:
        self._fits += 1
        return refine(frame, fit, steps)

    def _settled(self, frame: Frame, fit: Fit) -> tuple[Frame, Fit]:
        """Return the fit on a model that is made again where the sheet is stretched otherwise by much."""
        while self._anew < ANEW:
            model = frame.model
            residual = frame.change - frame.expected - model.solve(fit.pieces)[1]
            amplitudes, _ = frame.white.amplitudes(residual)
            if np.abs(model.beyond(amplitudes)).max(initial=0.0) < TRUSTED:
                break
            self._make(partial(model.about, amplitudes))
            self._anew += 1
            frame = self._frame(frame.change)
            fit = self._refined(frame, self._at(frame, fit.pieces, fit.turning))
        return frame, fit

    def _fewer(self, frame: Frame, fit: Fit) -> Fit:
        """Return the fit, or one without the smallest of the touches, if that is likelier."""
        for number in np.argsort(areas_mm2(fit.pieces))[:2].tolist() if len(fit.pieces) > 1 else ():
            other = self._without(frame, fit, number)
            if other.cost < fit.cost:
                return other
        return fit

    def _confirmed(self, frame: Frame, fit: Fit, shares: Array) -> Fit:
        """Return the fit without touches that physics alone sees and that explain little."""
        for number in reversed(unseen(fit.pieces, shares, self._skin.grid)):
            other = self._without(frame, fit, number)
            if other.chi_squared - fit.chi_squared < DECISIVE:
                fit = other
        return fit

    def _without(self, frame: Frame, fit: Fit, number: int) -> Fit:
        """Return the fit without one of its touches, the others fitted anew."""
        return self._refined(frame, self._at(frame, np.delete(fit.pieces, number, axis=0), fit.turning))

    def _usually(self, frame: Frame, fit: Fit) -> Fit:
        """Return the fit, or one from touches of usual contrast that are as strong, if that is likelier.

        Size and contrast lie in a long valley, in which steps are short.
        """
        usual = self._usual.log_contrast
        log = np.log(fit.pieces[:, 6])
        if not len(log) or usual * log.mean() <= 0.0 or abs(usual - log.mean()) < 0.5:
            return fit
        pieces = fit.pieces.copy()
        pieces[:, 3:5] *= np.sqrt(np.clip(np.tanh(log / 2.0) / np.tanh(usual / 2.0), 0.3, 3.0))[:, None]
        pieces[:, 6] = np.exp(usual)
        pieces[:, 7] = np.minimum(pieces[:, 7], pieces[:, 3:5].min(axis=1) - 0.01)
        try:
            other = self._refined(frame, self._at(frame, pieces, fit.turning))
        except (ValueError, np.linalg.LinAlgError):
            return fit
        return other if other.cost < fit.cost else fit

    def _explained(self, frame: Frame, fit: Fit) -> bool:
        return p_value(fit.chi_squared, max(degrees_of_freedom(fit), 1)) > 5.0 * LEVEL

    def _moved(self, frame: Frame, fit: Fit, left: Callable[[], float]) -> tuple[str, Fit | None]:
        """Return the move that pays, or none."""
        tried: list[tuple[Fit, Move]] = []
        for move in moves(frame, fit):
            if left() <= 0.0:
                break
            try:
                start = self._at(frame, move[1], move[2])
            except (ValueError, np.linalg.LinAlgError):
                continue
            found = self._refined(frame, start, ALMOST)
            tried.append((found, move))
            if found.cost < fit.cost - 0.3 * (fit.chi_squared - len(fit.residual)) - 10.0:
                break  # a good part of what is unexplained: no need to look at the others
        tried.sort(key=lambda one: one[0].cost)
        for found, move in tried[:2]:
            whole = self._refined(frame, found)
            if whole.cost < fit.cost - 1.0:
                return move[0], whole
        return "", None


def _contrasts(usual: float) -> tuple[float, ...]:
    if usual > 0.0:
        return (usual, np.log(8.0), np.log(2.0))
    return (usual, 2.0 * usual) if usual < 0.0 else (np.log(40.0), np.log(4.0), np.log(0.5))
