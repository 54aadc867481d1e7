"""Recorded frames to maps once more, by the runtime's own pipeline: no line, no socket, no clock.

Every frame is held against the reference, computed with the cloud and under the conditions that held when it came. With
the bundle that was running the pipeline takes its decisions from the recording (:mod:`eitskin.pipeline.recorded`), and
the maps come out bit by bit as they were published. Another bundle judges by its own gate.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin.errors import MismatchError
from eitskin.health.imputation import Consistency
from eitskin.messaging.regions import whole
from eitskin.model.bundle import Bundle
from eitskin.model.engine import SMALLEST_MAP, default_solver
from eitskin.model.geometry import GeometryGraph
from eitskin.pipeline.frame_pipeline import Pipeline
from eitskin.pipeline.map_source import PROJECTION
from eitskin.pipeline.recorded import RecordedHealth
from eitskin_tools.recording.bundles import reference_of
from eitskin_tools.recording.reinfer.verdicts import Judged
from eitskin_tools.recording.script import Step
from eitskin_tools.recording.told import Told

NOTHING: Final = "none"
"""The solver of a map that is 0."""

ALL_SOLVERS_NS: Final = 1 << 62
"""A latency budget that every solver meets: with one, the pipeline has all solvers of the bundle."""


@dataclass(frozen=True, slots=True, eq=False)
class Computed:
    """What became of one frame."""

    map: npt.NDArray[np.float32]
    """(rows, columns); zero where nothing touches."""
    touched: bool
    solver: str
    gate_logit: float | None = None
    """As it came out now; None where there is no gate."""
    judged: Judged | None = None
    """What physics says of it; None of solvers that ask for none, and of frames that nothing touches."""
    is_whole: bool = True
    """The runtime computed the whole map then; earlier releases could compute some rectangles alone."""


class Rerun:
    """Computes one frame after another.

    Args:
        script: The recording.
        bundle: The solvers.
        solver: Of the bundle, for every frame; None for the one that made each frame's map, or with another bundle the
            one that it would use by itself.

    Raises:
        BundleError: The bundle cannot be used.
        ValueError: It has no such solver.
    """

    def __init__(self, script: Told, bundle: Bundle, solver: str | None = None) -> None:
        self._script, self._bundle = script, bundle
        self.as_recorded = bundle.id == script.told("bundle")
        """The bundle is the one that was running."""
        self.bundle_id = bundle.id
        arrays = bundle.consistency_arrays()
        self._health = None if arrays is None else RecordedHealth(Consistency.of(arrays))
        self._pipeline = Pipeline(bundle, script.hello, ALL_SOLVERS_NS, health=self._health)
        self._graph = GeometryGraph(bundle)
        self._pipeline.start_with(self._graph.geometry(None, None, 0))
        self._solvers = {NOTHING, *(engine.name for engine in self._pipeline.engines)}
        if solver is not None:
            self._check(solver)
        self._solver = solver if solver is not None or self.as_recorded else default_solver(bundle)
        self._nothing = np.zeros(bundle.skin.grid.shape, dtype=np.float32)
        self._whole = whole(bundle.skin.grid.shape)
        self._regions = self._whole
        self._ready = False

    def _check(self, solver: str) -> None:
        if solver not in self._solvers:
            names = ", ".join(engine.name for engine in self._pipeline.engines)
            raise ValueError(f"solver {solver!r} does not exist; {self._bundle.path} has {names}")

    @property
    def change(self) -> npt.NDArray[np.float32]:
        """(104,) dV of the frame whose map came last, as its solver saw it; valid until the next one."""
        return np.asarray(self._pipeline.buffers.change[0])

    @property
    def missing(self) -> npt.NDArray[np.bool_]:
        """(104,) which of its rows were filled in from the others."""
        nothing = np.zeros(self._pipeline.buffers.change.size, dtype=np.bool_)
        return nothing if self._health is None else self._health.electrodes.missing

    def compute(self, step: Step, *, every: bool = True) -> Computed | None:
        """Compute a frame; None where the recording does not say what it is held against, or it was withheld.

        Args:
            step: The frame, and what changed before it.
            every: Whether the map is wanted also where that of an earlier frame was published.

        Raises:
            SkinError: Reference or cloud cannot be used with this bundle.
        """
        self._change(step)
        frame, pipeline = step.frame, self._pipeline
        record, decided = pipeline.record, pipeline.decisions
        if not self._ready or not step.known or frame.withheld or frame.seq is None:
            return None
        if not pipeline.load_recorded(frame.payload, frame.seq):  # of the idle mode: there is no map
            return Computed(self._nothing, frame.touched, NOTHING)
        decided.touched = frame.touched if self.as_recorded or pipeline.gate is None else None
        decided.inferred_untouched = decided.keeps_map = False
        decided.solver = self._solver or frame.solver
        self._check(decided.solver)
        wanted = decided.solver != NOTHING and (every or frame.map_seq == frame.seq)  # else nobody asked for the map
        if not pipeline.compute(wanted):
            return Computed(self._nothing, False, NOTHING)
        logit = None if pipeline.gate is None else record.gate_logit
        if not record.touched or decided.solver == NOTHING:
            return Computed(self._nothing, record.touched, NOTHING, logit)
        found = self._map() if wanted else self._nothing
        return Computed(found, True, decided.solver, logit, is_whole=self._regions == self._whole)

    def _map(self) -> npt.NDArray[np.float32]:
        """Return a copy of the map of the frame in hand, as far as the runtime computed it then."""
        values: npt.NDArray[np.float32] = self._pipeline.buffers.map[0].reshape(self._nothing.shape)
        if self._regions == self._whole:
            return np.array(values)
        kept = np.zeros_like(values)
        for region in self._regions:
            kept[region.slices] = values[region.slices]
        largest = float(kept.max())
        scaled = self._pipeline.record.solver == PROJECTION and largest > SMALLEST_MAP
        return np.divide(kept, np.float32(largest)) if scaled else kept

    def _change(self, step: Step) -> None:
        """Use what changed before a frame."""
        pipeline = self._pipeline
        if step.reference is not None:
            pipeline.use_reference(reference_of(self._script, step.reference, self._bundle.skin))
            self._ready = True
        if (cloud := step.cloud) is not None:
            if cloud.cloud.shape != (expected := self._bundle.skin.grid.cloud_shape):
                hint = "name a bundle of the skin that was recorded"
                raise MismatchError("cloud: shape", found=cloud.cloud.shape, expected=expected, hint=hint)
            given = cloud.cloud if cloud.why == "given" else None
            pipeline.start_with(self._graph.geometry(given, cloud.log_predicted, cloud.revision))
        if (conditions := step.conditions) is not None:
            pipeline.normaliser.use_scale(conditions.volts_per_count)
            self._regions = conditions.regions
            if self._health is not None and self._health.use_recorded(conditions.drift, conditions.electrodes):
                pipeline.maps.change_projection(self._health.projection)
            if self.as_recorded and pipeline.gate is not None and conditions.gate_threshold is not None:
                pipeline.gate.threshold = conditions.gate_threshold
