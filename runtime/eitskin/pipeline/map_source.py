"""Provides a frame's map: from an engine, from an earlier frame, or none.

The latency budget chooses the engine, from the most accurate to the fastest. The memory's map is identified by solver
and frame, and discarded whenever anything changes on which it depends.
"""

import math
import time
from collections.abc import Callable
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin.errors import BudgetError
from eitskin.frame_record import FrameRecord
from eitskin.model.buffers import Buffers, Engine
from eitskin.model.bundle import Bundle
from eitskin.model.engine import SCALED, ProjectionEngine, engines, longest
from eitskin.model.stillness import REFRESH_FRAMES, Stillness
from eitskin.model.taught import TaughtField
from eitskin.pipeline.latency_budget import EASY_SHARE, LatencyBudget
from eitskin.pipeline.recorded import FrameDecisions

WARM_UPS: Final = 10
"""Runs of each engine before the first frame; ONNX Runtime plans its memory in the first."""


class MapSource:
    """Engines, and the state of their common memory.

    Args:
        bundle: The solvers.
        buffers: The engines' memory.
        record: Record of the current frame; solver, map_sequence and inferred are set in it.
        budget_ns: From read to publish; None for no budget.
        solver: The most accurate solver to use; None for the bundle's own choice
            (:func:`eitskin.model.engine.default_solver`) or, with a budget, its most accurate one.
        skip_unchanged: Whether frames are averaged and their map is kept while only noise changes between them.
        field: The gate of a bundle that was taught, which averages the frames that it judges.

    Raises:
        BundleError: A solver of the bundle cannot be used.
        BudgetError: Not even the fastest solver meets the budget.
        ValueError: The bundle has no such solver.
    """

    __slots__ = (
        "_change", "_field", "_held", "_held_fused", "_held_sequence", "_named", "_record", "budget", "engine_ns",
        "engines", "keeps_unchanged", "map", "stillness",
    )  # fmt: skip

    def __init__(
        self,
        bundle: Bundle,
        buffers: Buffers,
        record: FrameRecord,
        budget_ns: int | None,
        *,
        solver: str | None,
        skip_unchanged: bool,
        field: TaughtField | None = None,
    ) -> None:
        self._record, self._field = record, field
        self._change = buffers.change[0]
        self.map = buffers.map[0]
        """(pixels,) the map computed last."""
        self.engines: list[Engine] = engines(bundle, buffers, best=solver, alone=budget_ns is None, field=field)
        self._named = {engine.name: engine for engine in self.engines}
        self.keeps_unchanged = skip_unchanged
        """Whether a map is kept while only noise changes between two frames."""
        self.stillness = Stillness(len(self._change)) if field is None else field.stillness
        """Averages frames that differ only by noise."""
        self._held = ""
        """The solver of the map that is held; empty if none is."""
        self._held_sequence, self._held_fused = 0, 1
        record.map_sequence = -REFRESH_FRAMES
        self.engine_ns = self._warm_up()
        """{engine: median time in ns}, measured at the start."""
        self._check_budget(budget_ns)
        self.budget = LatencyBudget(budget_ns, len(self.engines), self._first_easy(budget_ns))

    def _warm_up(self) -> dict[str, float]:
        medians = {}
        for engine in self.engines:
            spans, infer = [], longest(engine)
            for _ in range(WARM_UPS):
                start = time.perf_counter_ns()
                infer()
                spans.append(time.perf_counter_ns() - start)
            medians[engine.name] = float(np.median(spans))
        return medians

    def _check_budget(self, budget_ns: int | None) -> None:
        """Refuse a budget that not even the fastest solver meets."""
        fastest = self.engines[-1].name
        if budget_ns is not None and self.engine_ns[fastest] > budget_ns:
            raise BudgetError(
                f"a budget of {budget_ns / 1e6:g} ms cannot be met: the fastest solver, {fastest}, takes "
                f"{self.engine_ns[fastest] / 1e6:.3f} ms here; give --budget-ms more than that"
            )

    def _first_easy(self, budget_ns: int | None) -> int:
        """Return the most accurate engine that leaves half of the budget to the rest of a frame, else the fastest."""
        if budget_ns is None:
            return 0
        easy = (number for number, one in enumerate(self.engines) if self.engine_ns[one.name] <= EASY_SHARE * budget_ns)
        return next(easy, len(self.engines) - 1)

    @property
    def can_overrule(self) -> bool:
        """Whether the next map can say that nothing touches."""
        return self.engines[self.budget.engine].name not in SCALED

    def change_projection(self, change: Callable[[npt.NDArray[np.float32]], npt.NDArray[np.float32]]) -> None:
        """Let the projections use ``change`` of the bundle's matrix, and discard the kept map."""
        self.start_mean()
        for engine in self.engines:
            if isinstance(engine, ProjectionEngine):
                engine.change_matrix(change)

    def drop_map(self) -> None:
        """Compute the next map in any case: a dependency has changed, or a new subscriber lacks the present one."""
        self._held = ""

    def start_mean(self) -> None:
        """Discard the kept map, and the mean of frames with it: the rows mean something else, or frames are lacking."""
        self._held = ""
        self.stillness.reset()

    def infer(self, solver: str | None = None) -> bool:
        """Compute the map of what is in ``change``, and return whether it is finite.

        Args:
            solver: Name of the engine; None for the one that the budget allows.
        """
        record = self._record
        engine = self.engines[self.budget.engine] if solver is None else self._named[solver]
        engine.infer()
        self._held = ""
        if not math.isfinite(self.map.dot(self.map)):
            return False
        record.inferred = True
        record.solver = self._held = engine.name
        record.map_sequence = self._held_sequence = record.sequence
        self._held_fused = record.fused
        return True

    def infer_alone(self) -> bool:
        """Compute the map of the frame in hand without those before it, and return whether it is finite."""
        self.stillness.keep(self._change)
        self._record.fused = 1
        return self.infer()

    def reuse_map(self, decided: FrameDecisions) -> bool:
        """Let the frame in hand have the map that is held, and return True, if nothing but noise changed since.

        Else ``change`` is what its map is to be computed of: the mean of the frames since more than noise changed, at
        2, 4, 8 ... of them.

        Args:
            decided: Whether nothing but noise changed, where that was decided before.
        """
        stillness, record, change, field = self.stillness, self._record, self._change, self._field
        held = bool(self._held) and self._held == (decided.solver or self.engines[self.budget.engine].name)
        if field is not None:
            due = field.is_new if decided.keeps_map is None else not decided.keeps_map
        elif not self.keeps_unchanged:
            stillness.keep(change)
            due = True
        elif decided.keeps_map is not None:
            due = stillness.follow(change, decided.fused, keeps_map=decided.keeps_map)
        else:
            due = stillness.take(change, wanted=not held)
        if held and not due and self.keeps_unchanged:
            record.solver, record.map_sequence, record.fused = self._held, self._held_sequence, self._held_fused
            return True
        record.fused = max(stillness.frames, 1)
        if field is None:
            np.copyto(change, stillness.mean)
        return False

    def show_nothing(self) -> None:
        """Leave the map at zero; it is a new one, if the last was not, and again now and then."""
        record = self._record
        if record.solver != "none" or not 0 <= record.sequence - record.map_sequence < REFRESH_FRAMES:
            record.map_sequence = record.sequence
        record.solver, record.fused = "none", 1
