"""One deformation after another, each with its models: of its scan, about what frames have shown, at rest, looser."""

import time
from collections.abc import Callable
from typing import Final

from eitskin_sim.scene.touch_table import Array
from eitskin_sim.verification.residual import Noise
from eitskin_sim.verification.sheet.model import LOOSER, Model

ANEW: Final = 4
"""Times that a deformation's model is made again about what frames have shown, at most."""

Shown = Callable[[], Array]
"""Amplitudes of all columns that a frame speaks for which nothing explains."""


class Deformation:
    """The model in use, and what else there is.

    Args:
        clock: What making models is counted by, s.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._model: Model | None = None
        self._scanned: Model | None = None
        self._others: list[Callable[[Shown], Model | None]] = []
        self._anew = 0
        self.is_rough = False
        """Whether rows of what is not explained are believed less, as frames here need."""
        self.spent_s = 0.0
        """What the present deformation's models took so far."""
        self.spent_cpu_s = 0.0
        """The same by the processor."""

    @property
    def model(self) -> Model:
        """The one in use.

        Raises:
            ValueError: There is no deformation yet.
        """
        if self._model is None:
            raise ValueError("no deformation to verify on; give its cloud first")
        return self._model

    def scan(self, make: Callable[[], Model]) -> None:
        """Take the model of another scan."""
        self.spent_s = self.spent_cpu_s = 0.0
        self._make(make)
        self._scanned, self._anew, self.is_rough = self.model, 0, False
        self.ask_again()

    def ask_again(self) -> None:
        """Let the scanned deformation be tried as other sheets once more."""
        scanned = self._scanned
        assert scanned is not None
        self._others = [lambda _: scanned.looser(LOOSER), self._elsewhere]

    def _elsewhere(self, shown: Shown) -> Model | None:
        self.is_rough = True
        amplitudes = shown()
        share = self.model.likely_share(amplitudes)
        return self.model.about(amplitudes, share) if share else None

    def rest(self, change: Array, reference: Array, noise: Noise) -> bool:
        """Take what the untouched sheet reads, and return whether it is the scanned one; else nothing changes.

        Args:
            change: (104,) dV, the mean of some frames.
            reference: (104,) V.
            noise: Of that mean.
        """
        before, scanned = self.model, self._scanned
        assert scanned is not None
        self._make(lambda: scanned.rested(change, reference, noise) or before)
        if self._model is before:
            return False
        self._anew, self.is_rough = ANEW, False
        self._others = [lambda _: scanned.looser(LOOSER), lambda _: scanned]
        return True

    @property
    def was_made_anew(self) -> bool:
        """Whether a frame, or the sheet at rest, has shown already how it is stretched."""
        return self._anew > 0

    @property
    def may_be_made_anew(self) -> bool:
        """Whether another frame may show it."""
        return self._anew < ANEW

    def make_anew(self, amplitudes: Array, share: float = 1.0) -> Callable[[], None]:
        """Make the model about amplitudes of all its columns, and return what brings back the one before.

        It stays as it is where no sheet has them.

        Args:
            amplitudes: Of all columns.
            share: Of the way there from what the model has.
        """
        before = self._model

        def back() -> None:
            self._model = before

        self._make(lambda: self.model.about(amplitudes, share) or self.model)
        self._anew += 1
        return back

    @property
    def may_be_looser(self) -> bool:
        """Whether another sheet was not tried yet."""
        return bool(self._others)

    def as_now(self) -> Callable[[], None]:
        """Return what brings back the model as it is now, and which others are left to be tried."""
        now = self._model, self._anew, self.is_rough, list(self._others)

        def back() -> None:
            self._model, self._anew, self.is_rough, self._others = now

        return back

    def loosen(self, shown: Shown) -> Callable[[], None] | None:
        """Make the next other sheet, each once a deformation, and return what brings back the one before.

        These are, where it was not seen at rest, one about what a frame shows roughly; one of looser material; and the
        scan's own, where it was seen at rest. None is returned where a frame shows nothing.
        """
        before, other = (self._model, self._anew, self.is_rough), self._others.pop()

        def back() -> None:
            self._model, self._anew, self.is_rough = before

        self._make(lambda: other(shown) or self.model)
        if self._model is before[0]:
            back()
            return None
        self._anew = 0
        return back

    def _make(self, make: Callable[[], Model]) -> None:
        """Make a model, and count what it takes."""
        clock, processor = self._clock(), time.process_time()
        self._model = make()
        self.spent_s += self._clock() - clock
        self.spent_cpu_s += time.process_time() - processor
