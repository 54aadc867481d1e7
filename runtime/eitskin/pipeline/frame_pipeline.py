"""One frame through decode, normalise, gate and inference, each stage stamped, nothing allocated.

The pipeline owns the memory that a frame passes through and the decisions about it; it knows no socket and no port.
What it finds it puts into a record (:mod:`eitskin.messaging.frame_record`). What it leaves out is stated there:
``inference:untouched``, ``inference:no_subscriber``, ``inference:unchanged``, ``map:untouched``,
``acquisition:idle``, ``geometry:cloud_unchanged``. Frames that are not fit to publish are withheld
(:mod:`eitskin.pipeline.intake`).
"""

import time
from typing import Final

from eitskin.errors import BundleError
from eitskin.health.imputation import MISSING
from eitskin.health.monitor import Health
from eitskin.messaging.frame_record import DECODE, GATE, INFER, NORMALISE, READ, FrameRecord
from eitskin.model.buffers import Buffers, Engine
from eitskin.model.bundle import Bundle
from eitskin.model.gate import RememberingGate, begin_anew
from eitskin.model.geometry import Geometry
from eitskin.pipeline.front_end_watch import FrontEndWatch
from eitskin.pipeline.gate_audit import GateAudit, audit_pixels
from eitskin.pipeline.held_prediction import HeldPrediction
from eitskin.pipeline.idle import IdleGate
from eitskin.pipeline.intake import Intake
from eitskin.pipeline.map_source import MapSource
from eitskin.pipeline.recorded import FrameDecisions
from eitskin.reference.captured import Reference
from eitskin.reference.normaliser import Normaliser
from eitskin.reference.row_noise import with_rounding
from eitskin_proto.skin.skin import Skin as SkinDescription
from eitskin_proto.wire.answers import Hello

CLOUD_UNCHANGED: Final = ("geometry:cloud_unchanged",)
UNTOUCHED: Final = ("inference:untouched", *CLOUD_UNCHANGED)
LOOKED: Final = ("map:untouched", *CLOUD_UNCHANGED)
NO_SUBSCRIBER: Final = ("inference:no_subscriber", *CLOUD_UNCHANGED)
IDLE: Final = ("acquisition:idle", "inference:idle", *CLOUD_UNCHANGED)
UNCHANGED: Final = ("inference:unchanged", *CLOUD_UNCHANGED)


class Pipeline:
    """Everything between a payload and a map.

    Args:
        bundle: The solvers.
        hello: Of the device.
        budget_ns: From read to publish; None for no budget.
        solver: The most accurate solver to use; None for the bundle's own choice
            (:func:`eitskin.model.engine.default_solver`) or, with a budget, its most accurate one.
        skip_unchanged: Whether a touched frame keeps the map of an earlier one if only noise lies between them.
        health: Watches over electrodes and drift; None where the bundle cannot.
        idle_gate: Judges frames of a few drives; without one they are withheld.
        decisions: Filled in before each frame where frames are computed again as a recording says; None decides now.
        skin: The one in use, if it is known better than when the bundle was made; None for the bundle's.

    Raises:
        BundleError: A solver of the bundle cannot be used.
        BudgetError: Not even the fastest solver meets the budget.
        ValueError: The bundle has no such solver.
    """

    def __init__(
        self,
        bundle: Bundle,
        hello: Hello,
        budget_ns: int | None = None,
        *,
        solver: str | None = None,
        skip_unchanged: bool = False,
        health: Health | None = None,
        idle_gate: IdleGate | None = None,
        decisions: FrameDecisions | None = None,
        skin: SkinDescription | None = None,
    ) -> None:
        self.skin = bundle.skin if skin is None else skin
        """The one in use."""
        grid = bundle.skin.grid
        arrays = bundle.gate_arrays()
        self.gate = RememberingGate(arrays) if arrays is not None else None
        self.audit = GateAudit(audit_pixels(arrays, grid.n_pixels), grid.n_pixels)
        self.health = health
        self.idle_gate = idle_gate
        self.decisions = FrameDecisions() if decisions is None else decisions
        """Of the frame to come, as far as they are given."""
        self.buffers = Buffers(bundle, None if self.gate is None else self.gate.change)
        self._prediction = HeldPrediction(self.buffers, fills=health is not None)
        self._change = self.buffers.change[0]
        self.record = FrameRecord(memoryview(self.buffers.map[0]).cast("B"))
        """The frame in hand; the next one overwrites it."""
        self.intake = Intake(hello, self.record, None if idle_gate is None else idle_gate.drives)
        self.front_end = FrontEndWatch(hello.sample_bytes, self.intake, idle_gate)
        self.counter, self.clock = self.intake.counter, self.intake.clock
        self.normaliser = Normaliser(hello.volts_per_count)
        self.maps = MapSource(
            bundle, self.buffers, self.record, budget_ns, solver=solver, skip_unchanged=skip_unchanged
        )
        self.budget = self.maps.budget
        self.bundle = bundle
        self._next_geometry: Geometry | None = None

    @property
    def engines(self) -> list[Engine]:
        """What computes maps, from the most accurate to the fastest."""
        return self.maps.engines

    def greet(self, hello: Hello) -> None:
        """Take over what a device said after it was greeted anew."""
        self.intake.greet(hello)
        begin_anew(self.gate, self.idle_gate)
        self.normaliser.use_scale(hello.volts_per_count)

    def use_reference(self, reference: Reference, *, fresh: bool = False) -> None:
        """Normalise against a reference, or the flat one that its scan makes of it; a fresh one is of the sheet now."""
        step_V, flat = self.normaliser.volts_per_count, reference.flat()
        self.normaliser.use(flat.voltages_V, flat.weak)
        begin_anew(self.gate, self.idle_gate)
        self.front_end.use(reference, step_V)
        if self.health is not None:
            spread_V = with_rounding(flat.spread_V, step_V)
            self.health.use(flat.voltages_V, spread_V, self.gate, frames=flat.frames, fresh=fresh)
            self.maps.change_projection(self.health.projection)
        self.maps.compare_by(flat.voltages_V, flat.spread_V, flat.frames, step_V)
        self._prediction.use(reference)

    def start_with(self, geometry: Geometry) -> None:
        """Use a geometry at once, without an event; only between two frames of the same thread."""
        self._prediction.take(geometry)
        self.record.cloud = geometry.revision
        self.maps.forget()

    def use_geometry(self, geometry: Geometry) -> None:
        """Use a geometry from the next frame on; may be called from another thread."""
        self._next_geometry = geometry

    def exclude(self, electrodes: tuple[int, ...]) -> None:
        """Go on without these electrodes from the next frame on; may be called from another thread.

        Raises:
            BundleError: The bundle does not know how to go on without an electrode.
            ValueError: One does not exist, or there are too many.
        """
        if self.health is None:
            raise BundleError(f"{self.bundle.path}: excluding electrodes is {MISSING}")
        self.health.exclude(electrodes)

    def accept(self, payload: bytes, read_ns: int) -> bool:
        """Decode a frame and return whether it may go on; the first half of a frame's way.

        Args:
            payload: Of a FRAME message.
            read_ns: When its last byte was in hand.
        """
        intake, record = self.intake, self.record
        if not intake.accept(payload, read_ns):
            return False
        if record.resets != self.counter.resets:  # frames are numbered anew, and a map is known by its frame
            record.resets = self.counter.resets
            self.maps.forget()
        if record.idle and self.idle_gate is not None:
            self.idle_gate.load(intake.counts)
        else:
            self.normaliser.load(intake.counts)
        record.stamps[DECODE] = time.perf_counter_ns()
        return True

    def load_recorded(self, payload: bytes, sequence: int) -> bool:
        """Take a frame that was accepted when it was measured, and return whether it is a whole scan.

        Args:
            payload: Of a FRAME message.
            sequence: Its number, unwrapped.

        Raises:
            ProtocolError: It is no FRAME.
        """
        if not self.intake.load(payload):
            return False
        self.record.sequence, self.record.events = sequence, ()
        self.normaliser.load(self.intake.counts)
        return True

    def compute(self, wanted: bool) -> bool:
        """Normalise, judge and infer the accepted frame, and return whether it is fit to publish.

        Args:
            wanted: Somebody takes frames; otherwise the gate is all that runs.
        """
        record = self.record
        stamps = record.stamps
        fresh_cloud = self._take_over()
        record.inferred = False
        if record.idle:
            return self._compute_idle()
        if not self.normaliser.change_into(self._change):
            return self.intake.give_up("no_signal" if self.normaliser.silent else "implausible")
        if self.normaliser.far and self.front_end.look(self.normaliser):
            return self.intake.give_up("stuck")
        health = self.health
        if health is not None:
            health.prepare(self._change)
            record.events += health.take_events()
        stamps[NORMALISE] = time.perf_counter_ns()
        decided, gate = self.decisions, self.gate
        record.touched = True  # without a gate every frame is computed
        if gate is not None:
            record.touched, record.gate_logit = gate.touched(), gate.logit
        if decided.touched is not None:
            record.touched = decided.touched
        if health is not None:
            health.complete(self._change, self.buffers.log_predicted[0])
        stamps[GATE] = time.perf_counter_ns()
        if not record.touched and wanted and self._infers_untouched() and self._look():
            record.touched = True
            record.skipped = () if fresh_cloud else CLOUD_UNCHANGED
        elif not record.touched or not wanted:
            self.maps.leave()
            record.skipped = NO_SUBSCRIBER if record.touched else LOOKED if record.inferred else UNTOUCHED
        elif self.maps.keep(decided.keeps_map):
            record.skipped = UNCHANGED
        elif not self.maps.infer(decided.solver):
            return self.intake.give_up("implausible")
        else:
            record.skipped = () if fresh_cloud else CLOUD_UNCHANGED
        self._describe()
        stamps[INFER] = time.perf_counter_ns()
        return True

    def _compute_idle(self) -> bool:
        """Judge a frame of a few drives; there is no map in it."""
        gate, record = self.idle_gate, self.record
        assert gate is not None
        touched = gate.touched(self.normaliser)
        if touched is None:
            return self.intake.give_up("implausible")
        if gate.far and self.front_end.look_idle():
            return self.intake.give_up("stuck")
        record.touched, record.gate_logit = touched, gate.gate.logit
        record.stamps[NORMALISE] = record.stamps[GATE] = time.perf_counter_ns()
        self.maps.leave()
        record.skipped = IDLE
        self._describe()
        record.stamps[INFER] = time.perf_counter_ns()
        return True

    def _describe(self) -> None:
        """Say what state the frame was computed in."""
        record, health = self.record, self.health
        self.intake.name_events()
        record.weak_rows = self.normaliser.weak_count
        if health is not None:
            record.drift, record.electrodes = health.drift.distance, health.electrodes.texts

    def _take_over(self) -> bool:
        """Use what other threads brought since the last frame, and return whether it was a cloud."""
        geometry = self._next_geometry
        if geometry is None:
            return False
        self._next_geometry = None
        self.start_with(geometry)
        self.record.cloud_sequence = self.record.sequence
        self.record.events += ("cloud",)
        return True

    def _infers_untouched(self) -> bool:
        """Return whether the map of this untouched frame is to be computed all the same; asked once for each."""
        found, decided = self.audit.looks(self.health), self.decisions.inferred_untouched
        return found if decided is None else decided

    def _look(self) -> bool:
        """Infer a frame that the gate calls untouched, and return whether its map shows a strong touch all the same."""
        if not self.maps.can_overrule:
            return False
        record = self.record
        before = record.solver, record.map_sequence
        if self.maps.infer() and self.audit.overrules(self.maps.map):
            record.events += ("gate_overruled",)
            return True
        record.solver, record.map_sequence = before
        self.maps.forget()  # this frame goes out without a touch: none behind it may have its map under its number
        return False

    def note_health(self) -> None:
        """Keep what electrodes and drift are judged by of the frame that was just published."""
        health, record = self.health, self.record
        if health is not None and not record.idle and health.put_aside(self.intake.counts, touched=record.touched):
            self.look_at_health()

    def look_at_health(self) -> None:
        """Look at electrodes and drift in the last few frames; what changes acts on the next one."""
        if self.health is not None and self.health.look(self.buffers.log_predicted[0]):
            self.maps.change_projection(self.health.projection)

    @property
    def has_leisure_work(self) -> bool:
        """Whether there is something to do while the line rests."""
        return self.health is not None and self.health.due

    def judge(self, now_ns: int) -> None:
        """Hold the frame against the budget; an overrun is an event of this very frame."""
        record, budget = self.record, self.budget
        if budget.judge(now_ns - record.stamps[READ], inferred=record.inferred):
            record.events += ("overrun",)
        record.overrun = budget.overruns
