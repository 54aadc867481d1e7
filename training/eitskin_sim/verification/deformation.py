"""Deformations one after another, each with the model of its sheet and other sheets to try.

The first model is that of the scan. If frames show a likely sheet beyond the range of the derivatives, the model is
made again there. If nothing explains a frame, other sheets are tried, each once a deformation:

    scanned        that of the scan alone, where it was taken for one of the skin's family
                   the sheet that the frame suggests, limited to a likely one
    seen at rest   that of the scan alone: the sheet has changed since

The verifier keeps one only if it explains the frame.
"""

import time
from collections.abc import Callable

from eitskin_sim.arrays import Array
from eitskin_sim.verification import constants as c
from eitskin_sim.verification.metric_family import MetricFamily
from eitskin_sim.verification.residual import Noise
from eitskin_sim.verification.sheet_model import SheetModel


class Deformation:
    """The model in use, and other sheets to try.

    Args:
        clock: By which the time for models is counted, in seconds.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._model: SheetModel | None = None
        self._scanned: SheetModel | None = None
        self._guess: SheetModel | None = None
        self._others: list[Callable[[Array], SheetModel | None]] = []
        self._made_again = 0
        self.spent_s = 0.0
        """Time spent on the present deformation's models."""
        self.spent_cpu_s = 0.0
        """The same by the processor."""

    @property
    def model(self) -> SheetModel:
        """The one in use.

        Raises:
            ValueError: There is no deformation yet.
        """
        if self._model is None:
            raise ValueError("no deformation to verify on; give its cloud first")
        return self._model

    def scan(
        self, make: Callable[[], SheetModel], other: Callable[[], SheetModel] | None = None, *, is_guess: bool = False
    ) -> None:
        """Go on with the model of another scan; that of a guess is not made again.

        Args:
            make: Makes it.
            other: Makes that of the scan alone, where the model is one of the skin's family.
            is_guess: Whether nothing measured the shape.
        """
        self.spent_s = self.spent_cpu_s = 0.0
        self._make(make)
        self._scanned = self.model
        self._guess, self._made_again = self.model if is_guess else None, 0
        self._others = [] if is_guess else [self._as_far_as_likely]
        if other is not None and isinstance(self.model.shape, MetricFamily):
            self._others.append(lambda _: other())

    @property
    def is_scanned(self) -> bool:
        """Whether the shape of the model in use is that of the scan."""
        return self._scanned is not None and self.model.shape is self._scanned.shape

    @property
    def is_guess(self) -> bool:
        """Whether the model is that of a guess: frames have not shown any other shape."""
        return self.model is self._guess

    def go_on_with(self, make: Callable[[], SheetModel | None]) -> Callable[[], None] | None:
        """Go on with a shape that a frame shows, and return what brings back the present one; None if it shows none."""
        back = self._go_on_with(make, 0)
        if back is not None:
            self._others = [lambda _: self._scanned]
        return back

    def use_untouched(
        self, change: Array, reference: Array, noise: Noise, found: Callable[[], SheetModel | None]
    ) -> bool:
        """Learn from what the untouched sheet reads, and return whether it is the scanned one; else nothing changes.

        Args:
            change: (104,) dV, the mean of some frames.
            reference: (104,) V.
            noise: Of that mean.
            found: Makes the model of the shape that these frames show, for a sheet that is not the scanned one.
        """
        before, scanned = self.model, self._scanned
        assert scanned is not None

        def make() -> SheetModel:
            other, model = None, scanned.rested(change, reference, noise)
            if model is None or (self._guess is not None and _excess(model) > c.MAX_EXCESS_OF_GUESS):
                other = found()
            return (other and other.rested(change, reference, noise)) or model or before

        self._make(make)
        if self._model is before:
            return False
        self._others = [lambda _: scanned]
        return True

    @property
    def may_be_made_again(self) -> bool:
        """Whether a frame may show another sheet: not where it was seen at rest, and some times a deformation."""
        return self.model.rest is None and not self.is_guess and self._made_again < c.MAX_MODELS_PER_DEFORMATION

    def make_again(self, amplitudes: Array) -> Callable[[], None] | None:
        """Make the model about amplitudes of all its columns, and return what brings back the present one.

        None is returned, and the model stays as it is, where derivatives reach as far, and where no sheet is likely to
        have the amplitudes.
        """
        before = self.model
        if not before.is_far(amplitudes) or before.likely_share(amplitudes) < 1.0:
            return None
        self._made_again += 1
        return self._go_on_with(lambda: before.about(amplitudes), self._made_again)

    @property
    def has_others(self) -> bool:
        """Whether another sheet was not tried yet."""
        return bool(self._others)

    def try_other(self, amplitudes: Array) -> Callable[[], None] | None:
        """Go on with the next other sheet, and return what brings back the present one; None if there is no such sheet.

        Args:
            amplitudes: Of all columns, that a frame speaks for.
        """
        other = self._others.pop()
        return self._go_on_with(lambda: other(amplitudes), 0)

    def start_again(self, model: SheetModel) -> Callable[[], None]:
        """Go on with an earlier model, and return what brings back the present one."""
        before, made_again = self._model, self._made_again
        self._model, self._made_again = model, 0

        def back() -> None:
            self._model, self._made_again = before, made_again

        return back

    def _go_on_with(self, make: Callable[[], SheetModel | None], made_again: int) -> Callable[[], None] | None:
        before, before_made = self.model, self._made_again
        self._make(lambda: make() or before)
        if self._model is before:
            return None
        self._made_again = made_again

        def back() -> None:
            self._model, self._made_again = before, before_made

        return back

    def _as_far_as_likely(self, amplitudes: Array) -> SheetModel | None:
        model = self.model
        return model.about(amplitudes, model.likely_share(amplitudes)) if model.is_far(amplitudes) else None

    def _make(self, make: Callable[[], SheetModel]) -> None:
        """Make a model, and count what it takes."""
        clock, processor = self._clock(), time.process_time()
        self._model = make()
        self.spent_s += self._clock() - clock
        self.spent_cpu_s += time.process_time() - processor


def _excess(model: SheetModel) -> float:
    """Return how many times more was off at rest than was thought."""
    return 1.0 if model.rest is None else model.rest.scale
