"""Touched units on one deformation after another, each with the models that its frames ask for.

The model is first that of the scan. A frame may show that the sheet is stretched otherwise, or conducts otherwise where
it is stretched: the model is then made again about that. While no frame of a deformation was explained, just what
the network shows is tried on such sheets first: it is right more often than what a search finds on another sheet.
A frame that nothing explains asks for looser material, and roughly how the sheet conducts. Another model is kept where
it explains that frame better, by touches that the network shows, or surely: another sheet nearly explains some wrong
touches, too. As long as it has explained no frame, those after it that it does not explain are tried on the one before.
Frames of the untouched sheet say most, and are believed alone.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_sim.reduced.exact import exact_sheet
from eitskin_sim.reduced.model import ReducedModel, cloud_digest, rows_of
from eitskin_sim.reduced.quick import quick_model
from eitskin_sim.scene.nominal import flat_metric_of
from eitskin_sim.verification.asked import SPARED, Asked, UnitVerdict, better
from eitskin_sim.verification.residual import Array, Noise, Rows
from eitskin_sim.verification.sheet.deformation import Deformation
from eitskin_sim.verification.sheet.model import Model, model_of_cloud
from eitskin_sim.verification.sheet.spreads import Spreads
from eitskin_sim.verification.units import UnitTouch, UnitVerifier

ROUNDS: Final = 3
"""Times that other sheets are tried again while no frame of a shape was explained: the first may show nonsense."""

SHARES: Final = (1.0, 0.5)
"""Of the way to the sheet that a frame speaks for: far from it derivatives say too much."""


class UnitSheet:
    """Verifies frames of one deformation after another.

    Args:
        cloud_mm: (3, rows, columns) mm, of the first deformation.
        skin: Whose frames.
        spreads: How much may differ between the sheet and its model; None is what the skin says.
        clock: What budgets are counted by, in seconds; ``time.process_time`` on a machine that is shared.

    Raises:
        ValueError: The cloud is malformed, or folds in its own plane.
    """

    def __init__(
        self,
        cloud_mm: npt.ArrayLike,
        skin: Skin = PAPER,
        spreads: Spreads | None = None,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        self._skin, self._spreads, self._clock = skin, spreads, clock
        self._verifier: UnitVerifier
        self._proven: UnitVerifier  # of the last model that explained a frame, or of the first
        self._backs: list[Callable[[], None]]  # what brings back the models since then, one after another
        self._doubts: bool  # whether the last frame is to be tried on it
        self._last: tuple[Asked, UnitVerdict] | None
        self._refused: bool  # whether a model that the last frame asked for was not kept
        self._unexplained: bool  # whether no frame was explained yet
        self._rounds: int  # how often other sheets were tried again
        self._tried: int  # frames whose touches, as the network shows them, no sheet explained
        self._asked_network: bool  # whether that was tried of the last frame
        self._deformation = Deformation(clock)
        self.deform(cloud_mm)

    def deform(self, cloud_mm: npt.ArrayLike) -> None:
        """Take another scanned deformation for the frames that follow.

        Raises:
            ValueError: The cloud is malformed, or folds in its own plane.
        """
        self._digest = cloud_digest(np.asarray(cloud_mm))
        self._deformation.scan(lambda: model_of_cloud(cloud_mm, self._skin, self._spreads))
        self._begin()

    def rest(self, change: Array, reference: Array, noise: Noise, frames: int = 1) -> bool:
        """Take what the deformation reads while nothing touches it, for the frames that follow.

        Args:
            change: (104,) dV, the mean of some frames.
            reference: (104,) V of the flat, untouched sheet.
            noise: Of one of them.
            frames: How many.

        Returns:
            Whether it is the scanned sheet; where it is not, nothing changes.

        Raises:
            ValueError: There is no frame.
        """
        known = self._deformation.rest(change, reference, noise.of_mean(frames))
        if known:
            self._begin(at_rest=True)
        return known

    def verify(
        self,
        change: Array,
        reference: Array,
        starts: Sequence[npt.NDArray[np.bool_]],
        noise: Noise,
        *,
        rows: Rows | None = None,
        budget_s: float | None = None,
        before: Sequence[UnitTouch] = (),
        heights: Array | None = None,
    ) -> UnitVerdict:
        """Return the set of touched units that explains a frame best.

        Arguments and what is raised are those of :meth:`eitskin_sim.verification.units.UnitVerifier.verify`.
        """
        asked = Asked(change, reference, starts, noise, rows, budget_s, before, heights)
        if self._unexplained and self._rounds < ROUNDS and not self._deformation.may_be_looser:
            self._rounds += 1
            self._deformation.ask_again()
        return self._take(asked, self._verified(self._verifier, asked))

    @property
    def improves(self) -> bool:
        """Whether the last frame asks for another model."""
        return self._doubts or self._asks_the_network() or self._next() is not None

    def improve(self) -> UnitVerdict | None:
        """Make the model that the last frame asks for, and return that frame's verdict by it where it is kept."""
        if self._doubts and (found := self._returned()) is not None:
            return found
        if self._asks_the_network() and (found := self._by_the_network()) is not None:
            return found
        make = self._next()
        if make is None or self._last is None:
            return None
        (asked, before), verifier = self._last, self._verifier
        if (back := make()) is None:
            return None
        try:
            self._verifier = self._made()
            again = self._verified(self._verifier, replace(asked, before=before.touches))
        except (ValueError, np.linalg.LinAlgError):  # no sheet is so
            again = None
        if again is None or not better(again, before, shown=asked.shown(again)):
            back()
            self._verifier, self._refused = verifier, True
            return None
        self._backs.append(back)
        self._take(asked, again)
        self._doubts = False
        return again

    def _asks_the_network(self) -> bool:
        """Return whether what the network shows of the last frame is to be tried on other sheets."""
        if not self._unexplained or self._asked_network or self._tried > ROUNDS or self._last is None:
            return False
        asked, verdict = self._last
        return verdict.flagged and len(asked.starts) > 0 and self._deformation.may_be_made_anew

    def _by_the_network(self) -> UnitVerdict | None:
        """Return the last frame's verdict with just what the network shows, where a likely sheet explains that.

        Else all is as it was before.
        """
        assert self._last is not None
        last, verifier, back, self._asked_network = self._last, self._verifier, self._deformation.as_now(), True
        only = replace(last[0], budget_s=0.0, before=())
        verdict = self._verified(verifier, only)
        while verdict.flagged and self._deformation.may_be_made_anew:
            self._last = only, verdict
            if (found := self._step(only, verdict)) is None:
                break
            verdict = found
        if not verdict.flagged:
            return self._take(last[0], verdict)
        back()
        self._last, self._verifier, self._tried = last, verifier, self._tried + 1
        return None

    def _step(self, asked: Asked, before: UnitVerdict) -> UnitVerdict | None:
        """Go to a sheet that the last frame speaks for, or part of the way; None where that explains it no better."""
        model, amplitudes = self._deformation.model, self._amplitudes(False)
        if not model.differs(amplitudes):
            amplitudes = self._amplitudes(True)
        for share in SHARES if (likely := model.likely_share(amplitudes)) else ():
            here, back = self._verifier, self._deformation.as_now()
            self._deformation.make_anew(amplitudes, share * likely)
            try:
                self._verifier = self._made()
                if (found := self._verified(self._verifier, asked)).chi_squared < SPARED * before.chi_squared:
                    return found
            except (ValueError, np.linalg.LinAlgError):  # no sheet is so
                pass
            back()
            self._verifier = here
        return None

    def _begin(self, *, at_rest: bool = False) -> None:
        """Begin with the model in use."""
        self._verifier = self._proven = self._made()
        self._backs, self._doubts, self._last, self._refused = [], False, None, False
        self._unexplained, self._rounds, self._tried, self._asked_network = not at_rest, 0, 0, False

    def _take(self, asked: Asked, verdict: UnitVerdict) -> UnitVerdict:
        """Take what the model in use says of a frame: one that it explains proves it, and another raises doubts."""
        if not verdict.flagged:
            self._proven, self._backs, self._unexplained = self._verifier, [], False
        self._doubts = bool(self._backs)
        self._last, self._refused, self._asked_network = (asked, verdict), False, False
        return verdict

    def _returned(self) -> UnitVerdict | None:
        """Return to the last model that explained a frame where it explains this one better, and its verdict."""
        assert self._last is not None
        self._doubts, (asked, before) = False, self._last
        again = self._verified(self._proven, asked)
        if again.chi_squared >= before.chi_squared:
            return None
        for back in reversed(self._backs):
            back()
        self._verifier, self._backs = self._proven, []
        return self._take(asked, again)

    def _next(self) -> Callable[[], Callable[[], None] | None] | None:
        """Return what makes the model that the last frame asks for, and returns what brings back the one before."""
        if self._last is None:
            return None
        deformation, (_, verdict) = self._deformation, self._last
        if deformation.may_be_made_anew and not self._refused:
            amplitudes = self._amplitudes(deformation.is_rough)
            if deformation.model.differs(amplitudes):
                return partial(deformation.make_anew, amplitudes)
        if verdict.flagged and deformation.may_be_looser:
            return partial(deformation.loosen, partial(self._amplitudes, True))
        return None

    def _amplitudes(self, rough: bool) -> Array:
        """Return amplitudes of all columns that what is left of the last frame speaks for.

        Touches that the network does not show, where nothing explains a frame, were put in to explain the sheet.
        """
        assert self._last is not None
        asked, verdict = self._last
        touches = verdict.touches
        if rough and verdict.flagged and len(asked.starts):
            shown = np.any(asked.starts, axis=0)
            touches = tuple(one for one in touches if shown[one.unit])
        frame, left = self._verifier.left(asked.change, asked.reference, asked.noise, asked.rows, touches)
        if rough:
            return self._deformation.model.roughly(asked.change, left, asked.reference, asked.noise, asked.rows)
        return frame.white.amplitudes(left)[0]

    def _verified(self, verifier: UnitVerifier, asked: Asked) -> UnitVerdict:
        return verifier.verify(
            asked.change, asked.reference, asked.starts, asked.noise, rows=asked.rows, budget_s=asked.budget_s,
            before=asked.before, heights=asked.heights, clock=self._clock,
        )  # fmt: skip

    def _made(self) -> UnitVerifier:
        """Return the verifier of the model in use."""
        model = self._deformation.model
        return UnitVerifier(_reduced(model, self._skin, self._digest), flat_of(self._skin), model)


def _reduced(model: Model, skin: Skin, digest: str) -> ReducedModel:
    return quick_model(model.metric, skin, digest, model.gauge)


@lru_cache(maxsize=4)
def flat_of(skin: Skin = PAPER) -> Array:
    """Return the (104,) V of the reduced models' flat, untouched sheet, under 1 A at 1 S/m."""
    return rows_of(exact_sheet(flat_metric_of(skin), skin).untouched)
