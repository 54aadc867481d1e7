"""The verifier: from the network's touches to shapes that explain the frame.

::

    starts from the network's map  ->  fit  ->  compare with alternatives  ->  explained?  ->  verdict
                                        ^                                          | no
                                        +------------  on another sheet  <---------+

The cost of a fit never rises, so more time gives no worse answer; the time limit is checked before each step of each
fit. If a fit needs a stretch of the sheet beyond the range of the derivatives, the model is made again there, a few
times a deformation; the next frames of the same deformation reuse it (:mod:`eitskin_sim.verification.deformation`).
"""

import time
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property, partial
from typing import Final, TypeVar

import numpy as np
import numpy.typing as npt

from eitskin_proto.skin.familiar_shape import largest_curvature
from eitskin_proto.skin.skin import PAPER, Skin
from eitskin_proto.skin.touch_kind import TouchKind
from eitskin_sim.arrays import Array
from eitskin_sim.scene.family import is_family
from eitskin_sim.scene.nominal import flat_metric_of, nominal_sheet
from eitskin_sim.scene.parts import Bend
from eitskin_sim.surface.measured_cloud import measured_cloud
from eitskin_sim.verification import alternatives, both_signs
from eitskin_sim.verification import constants as c
from eitskin_sim.verification.deformation import Deformation
from eitskin_sim.verification.fit import Budget, Fit, Frame
from eitskin_sim.verification.gentler_contrasts import likely_touches
from eitskin_sim.verification.likely_bend import likely_bend
from eitskin_sim.verification.metric_family import MetricFamily
from eitskin_sim.verification.network_map import starts_of, without_cracks
from eitskin_sim.verification.residual import Noise, Rows, change_of, check_frame
from eitskin_sim.verification.shape_search import ShapeSearch
from eitskin_sim.verification.shape_verdict import ShapeVerdict, scatter_of, touches_of
from eitskin_sim.verification.sheet_model import SheetModel, model_of_cloud
from eitskin_sim.verification.touch_prior import TouchPrior, touch_prior
from eitskin_sim.verification.verdict import LEVEL

BUDGET_S: Final = 2.0
"""Time limit of a frame; most take a thirtieth of it."""

Made = TypeVar("Made")


class ShapeVerifier:
    """Verifies frames of one deformation after another.

    Args:
        reference_V: (104,) flat and untouched, as measured; 0 in rows that every frame leaves out.
        noise: Of a frame.
        touches: Which way this skin's touches change conductance.
        skin: The skin of the frames.
        clock: In seconds, for budgets; ``time.process_time`` on a machine that is shared.
    """

    def __init__(
        self,
        reference_V: Array,
        noise: Noise,
        touches: TouchKind = "raise",
        skin: Skin = PAPER,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        self._rows = reference_V != 0.0
        self._reference = np.where(self._rows, reference_V, np.nan)
        self._of_one, self._prior, self._either = noise, touch_prior(touches, skin), touch_prior("both", skin)
        self._noise = noise
        """Of the frame in hand."""
        self._clock = clock
        self._is_dented = False
        self._skin = skin
        self._may_be_other = False
        """Whether the sheet may have another shape of its family than the cloud's."""
        self._is_guess = False
        self._explanation: Fit | None = None
        """Of the last frame; None if nothing explained it."""
        self._told: SheetModel | None = None
        """On which a frame was explained when another cloud was asked for."""
        self.deformation = Deformation(clock)
        """The present one, with its models and what they took."""

    def deform(self, cloud_mm: npt.ArrayLike, *, is_guess: bool = False, is_certain: bool = False) -> None:
        """Go on with a deformation. A frame that its shape does not explain may show another of the skin's family.

        Args:
            cloud_mm: (3, rows, columns) its scan.
            is_guess: Whether nothing measured the cloud.
            is_certain: Whether the sheet has no other shape, whatever frames show.

        Raises:
            ValueError: The cloud is malformed, or folds in its own plane; or it is a guess for a skin of no family.
        """
        if is_guess:
            self._search  # noqa: B018  # now rather than in the first frame; and it refuses a skin of no family
        self._may_be_other = not is_certain and is_family(self._skin.deformations)
        self._is_guess, self._explanation = is_guess, None
        scanned = partial(model_of_cloud, cloud_mm, self._skin)
        make = partial(scanned, may_be_other=self._may_be_other and not is_guess)
        self.deformation.scan(make, scanned, is_guess=is_guess)
        curvature = largest_curvature(np.asarray(cloud_mm, dtype=np.float64), self._skin.grid)
        self._is_dented = curvature > c.MAX_CURVATURE_PER_MM2

    @cached_property
    def _search(self) -> ShapeSearch:
        return ShapeSearch(self._prior, self._skin)

    @property
    def is_fitted(self) -> bool:
        """Whether frames have shown another shape than the cloud's, which is in use."""
        return isinstance(self.deformation.model.shape, MetricFamily) and not self.deformation.is_scanned

    def use_untouched(self, voltages_V: Array, frames: int = 1) -> bool:
        """Learn from what the deformation reads while nothing touches it.

        Args:
            voltages_V: (104,) the mean of some frames.
            frames: How many.

        Returns:
            Whether it is the scanned sheet, or another of its family; where it is not, nothing changes.

        Raises:
            ValueError: There is no deformation yet, or no frame; a number is not finite.
        """
        check_frame(voltages_V, self._reference)
        change, noise = voltages_V / self._reference - 1.0, self._of_one.of_mean(frames)

        def found() -> SheetModel | None:
            return self._search.model(change, self._reference, noise, self._rows) if self._may_be_other else None

        if not self.deformation.use_untouched(change, self._reference, noise, found):
            return False
        self._noise = noise
        self._explanation = self.frame(change).at(np.zeros((0, 8)))
        return True

    def another_cloud(self) -> Array | None:
        """Return the (3, rows, columns) mm cloud of the shape that the last frame shows.

        It is the flat sheet's where that explains the frame, and where no deformation of the skin has the shape. None
        is returned if nothing explains the frame, the sheet was scanned, or the shape is that of the last call.
        """
        fit = self._explanation
        if fit is None or not self._is_guess or fit.frame.model is self._told:
            return None
        self._told = fit.frame.model
        bend = likely_bend(fit, self._reference, self._noise) if self.is_fitted else None
        E, _, G = flat_metric_of(self._skin)(np.zeros((1, 2)))[0]
        sheet, (along, across) = nominal_sheet(self._skin), self._skin.outline.size_mm
        true = replace(sheet, size_mm=(along * float(np.sqrt(E)), across * float(np.sqrt(G))))
        return measured_cloud(bend or Bend(), skin=self._skin, sheet=true).astype(np.float64)

    def verify(
        self,
        voltages_V: Array,
        shares: Array,
        budget_s: float = BUDGET_S,
        rows: Rows | None = None,
        frames: int = 1,
    ) -> ShapeVerdict:
        """Return the touches that explain a frame best.

        Args:
            voltages_V: (104,) of the frame.
            shares: (n, rows, columns) of the network's map, what each of its touches has of every pixel.
            budget_s: Time. What a frame takes longer is one derivative of its touches and one solution with them, and,
                where the frame shows that the sheet is stretched otherwise, one model of it.
            rows: (104,) which rows the frame has; None is all. The others are left out, whatever they read.
            frames: That the frame is the mean of.

        Raises:
            ValueError: There is no deformation yet, or no time; a number is not finite.
        """
        budget, self._noise = Budget(budget_s, self._clock), self._of_one.of_mean(frames)
        rows = self._rows if rows is None else self._rows & rows
        check_frame(voltages_V, self._reference, shares, rows)
        change, grid = change_of(voltages_V, self._reference, rows), self._skin.grid
        starts = starts_of(shares, self._prior, grid)
        fit = self._explained(change, rows, starts, shares, budget)
        while self.deformation.has_others and fit.p_value <= LEVEL and self._time_for_model(budget):
            back = self._counted(budget, partial(self.deformation.try_other, self._amplitudes(fit)))
            if back is None:
                continue
            other = self._explained(change, rows, starts, shares, budget)
            if other.p_value > max(c.MIN_P_OF_OTHER_SHEET, fit.p_value):
                fit = other
            else:
                back()
        is_explained = fit.explains if self._is_guess else fit.p_value > LEVEL
        if self._may_be_other and not is_explained:
            fit = self._on_found_shape(fit, starts, shares, budget)
        unfinished = budget.search_over() and not fit.explains
        fit = alternatives.as_one_body(fit.frame, fit, shares, budget)
        self._explanation = fit if fit.p_value > LEVEL and not unfinished else None
        likely, scatter = likely_touches(fit.frame, fit, budget), scatter_of(fit)
        return ShapeVerdict(
            touches_of(fit, scatter, [pieces for _, pieces in likely[1:]]),
            fit.chi_squared,
            fit.degrees_of_freedom,
            fit.p_value,
            LEVEL,
            budget.fits,
            budget.seconds,
            unfinished,
            self._is_dented and self.deformation.model.rest is None,
            fit.pieces,
            tuple((share, without_cracks(pieces, shares, grid)) for share, pieces in likely),
        )

    def _explained(self, change: Array, rows: Rows, starts: list[Array], shares: Array, budget: Budget) -> Fit:
        """Return the fit that explains a frame best on the present sheet."""
        before, frame = self.deformation.model, self.frame(change, rows, len(starts[0]))
        if not frame.prior.sign:
            starts = [both_signs.signed(frame, pieces) for pieces in starts]
        fit = self._best_start(frame, starts, budget)
        if not self.deformation.is_guess and _is_far(fit):
            fit = self._one_by_one(fit, before, budget)
        if not fit.explains:
            usual = alternatives.of_usual_contrast(fit.frame, fit, budget)
            fit = self._on_its_sheet(alternatives.as_ellipses(fit.frame, usual, budget), budget)
        fit = alternatives.two_in_place_of_one(fit.frame, fit, shares, budget)
        return alternatives.without_smallest(fit.frame, fit, budget)

    def _one_by_one(self, before: Fit, model: SheetModel, budget: Budget) -> Fit:
        """Return a fit that does not explain its frame, or touches of either sign that do, found without the network.

        Other touches than the true ones may have led the model astray, so the search starts from the given one.
        """
        back = self.deformation.start_again(model)
        frame = self.frame(before.frame.change, before.frame.white.rows, prior=self._either)
        fit: Fit | None = frame.at(np.zeros((0, 8)))
        while fit is not None and len(fit.pieces) < c.MAX_TOUCHES_ONE_BY_ONE and not budget.search_over():
            fit = alternatives.fitted(fit.frame, both_signs.with_another(fit), False, budget)
            fit = None if fit is None else self._on_its_sheet(fit, budget)
            if fit is not None and fit.p_value > LEVEL:
                return fit
        back()
        return before

    def _on_found_shape(self, fit: Fit, starts: list[Array], shares: Array, budget: Budget) -> Fit:
        """Return the fit on the shape that its frame shows, or the given one if that explains the frame as well."""
        change, rows, found = fit.frame.change, fit.frame.white.rows, list[Array]()

        def make() -> SheetModel | None:
            shape = self._search.shape(change, self._reference, self._noise, starts, rows)
            found.append(np.zeros((0, 8)) if shape is None else shape.pieces)
            return None if shape is None else shape.model

        back = self._counted(budget, partial(self.deformation.go_on_with, make))
        if back is None:
            return fit
        budget.begin_again()
        other = self._explained(change, rows, found, shares, budget)
        if not _is_far(other) and other.cost < c.MAX_COST_RATIO_OF_MODEL_MADE_AGAIN * fit.cost:
            return other
        back()
        return fit

    def _best_start(self, frame: Frame, starts: list[Array], budget: Budget) -> Fit:
        """Return the first start that explains the frame once it is fitted, or the best of them."""
        best = None
        for pieces in starts:
            fit = alternatives.fitted(frame, pieces, bool(pieces[:, 5].any()), budget)
            if fit is None:
                continue
            fit = self._on_its_sheet(fit, budget)
            if fit.frame is not frame and best is not None:
                best = fit.frame.at(best.pieces, best.turning)
            frame = fit.frame
            if best is None or fit.cost < best.cost:
                best = fit
            if budget.search_over() or best.explains:
                break
        assert best is not None, "a sheet can have no touches"
        return best

    def _on_its_sheet(self, fit: Fit, budget: Budget) -> Fit:
        """Return the fit on a model that is made again where the frame shows another likely sheet."""
        while self.deformation.may_be_made_again and self._time_for_model(budget):
            back = self._counted(budget, partial(self.deformation.make_again, self._amplitudes(fit)))
            if back is None:
                break
            frame = self.frame(fit.frame.change, fit.frame.white.rows, fit.frame.n_shown, fit.frame.prior)
            again = alternatives.fitted(frame, fit.pieces, fit.turning, budget)
            if again is None or not (again.explains or again.cost < c.MAX_COST_RATIO_OF_MODEL_MADE_AGAIN * fit.cost):
                back()
                break
            fit = again
        return fit

    def frame(
        self, change: Array, rows: Rows | None = None, n_shown: int = 0, prior: TouchPrior | None = None
    ) -> Frame:
        """Return a frame on the present sheet.

        Args:
            change: (104,) dV.
            rows: (104,) which rows it has; None is all.
            n_shown: Touches that the search starts from.
            prior: Of its touches; None is the usual one.
        """
        model = self.deformation.model
        white = model.whitener(change, self._reference, self._noise, rows)
        return Frame(model, white, change, model.expected(model.ratio(change)), prior or self._prior, n_shown)

    def _amplitudes(self, fit: Fit) -> Array:
        """Return amplitudes of all columns that what a fit leaves of a frame speaks for."""
        frame = fit.frame
        left = frame.change - frame.expected - frame.model.change(fit.solved)
        return frame.model.amplitudes(frame.change, left, self._reference, self._noise, frame.white.rows)

    def _time_for_model(self, budget: Budget) -> bool:
        return not (budget.search_over() or (self.deformation.spent_s and budget.over_with_models()))

    def _counted(self, budget: Budget, make: Callable[[], Made]) -> Made:
        """Make another model of the sheet for a frame."""
        before = self.deformation.spent_s
        made = make()
        budget.models_s += self.deformation.spent_s - before
        return made


def _is_far(fit: Fit) -> bool:
    """Return whether a fit is so far from explaining its frame that touches are missing or the sheet is another."""
    return fit.chi_squared > c.MIN_MISFIT_WITHOUT_NETWORK * len(fit.residual)
