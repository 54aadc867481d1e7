"""One frame through decode, normalise, gate and inference, each stage stamped, nothing allocated.

The pipeline owns the memory that a frame passes through and the decisions about it; it knows no socket and no port.
What it leaves out is stated: ``inference:untouched``, ``inference:no_subscriber``, ``inference:unchanged``,
``map:region``, ``map:untouched``, ``acquisition:idle``, ``geometry:cloud_unchanged``. A frame that is not fit to
publish is withheld, with a reason and a count:

====================  ===============================================================
``malformed``         an intact packet that is no frame of this device
``duplicate``         the same sequence number again
``configuration``     made under another generation than HELLO named
``partial``           a scan of some drives only, without a gate for them
``implausible``       dV is not finite or beyond 1e6, or the map is not finite
``no_signal``         no row reaches a thousandth of its reference: no current flows
``stale``             over budget, and a newer frame was waiting
====================  ===============================================================

The next frame that is published says so in its events: ``withheld:implausible``.
"""

import math
import time
from dataclasses import dataclass
from typing import Final

import numpy as np

from eitskin.acquisition.clock import DeviceClock
from eitskin.errors import BudgetError
from eitskin.health.monitor import Health
from eitskin.messaging.frame import STAGES
from eitskin.messaging.regions import WHOLE, Regions, pixels
from eitskin.model.bundle import Bundle
from eitskin.model.engine import Buffers, Engine, Geometry, ProjectionEngine, engines
from eitskin.model.gate import Gate
from eitskin.pipeline.gate_audit import GateAudit, audit_pixels
from eitskin.pipeline.idle import IdleGate
from eitskin.pipeline.latency_budget import LatencyBudget
from eitskin.pipeline.stillness import REFRESH_FRAMES, Stillness
from eitskin.reference.captured import Reference
from eitskin.reference.normaliser import Normaliser
from eitskin_proto.errors import ProtocolError
from eitskin_proto.sensor.grid import N_PIXELS
from eitskin_proto.wire.answers import Hello
from eitskin_proto.wire.frames import FrameView
from eitskin_proto.wire.scan_rows import ALL_DRIVES
from eitskin_proto.wire.unwrap import StreamCounter

REASONS: Final = ("malformed", "duplicate", "configuration", "partial", "implausible", "no_signal", "stale")
"""Why frames are withheld."""

WITHHELD: Final = {reason: f"withheld:{reason}" for reason in REASONS}
"""The event of the next published frame."""

READ, DECODE, NORMALISE, GATE, INFER, PACK, PUBLISH = range(len(STAGES))
"""Where each stage's stamp stands."""

CLOUD_UNCHANGED: Final = ("geometry:cloud_unchanged",)
UNTOUCHED: Final = ("inference:untouched", *CLOUD_UNCHANGED)
LOOKED: Final = ("map:untouched", *CLOUD_UNCHANGED)
NO_SUBSCRIBER: Final = ("inference:no_subscriber", *CLOUD_UNCHANGED)
IDLE: Final = ("acquisition:idle", "inference:idle", *CLOUD_UNCHANGED)
UNCHANGED: Final = ("inference:unchanged", *CLOUD_UNCHANGED)

PROJECTION: Final = "tikhonov"
"""The solver whose maps cannot say that nothing touches."""

WARM_UPS: Final = 10
"""Runs of each engine before the first frame; ONNX Runtime plans its memory in the first."""


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """Engines that compute some regions only; made in one thread, used in another."""

    regions: Regions
    engines: list[Engine]


class Pipeline:
    """Everything between a payload and a map.

    Args:
        bundle: The solvers.
        hello: Of the device.
        budget_ns: From read to publish; None for no budget.
        solver: The most accurate solver to use; None for the bundle's own choice
            (:func:`eitskin.model.engine.default_solver`) or, with a budget, its most accurate one.
        skip_unchanged: Whether a touched frame keeps the map of an earlier one if only noise lies between them.

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
    ) -> None:
        arrays = bundle.gate_arrays()
        self._gate = Gate(arrays) if arrays is not None else None
        self.audit = GateAudit(audit_pixels(arrays))
        self.health: Health | None = None
        """Watches over electrodes and drift; None where the bundle cannot."""
        self.buffers = Buffers(bundle.bias_width, None if self._gate is None else self._gate.change)
        self.engines: list[Engine] = engines(bundle, self.buffers, best=solver, alone=budget_ns is None)
        self._whole = self.engines
        self.regions: Regions = (WHOLE,)
        """What of the map is computed."""
        self._next_part: Part | None = None
        self._stillness = Stillness() if skip_unchanged else None
        self.map_sequence = -REFRESH_FRAMES
        """The frame that this frame's map was computed for."""
        self._computed = ""
        """The solver of the map that is held; empty if none is."""
        self._computed_sequence = 0
        self.idle_gate: IdleGate | None = None
        """Judges frames of a few drives; without one they are withheld."""
        self.idle = False
        """Whether this frame is one of them."""
        self.budget = LatencyBudget(budget_ns, len(self.engines))
        self.counter = StreamCounter()
        self.clock = DeviceClock()
        self.normaliser = Normaliser(hello.volts_per_count)
        self.generation = hello.generation
        """Of the configuration that frames must carry."""
        self.generation_differs = False
        """A frame carried another one: the device must be asked what it runs now."""
        self.withheld = dict.fromkeys(REASONS, 0)
        """Frames that were not fit to publish."""
        self.withheld_total = 0
        self._begin()
        self._next_geometry: Geometry | None = None
        self._view = FrameView()
        self._change = self.buffers.change[0]
        self._map = self.buffers.map[0]
        self.map_bytes = memoryview(self._map).cast("B")
        """The map of this frame as float32, little-endian; the next frame overwrites it."""
        self.zero_bytes = memoryview(bytes(4 * N_PIXELS))
        """What an untouched frame publishes."""
        self.engine_ns = self._warm_up(budget_ns)
        """{engine: median time in ns}, measured at the start."""

    def _begin(self) -> None:
        """Set what is known of the frame in hand, before there is one."""
        self.stamps = [0] * len(STAGES)
        """``perf_counter_ns`` at the end of each stage of this frame."""
        self.sequence = 0
        self.device_us = 0
        self.scanned_ns = 0
        """When this frame was scanned, on the host's clock."""
        self.touched = False
        self.gate_logit = 0.0
        self.solver = "none"
        self.skipped: tuple[str, ...] = ()
        self.events: tuple[str, ...] = ()
        self.inferred = False
        """Whether this frame's map was computed for it."""
        self._skipped_new: tuple[str, ...] = ()
        self._skipped = CLOUD_UNCHANGED
        self._withheld_since: tuple[str, ...] = ()
        """What the next published frame will say of those before it."""

    def _check_budget(self, budget_ns: int | None, engine_ns: dict[str, float]) -> None:
        """Refuse a budget that not even the fastest solver meets."""
        if budget_ns is not None and engine_ns[self.engines[-1].name] > budget_ns:
            fastest = self.engines[-1].name
            raise BudgetError(
                f"a budget of {budget_ns / 1e6:g} ms cannot be met: the fastest solver, {fastest}, takes "
                f"{engine_ns[fastest] / 1e6:.3f} ms here; give --budget-ms more than that"
            )

    def _warm_up(self, budget_ns: int | None) -> dict[str, float]:
        medians = {}
        for engine in self.engines:
            spans = []
            for _ in range(WARM_UPS):
                start = time.perf_counter_ns()
                engine.infer()
                spans.append(time.perf_counter_ns() - start)
            medians[engine.name] = float(np.median(spans))
        self._check_budget(budget_ns, medians)
        return medians

    @property
    def map_is_zero(self) -> bool:
        """Whether this frame's map is all zero because nothing was computed."""
        return self.solver == "none"

    def greet(self, hello: Hello) -> None:
        """Take over what a device said after it was greeted anew."""
        self.generation = hello.generation
        self.generation_differs = False
        self.normaliser.use_scale(hello.volts_per_count)

    def use_reference(self, reference: Reference) -> None:
        """Normalise against a reference from the next frame on."""
        self.normaliser.use(reference.voltages_V, reference.weak)
        self._computed = ""
        if self.health is not None:
            spread_V = np.hypot(reference.spread_V, self.normaliser.volts_per_count / math.sqrt(12.0))  # of rounding
            self.health.use(reference.voltages_V, spread_V, self._gate)
            self._leave_out()
        if self._stillness is not None:
            step_V = self.normaliser.volts_per_count
            self._stillness.use(reference.voltages_V, reference.spread_V, reference.frames, step_V)

    def use_geometry(self, geometry: Geometry) -> None:
        """Use a geometry from the next frame on; may be called from another thread."""
        self._next_geometry = geometry

    def use_part(self, part: Part) -> None:
        """Compute only a part of the map from the next frame on; may be called from another thread."""
        self._next_part = part

    def part(self, bundle: Bundle, regions: Regions) -> Part:
        """Return what computes only some regions; made in the caller's thread, in tens of milliseconds.

        Args:
            bundle: The one that this pipeline was made with.
            regions: Of which the union is computed.
        """
        if regions == (WHOLE,):
            return Part(regions, self._whole)
        return Part(
            regions,
            engines(bundle, self.buffers, pixels(regions), best=self._whole[0].name, alone=len(self._whole) == 1),
        )

    def accept(self, payload: bytes, read_ns: int) -> bool:
        """Decode a frame and return whether it may go on; the first half of a frame's way.

        Args:
            payload: Of a FRAME message.
            read_ns: When its last byte was in hand.
        """
        view = self._view
        try:
            view.load(payload)
        except ProtocolError:
            return self._withhold("malformed")
        step = self.counter.step(view.sequence, view.device_us)
        if step.duplicate:
            return self._withhold("duplicate")
        self.events = ()
        if step.reset:
            self.clock.restart()
            self.events = ("device_reset",)
        elif step.lost:
            self.events = ("lost",)
        if view.generation != self.generation:
            self.generation_differs = True
            return self._withhold("configuration")
        idle = view.drives != ALL_DRIVES
        if idle and (self.idle_gate is None or view.drives != self.idle_gate.drives):
            return self._withhold("partial")
        if idle != self.idle:
            self.idle = idle
            self.events += ("idle" if idle else "awake",)
        if view.saturation:
            self.events += ("saturated",)
        self.sequence, self.device_us = step.sequence, step.device_us
        self.scanned_ns = self.clock.scanned_ns(step.device_us, read_ns)
        if self.idle_gate is not None and idle:
            self.idle_gate.load(view.counts)
        else:
            self.normaliser.load(view.counts)
        self.stamps[READ] = read_ns
        self.stamps[DECODE] = time.perf_counter_ns()
        return True

    def compute(self, wanted: bool) -> bool:
        """Normalise, judge and infer the accepted frame, and return whether it is fit to publish.

        Args:
            wanted: Somebody takes frames; otherwise the gate is all that runs.
        """
        stamps = self.stamps
        fresh_cloud = self._take_over()
        if self.idle:
            return self._compute_idle()
        if not self.normaliser.change_into(self._change):
            return self._withhold("no_signal" if self.normaliser.silent else "implausible")
        if self.health is not None:
            self.health.prepare(self._change)
            self.events += self.health.take_events()
        stamps[NORMALISE] = time.perf_counter_ns()
        gate = self._gate
        if gate is not None:
            self.touched = gate.touched()
            self.gate_logit = gate.logit
        else:
            self.touched = True  # without a gate every frame is computed
        if self.health is not None:
            self.health.complete(self._change, self.buffers.log_predicted[0])
        stamps[GATE] = time.perf_counter_ns()
        self.inferred = False
        if not self.touched and wanted and self.audit.looks() and self._look():
            self.touched = True
            self.skipped = self._skipped_new if fresh_cloud else self._skipped
        elif not self.touched or not wanted:
            self._compute_nothing()
            self.skipped = NO_SUBSCRIBER if self.touched else LOOKED if self.inferred else UNTOUCHED
        elif self._is_still():
            self.solver, self.map_sequence = self._computed, self._computed_sequence
            self.skipped = UNCHANGED
        elif not self._infer():
            return self._withhold("implausible")
        else:
            self.skipped = self._skipped_new if fresh_cloud else self._skipped
        self._name_withheld()
        stamps[INFER] = time.perf_counter_ns()
        return True

    def _compute_idle(self) -> bool:
        """Judge a frame of a few drives; there is no map in it."""
        gate, stamps = self.idle_gate, self.stamps
        assert gate is not None
        touched = gate.touched(self.normaliser)
        if touched is None:
            return self._withhold("implausible")
        self.touched, self.gate_logit = touched, gate.gate.logit
        stamps[NORMALISE] = stamps[GATE] = time.perf_counter_ns()
        self.inferred = False
        self._compute_nothing()
        self.skipped = IDLE
        self._name_withheld()
        stamps[INFER] = time.perf_counter_ns()
        return True

    def _compute_nothing(self) -> None:
        """Leave the map at zero; it is a new one, if the last was not, and again now and then."""
        if self.solver != "none" or not 0 <= self.sequence - self.map_sequence < REFRESH_FRAMES:
            self.map_sequence = self.sequence
        self.solver = "none"

    def _name_withheld(self) -> None:
        if self._withheld_since:
            self.events += self._withheld_since
            self._withheld_since = ()

    def _take_over(self) -> bool:
        """Use what other threads brought since the last frame, and return whether it was a cloud."""
        part = self._next_part
        if part is not None:
            self._next_part = None
            self.engines, self.regions = part.engines, part.regions
            self._skipped_new = () if part.regions == (WHOLE,) else ("map:region",)
            self._skipped = (*self._skipped_new, *CLOUD_UNCHANGED)
            self.buffers.map[:] = 0.0
            self._computed = ""
            if self.health is not None:
                self._leave_out()
        geometry = self._next_geometry
        if geometry is None:
            return False
        self._next_geometry = None
        self.buffers.take(geometry)
        self.events += ("cloud",)
        self._computed = ""
        return True

    def _is_still(self) -> bool:
        """Return whether the map that is held is this frame's too: nothing but noise changed since."""
        stillness = self._stillness
        if stillness is None or self._computed != self.engines[self.budget.engine].name:
            return False
        return stillness.still(self._change)

    def _look(self) -> bool:
        """Infer a frame that the gate calls untouched, and return whether its map shows a strong touch all the same."""
        if self.engines[self.budget.engine].name == PROJECTION:
            return False  # scaled to 1 whatever it shows
        before = self.solver, self.map_sequence
        if self._infer() and self.audit.overrules(self._map):
            self.events += ("gate_overruled",)
            return True
        self.solver, self.map_sequence = before
        return False

    def _infer(self) -> bool:
        engine = self.engines[self.budget.engine]
        engine.infer()
        self._computed = ""
        if not math.isfinite(np.dot(self._map, self._map)):
            return False
        self.inferred = True
        self.solver = self._computed = engine.name
        self.map_sequence = self._computed_sequence = self.sequence
        if self._stillness is not None:
            self._stillness.keep(self._change)
        return True

    def note_health(self) -> None:
        """Keep what electrodes and drift are judged by of the frame that was just published."""
        if self.health is not None and not self.idle and self.health.put_aside(self._view.counts, touched=self.touched):
            self.look_at_health()

    def look_at_health(self) -> None:
        """Look at electrodes and drift in the last few frames; what changes acts on the next one."""
        if self.health is not None and self.health.look(self.buffers.log_predicted[0]):
            self._leave_out()

    @property
    def has_leisure_work(self) -> bool:
        """Whether there is something to do while the line rests."""
        return self.health is not None and self.health.due

    def _leave_out(self) -> None:
        """Take the rows that are missing now out of the projection, and the map that is held out of use."""
        assert self.health is not None
        self._computed = ""
        for engine in (*self.engines, *self._whole):
            if isinstance(engine, ProjectionEngine):
                engine.change_matrix(self.health.projection)

    def judge(self, now_ns: int) -> None:
        """Hold the frame against the budget; an overrun is an event of this very frame."""
        if self.budget.judge(now_ns - self.stamps[READ], inferred=self.inferred):
            self.events += ("overrun",)

    def discard(self, payload: bytes) -> None:
        """Take note of a frame that is left out because a newer one waits; it is not counted as lost."""
        try:
            self._view.load(payload)
        except ProtocolError:
            self._withhold("malformed")
            return
        self.counter.step(self._view.sequence, self._view.device_us)
        self._withhold("stale")

    def _withhold(self, reason: str) -> bool:
        self.withheld[reason] += 1
        self.withheld_total += 1
        event = WITHHELD[reason]
        if event not in self._withheld_since:
            self._withheld_since += (event,)
        return False
