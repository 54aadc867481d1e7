"""Recorded frames to maps once more, by the runtime's own sums: no line, no socket, no clock.

Every frame is held against the reference, computed with the cloud and under the conditions that held when it came
(:mod:`eitskin.pipeline.maps_again`). With the bundle that was running, what was touched and which solver made each map
is taken from the recording, and the maps come out bit by bit as they were published. Another bundle judges by its own
gate.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from eitskin.model.bundle import Bundle
from eitskin.model.engine import default_solver
from eitskin.pipeline.maps_again import NOTHING, MapsAgain
from eitskin_proto.wire.frames import FrameView
from eitskin_proto.wire.scan_rows import ALL_DRIVES
from eitskin_tools.recording.bundles import reference_of
from eitskin_tools.recording.reinfer.verdicts import Judged
from eitskin_tools.recording.script import Step
from eitskin_tools.recording.told import Told


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
        self._again = MapsAgain(bundle, script.hello.volts_per_count)
        if solver is not None and solver not in self._again.solvers:
            raise ValueError(f"solver {solver!r} does not exist; {bundle.path} has {', '.join(self._again.solvers)}")
        self._solver = solver if solver is not None or self.as_recorded else default_solver(bundle)
        self._nothing = np.zeros(bundle.skin.grid.shape, dtype=np.float32)
        self._view = FrameView()
        self._ready = False

    @property
    def change(self) -> npt.NDArray[np.float32]:
        """(104,) dV of the frame whose map came last, as its solver saw it; valid until the next one."""
        return self._again.change

    @property
    def missing(self) -> npt.NDArray[np.bool_]:
        """(104,) which of its rows were filled in from the others."""
        return self._again.missing

    def compute(self, step: Step, *, every: bool = True) -> Computed | None:
        """Compute a frame; None where the recording does not say what it is held against, or it was withheld.

        Args:
            step: The frame, and what changed before it.
            every: Whether the map is wanted also where that of an earlier frame was published.

        Raises:
            SkinError: Reference or cloud cannot be used with this bundle.
        """
        self._change(step)
        frame = step.frame
        if not self._ready or not step.known or frame.withheld:
            return None
        self._view.load(frame.payload)
        if self._view.drives != ALL_DRIVES:  # of the idle mode: there is no map
            return Computed(self._nothing, frame.touched, NOTHING)
        logit = self._again.logit_of(frame.payload)
        touched = frame.touched if self.as_recorded or self._again.touched is None else self._again.touched
        if not touched:
            return Computed(self._nothing, False, NOTHING, logit)
        solver = self._solver or frame.solver
        if solver == NOTHING:  # touched, but nobody asked
            return Computed(self._nothing, True, NOTHING, logit)
        if not every and frame.map_seq != frame.seq:
            return Computed(self._nothing, True, solver, logit)
        found = self._again.map_of(frame.payload, solver)
        return Computed(found, True, solver, logit, is_whole=self._again.is_whole)

    def _change(self, step: Step) -> None:
        """Let hold what holds from this frame on."""
        if step.reference is not None:
            self._again.use_reference(reference_of(self._script, step.reference, self._bundle.skin))
            self._ready = True
        if step.cloud is not None:
            self._again.use_cloud(step.cloud)
        if step.conditions is not None:
            self._again.use_conditions(step.conditions)
