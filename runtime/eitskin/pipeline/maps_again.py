"""The maps of frames that were measured before, once more: bit by bit those that were published.

What was measured says all that a map is made of (:mod:`eitskin.messaging.streams.measured`). Here nothing is judged:
which frame was touched, by which solver its map was made and what was wrong with the sheet is taken from the recording,
and the sums are those of the running pipeline, in the same order. ::

    payload -> dV by the reference -> wires rearranged -> drift taken out -> rows filled in for the gate
            -> rows filled in for the solver, with log_predicted of the cloud -> solver -> map
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from eitskin.errors import MismatchError
from eitskin.health.electrodes import ElectrodeWatch
from eitskin.health.explanation import Finding
from eitskin.health.gate_without_rows import GateWithoutRows
from eitskin.health.imputation import Consistency, without_rows
from eitskin.messaging.regions import Regions, whole
from eitskin.messaging.streams.measured import CloudInUse, Conditions
from eitskin.model.buffers import Buffers
from eitskin.model.bundle import Bundle
from eitskin.model.engine import SMALLEST_MAP, ProjectionEngine, engines
from eitskin.model.gate import RememberingGate, begin_anew
from eitskin.model.geometry import GeometryGraph
from eitskin.reference.captured import Reference
from eitskin.reference.normaliser import Normaliser
from eitskin.reference.row_noise import with_rounding
from eitskin_proto.wire.frames import FrameView

NOTHING: Final = "none"
"""The solver of a map that is 0."""


class MapsAgain:
    """Computes maps of recorded frames: take a reference, a cloud and conditions, then ask for maps.

    Args:
        bundle: The one that was running, or another one of the same skin.
        volts_per_count: Of HELLO.
    """

    def __init__(self, bundle: Bundle, volts_per_count: float) -> None:
        self._bundle = bundle
        arrays, health = bundle.gate_arrays(), bundle.consistency_arrays()
        self._gate = None if arrays is None else RememberingGate(arrays)
        self.touched: bool | None = None
        """What the gate said of the frame that :meth:`logit_of` took last, after those before it; None without one."""
        self._consistency = None if health is None else Consistency.of(health)
        self._buffers = Buffers(bundle, None if self._gate is None else self._gate.change)
        self._change = self._buffers.change[0]
        self._graph = GeometryGraph(bundle)
        self._normaliser = Normaliser(volts_per_count)
        self._view = FrameView()
        self._shape = bundle.skin.grid.shape
        self._regions: Regions = whole(self._shape)
        self._engines = {engine.name: engine for engine in engines(bundle, self._buffers)}
        self._watch: ElectrodeWatch | None = None
        self._gate_rows: GateWithoutRows | None = None
        self._drift: npt.NDArray[np.float32] | None = None
        self._findings: tuple[Finding, ...] = ()
        self._buffers.take(self._graph.geometry(None, None, 0))

    @property
    def change(self) -> npt.NDArray[np.float32]:
        """(104,) dV of the frame in hand, as its solver saw it; valid until the next one."""
        return np.asarray(self._change, dtype=np.float32)

    @property
    def missing(self) -> npt.NDArray[np.bool_]:
        """(104,) which rows are filled in from the others."""
        nothing = np.zeros(len(self._change), dtype=np.bool_)
        return nothing if self._watch is None else self._watch.missing

    @property
    def is_whole(self) -> bool:
        """Whether the whole map was computed: earlier releases could compute some rectangles only."""
        return self._regions == whole(self._shape)

    @property
    def solvers(self) -> Sequence[str]:
        """Names of the bundle's solvers, from the most accurate to the fastest."""
        return tuple(self._engines)

    def use_reference(self, reference: Reference) -> None:
        """Normalise against a reference from the next frame on."""
        flat, step_V = reference.flat(), self._normaliser.volts_per_count
        self._normaliser.use(flat.voltages_V, flat.weak)
        begin_anew(self._gate)
        if self._consistency is not None:
            spread_V = with_rounding(flat.spread_V, step_V)
            self._watch = ElectrodeWatch(self._consistency, flat.voltages_V, spread_V)
            if self._gate is not None:
                self._gate_rows = GateWithoutRows(self._consistency, self._gate, self._watch.sigma)
            self._use_findings(self._findings)

    def use_cloud(self, cloud: CloudInUse) -> None:
        """Use a surface from the next frame on.

        Raises:
            MismatchError: It is of another skin.
        """
        if cloud.cloud.shape != (expected := self._bundle.skin.grid.cloud_shape):
            hint = "name a bundle of the skin that was recorded"
            raise MismatchError("cloud: shape", found=cloud.cloud.shape, expected=expected, hint=hint)
        given = cloud.cloud if cloud.why == "given" else None
        self._buffers.take(self._graph.geometry(given, cloud.log_predicted, cloud.revision))

    def use_conditions(self, conditions: Conditions) -> None:
        """Compute under other conditions from the next frame on; reference and cloud are told by themselves."""
        self._drift = conditions.drift
        self._normaliser.use_scale(conditions.volts_per_count)
        self._regions = conditions.regions
        findings = tuple(Finding(*finding) for finding in conditions.electrodes)
        if findings != self._findings:
            self._use_findings(findings)

    def _use_findings(self, findings: tuple[Finding, ...]) -> None:
        self._findings = findings
        watch = self._watch
        if watch is None:
            return
        watch.go_on_with(findings)
        if self._gate_rows is not None:
            self._gate_rows.leave_out(watch.missing)
        consistency = self._consistency
        if consistency is None:
            return
        for engine in self._engines.values():
            if isinstance(engine, ProjectionEngine):
                engine.change_matrix(lambda m: without_rows(m, consistency.projection_inverse, watch.missing))

    def logit_of(self, payload: bytes) -> float | None:
        """Return what the gate makes of a whole frame; None where there is no gate, or the frame is not plausible."""
        if self._gate is None:
            return None
        if not self._prepare(payload):
            self.touched = False
            return None
        self.touched = self._gate.touched()
        return self._gate.logit

    def map_of(self, payload: bytes, solver: str) -> npt.NDArray[np.float32]:
        """Return (rows, columns) the map that a solver makes of a frame; zeros for ``none``.

        Args:
            payload: Of the frame that the map was made of: ``map_seq`` says which.
            solver: As the frame names it.

        Raises:
            ProtocolError: It is no FRAME.
            ValueError: The bundle has no such solver.
        """
        if solver == NOTHING:
            return np.zeros(self._shape, dtype=np.float32)
        if solver not in self._engines:
            raise ValueError(f"solver {solver!r} does not exist; this bundle has {', '.join(self._engines)}")
        self._prepare(payload)
        if self._watch is not None and self._watch.alters:
            self._watch.imputation.fill(self._change, self._buffers.log_predicted[0])
        engine = self._engines[solver]
        engine.infer()
        found = np.array(self._buffers.map[0].reshape(self._shape))
        return found if self.is_whole else _masked(found, self._regions, scaled=isinstance(engine, ProjectionEngine))

    def _prepare(self, payload: bytes) -> bool:
        """Bring a frame to where the gate would see it; False where no sheet reads like that."""
        self._view.load(payload)
        self._normaliser.load(self._view.counts)
        if not self._normaliser.change_into(self._change):
            return False
        watch, change = self._watch, self._change
        alters = watch is not None and watch.alters
        if watch is not None and alters:
            watch.rearrange(change)
        if self._drift is not None:
            one = np.ones((), dtype=np.float32)
            np.add(change, one, out=change)
            np.multiply(change, self._drift, out=change)
            np.subtract(change, one, out=change)
        if alters and self._gate_rows is not None:
            self._gate_rows.fill(change)
        return True


def _masked(values: npt.NDArray[np.float32], regions: Regions, *, scaled: bool) -> npt.NDArray[np.float32]:
    """Return a map with zeros outside some rectangles; a scaled one has its largest value, within them, at 1."""
    kept = np.zeros_like(values)
    for region in regions:
        kept[region.slices] = values[region.slices]
    largest = float(kept.max())
    return kept / np.float32(largest) if scaled and largest > SMALLEST_MAP else kept
